#pragma once

#include <array>
#include <span>
#include <vector>

#include "sim_worker/scene/scene.h"

namespace omentum {

/// Moves the drawn surface of a tissue with its recorded particles. On a sheet the vertices are the
/// particles; the surface of a volume follows its four nearest particles at rest, weighted by
/// inverse squared distance (plain translation, no rotation: good enough for a picture, not what
/// the simulation collides with).
class SurfaceSkin {
 public:
  explicit SurfaceSkin(const TissueBody& tissue);

  std::size_t particles() const { return particles_; }
  std::size_t vertices() const { return identity_ ? particles_ : offsets_.size(); }

  /// x y z of every vertex [m, W] from x y z of every particle.
  std::vector<float> apply(std::span<const float> particles_W) const;

 private:
  struct Link {
    std::array<std::size_t, 4> particle{};
    std::array<float, 4> weight{};
  };
  bool identity_ = true;
  std::size_t particles_ = 0;
  std::vector<Link> links_;
  std::vector<Eigen::Vector3f> offsets_;  ///< vertex minus weighted particles, at rest in W [m]
};

}  // namespace omentum

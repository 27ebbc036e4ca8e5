#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "core/aligned.h"
#include "sim_worker/geometry/surface_search.h"
#include "sim_worker/shell/yielding_surface.h"
#include "sim_worker/solid/solid_tissue.h"

namespace omentum {

/// Two-way contact between the nodes of a sheet and the skin of an elastic solid in lanes
/// (docs/decisions/0020). A node of the sheet keeps its collision distance from the deformed
/// triangles; what contact force on a node acts on the corners of the nearest triangle by their
/// barycentric weights. Vertices of the solid against the sheet's triangles are not looked at: the
/// solid must not be sharper than the sheet's pitch.
template <typename Real>
class SoftContact final : public YieldingSurface<Real> {
 public:
  /// `sheet_radius`: collision distance of the sheet's nodes [m].
  SoftContact(std::shared_ptr<const SolidTissueModel> model, const LaneKernel<Real>& kernel,
              int sheet_nodes, double sheet_radius);

  SolidTissue<Real>& solid() { return solid_; }
  const SolidTissue<Real>& solid() const { return solid_; }

  const SurfaceArgs<Real>& args() const override { return args_; }
  Tissue<Real>& body() override { return solid_; }
  double held_stiffness() const override;
  void find_near(const LaneArray<Real>& x, const LaneArray<Real>& v,
                 std::span<const std::uint32_t> free, std::span<std::uint32_t> near) override;
  void place(const LaneArray<Real>& x, const LaneArray<Real>& d, std::uint32_t lanes) override;
  void response(std::uint32_t lanes) override;
  void take(std::uint32_t lanes) override;

  /// After both bodies have begun a substep, the sheet at x: loads the solid with the forces of the
  /// last one.
  void begin_substep(const LaneArray<Real>& x);
  /// After the sheet is solved: the solid under the forces as they are now.
  void settle();

  /// Force of the solid on a node of the sheet at the end of the last step, in W [N].
  Eigen::Vector3d force(int lane, int node) const;
  /// Distance of a point from the solid as it is now [m]; 0 inside.
  double distance(int lane, const Eigen::Vector3d& p);

  /// Solid and forces, as Tissue has them.
  void reset(int lane);
  bool healthy(int lane) const;
  void save(int lane, Bytes& out) const;
  Result<std::size_t> load(int lane, std::span<const std::byte> state);

 private:
  /// A node of the sheet that may touch in this control step, at the step's start.
  struct Candidate {
    int node = 0;
    double gap = 0;  ///< to the triangles [m]
    Eigen::Vector3d place = Eigen::Vector3d::Zero();
    TrianglePoint point;                               ///< where the node was last placed
    Eigen::Vector3d normal = Eigen::Vector3d::Zero();  ///< there, in this substep; zero = far
  };
  struct LaneStart {
    std::vector<Candidate> near;
    std::vector<Eigen::Vector3d> skin;  ///< in the order of skin_
  };

  void take_vertices(int lane, bool moved);
  double largest_motion(int lane) const;
  void find_normals();
  void place_node(Candidate& candidate, int lane, const Eigen::Vector3d& q);
  /// Loads on the solid in the given lanes: minus (force - before), `before` may be null.
  void spread(std::uint32_t lanes, const LaneArray<Real>* before, LaneArray<Real>& load) const;

  SolidTissue<Real> solid_;
  int lanes_, nodes_;
  double radius_;
  SurfaceSearch search_;
  std::vector<std::int32_t> skin_;                ///< nodes of the solid's surface
  std::vector<Eigen::Vector3d> vertex_, normal_;  ///< scratch: of one lane
  std::vector<LaneStart> start_;                  ///< per lane
  std::uint32_t changed_ = 0;                     ///< lanes whose forces changed in this substep
  bool placed_ = false;                           ///< in this substep
  LaneArray<Real> plane_, motion_, force_, before_, work_, step_length_, cross_, beta_, direction_,
      direction_part_, direction_displacement_, direction_work_, load_, change_;
  SurfaceArgs<Real> args_{};
};

extern template class SoftContact<float>;
extern template class SoftContact<double>;

}  // namespace omentum

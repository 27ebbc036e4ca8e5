#include "report/skin.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <numeric>

#include "core/check.h"

namespace omentum {

SurfaceSkin::SurfaceSkin(const TissueBody& tissue)
    : identity_(tissue.surface_is_particles), particles_(tissue.particles.size()) {
  if (identity_) return;
  const std::size_t nearest = std::min<std::size_t>(4, particles_);
  std::vector<std::size_t> order(particles_);
  std::iota(order.begin(), order.end(), std::size_t{0});
  for (const Eigen::Vector3d& vertex : tissue.surface_vertices) {
    const auto distance = [&](std::size_t k) {
      return (tissue.particles[k] - vertex).squaredNorm();
    };
    std::partial_sort(order.begin(), order.begin() + static_cast<std::ptrdiff_t>(nearest),
                      order.end(), [&](std::size_t a, std::size_t b) {
                        return std::pair(distance(a), a) < std::pair(distance(b), b);
                      });
    Link link;
    double sum = 0;
    std::array<double, 4> weight{};
    for (std::size_t k = 0; k < nearest; ++k) {
      link.particle[k] = order[k];
      weight[k] = 1 / (distance(order[k]) + 1e-10);  // [m^2] far below any particle spacing
      sum += weight[k];
    }
    Eigen::Vector3d rest = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < nearest; ++k) {
      link.weight[k] = static_cast<float>(weight[k] / sum);
      rest += weight[k] / sum * tissue.particles[link.particle[k]];
    }
    links_.push_back(link);
    offsets_.emplace_back((tissue.X_WB.linear() * (vertex - rest)).cast<float>());
  }
}

std::vector<float> SurfaceSkin::apply(std::span<const float> particles_W) const {
  OMENTUM_CHECK(particles_W.size() == 3 * particles_, "{} numbers, {} particles",
                particles_W.size(), particles_);
  if (identity_) return {particles_W.begin(), particles_W.end()};
  std::vector<float> vertices;
  vertices.reserve(3 * links_.size());
  for (std::size_t v = 0; v < links_.size(); ++v) {
    Eigen::Vector3f p = offsets_[v];
    for (std::size_t k = 0; k < 4; ++k) {
      const float* particle = particles_W.data() + 3 * links_[v].particle[k];
      p += links_[v].weight[k] * Eigen::Vector3f(particle[0], particle[1], particle[2]);
    }
    vertices.insert(vertices.end(), p.data(), p.data() + 3);
  }
  return vertices;
}

}  // namespace omentum

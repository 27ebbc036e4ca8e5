#include "mismatch/explain/block_errors.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include "core/constants.h"

namespace omentum {
namespace {

constexpr double kCell = 0.02;      // [m]
constexpr double kSeconds = 0.2;    // [s]
constexpr double kFar = 0.03;       // [m] from the surface: no tissue, wherever the surface errs
constexpr double kNear = 0.005;     // [m] from a surface that fits: tissue, no flying pixel
constexpr std::size_t kLeast = 10;  // points of a block

using Distances = std::vector<std::vector<double>>;
using BlockKey = std::array<int, 3>;

using Blocks = std::map<BlockKey, std::vector<std::pair<std::size_t, std::size_t>>>;

/// Points of a recording by block: frame and place in the frame. Blocks last so many seconds; 0: a
/// frame each.
Blocks blocks_of(const BaseFit& base, const std::vector<Prediction>& surfaces, std::size_t r,
                 double seconds) {
  const Observation& seen = base.data.observations[r];
  const std::vector<Eigen::Vector3d>& at_rest = base.data.made.tissue.particles;
  const Linearisation linear{base.found.state, surfaces};
  const Comparison compared = comparison(base.data, linear, base.found.state, r);
  Blocks blocks;
  for (std::size_t f = 0; f < seen.frames.size(); ++f) {
    if (f >= surfaces[r].frames.size() || !surfaces[r].frames[f].valid) continue;
    const std::vector<Eigen::Vector3d> vertices = base.data.likelihood.vertices(compared, f);
    const int time = seconds > 0 ? static_cast<int>(std::floor(seen.frames[f].t / seconds))
                                 : static_cast<int>(f);
    for (std::size_t k = 0; k < seen.frames[f].points.size(); ++k) {
      std::size_t nearest = 0;
      double least = std::numeric_limits<double>::infinity();
      for (std::size_t v = 0; v < at_rest.size(); ++v) {
        const double d = (seen.frames[f].points[k] - vertices[v]).squaredNorm();
        if (d < least) {
          least = d;
          nearest = v;
        }
      }
      const auto cell = [&](int axis) {
        return static_cast<int>(std::floor(at_rest[nearest][axis] / kCell));
      };
      blocks[{cell(0), cell(1), time}].emplace_back(f, k);
    }
  }
  return blocks;
}

double median_of(std::vector<double>& values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

/// Medians over a block of the distances from two surfaces, of points that are near either: flying
/// pixels do not move them.
struct BlockMedians {
  double a = 0, b = 0, count = 0;
  /// Variance of one of them, for points with this noise.
  double variance(double noise) const { return 0.5 * kPi * noise * noise / count; }
};
BlockMedians medians_of(const std::vector<std::pair<std::size_t, std::size_t>>& points,
                        const Distances& before, const Distances& after) {
  std::vector<double> one, other;
  for (const auto& [f, k] : points) {
    const double a = before[f][k], b = after[f][k];
    if (!std::isfinite(a) || !std::isfinite(b)) continue;
    if (std::min(std::fabs(a), std::fabs(b)) > kNear) continue;
    one.push_back(a);
    other.push_back(b);
  }
  if (one.empty()) return {};
  return {median_of(one), median_of(other), static_cast<double>(one.size())};
}

/// How the own numbers, each moved by its standard deviation, move the distances.
std::vector<Distances> own_moves(const BaseFit& base, const Linearisation& own, std::size_t r) {
  const Layout& layout = base.data.layout;
  std::vector<Distances> moved;
  for (int k = 0; k < layout.among_own(layout.modes); ++k) {
    FitState state = without_difference(base.data, base.found.state, r);
    state.own[r][k] += base.found.scales.own_sd[k];
    moved.push_back(distances(base.data, own, state, r, kFar));
  }
  return moved;
}

}  // namespace

Distances distances_from(const BaseFit& fit, const std::vector<Prediction>& surfaces,
                         std::size_t r) {
  const FitState plain = without_difference(fit.data, fit.found.state, r);
  return distances(fit.data, {fit.found.state, surfaces}, plain, r, kFar);
}

BlockErrors block_errors(const BaseFit& base, const std::vector<Prediction>& base_surfaces,
                         const BaseFit& model, const std::vector<Prediction>& model_surfaces,
                         std::size_t r, const Linearisation* own) {
  const Distances before = distances_from(base, base_surfaces, r);
  const Distances after = distances_from(model, model_surfaces, r);
  const std::vector<Distances> moved =
      own == nullptr ? std::vector<Distances>() : own_moves(base, *own, r);
  const double noise = base.found.scales.noise.sigma;
  BlockErrors made;
  double base_sum = 0, base_fourth = 0, model_sum = 0, floor_sum = 0;
  for (const auto& [key, points] : blocks_of(base, base_surfaces, r, kSeconds)) {
    const BlockMedians medians = medians_of(points, before, after);
    if (medians.count < kLeast) continue;
    const double square = medians.a * medians.a;
    ++made.blocks;
    base_sum += square;
    base_fourth += square * square;
    model_sum += medians.b * medians.b;
    floor_sum += medians.variance(noise);
    for (const Distances& by : moved) {
      const BlockMedians there = medians_of(points, before, by);
      if (there.count > 0) floor_sum += (there.b - there.a) * (there.b - there.a);
    }
  }
  const auto blocks = static_cast<double>(made.blocks);
  made.base = std::sqrt(base_sum / blocks);
  made.model = std::sqrt(model_sum / blocks);
  made.floor = std::sqrt(floor_sum / blocks);
  const double mean = base_sum / blocks;
  made.base_mse_se = std::sqrt(std::max(base_fourth / blocks - mean * mean, 0.0) / blocks);
  return made;
}

std::vector<FrameGain> frame_gains(const BaseFit& base, const BaseFit& model, std::size_t r) {
  const Distances before = distances_from(base, base.surfaces, r);
  const Distances after = distances_from(model, model.surfaces, r);
  const double noise = base.found.scales.noise.sigma, discrepancy = base.discrepancy_m;
  const Observation& seen = base.data.observations[r];
  std::vector<FrameGain> gains;
  for (const SeenFrame& frame : seen.frames) gains.push_back({frame.t, 0});
  for (const auto& [key, points] : blocks_of(base, base.surfaces, r, 0)) {
    const BlockMedians medians = medians_of(points, before, after);
    if (medians.count < kLeast) continue;
    const double variance = medians.variance(noise) + discrepancy * discrepancy;
    gains[static_cast<std::size_t>(key[2])].gain +=
        (medians.a * medians.a - medians.b * medians.b) / (2 * variance);
  }
  return gains;
}

}  // namespace omentum

#include "mismatch/explain/proposals.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/constants.h"
#include "sim_worker/scene/scene_parts.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kReach = 0.015;    // [m] a point farther from the surface is no tissue
constexpr double kStill = 3e-4;     // [m] moved less: at rest
constexpr double kLifted = 1.5e-3;  // [m] moved more: lifted
constexpr double kSmooth = 0.005;   // [m] radius over which the map is averaged

std::vector<Vector3d> normals_of(const std::vector<Vector3d>& vertices, std::size_t count,
                                 const std::vector<Eigen::Vector3i>& triangles) {
  std::vector<Vector3d> normals(count, Vector3d::Zero());
  for (const Eigen::Vector3i& t : triangles) {
    if (static_cast<std::size_t>(t.maxCoeff()) >= count) continue;  // the lower face, the rim
    const auto at = [&](int k) { return vertices[static_cast<std::size_t>(t[k])]; };
    const Vector3d n = (at(1) - at(0)).cross(at(2) - at(0));
    for (int k = 0; k < 3; ++k) normals[static_cast<std::size_t>(t[k])] += n;
  }
  for (Vector3d& n : normals) n.normalize();
  return normals;
}

struct Means {
  explicit Means(std::size_t places) : sum(places, 0), count(places, 0) {}
  std::vector<double> sum, count;
};

/// Averages over the neighbourhood of each place.
std::vector<double> smoothed(const Means& means, const std::vector<Vector2d>& places) {
  std::vector<double> made(places.size(), std::numeric_limits<double>::quiet_NaN());
  for (std::size_t p = 0; p < places.size(); ++p) {
    double sum = 0, count = 0;
    for (std::size_t q = 0; q < places.size(); ++q) {
      if ((places[p] - places[q]).norm() > kSmooth) continue;
      sum += means.sum[q];
      count += means.count[q];
    }
    constexpr double kLeast = 10;  // points
    if (count >= kLeast) made[p] = sum / count;
  }
  return made;
}

double median_of(std::vector<double> values) {
  std::erase_if(values, [](double v) { return !std::isfinite(v); });
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::ranges::nth_element(values, middle);
  return *middle;
}

/// Largest pull of the jaws in a recording, in the median over recordings [N].
double pull_of_jaws(const BaseFit& base) {
  std::vector<double> most;
  for (const std::size_t r : base.fitted) {
    double largest = 0;
    for (const PredictedFrame& frame : base.coarse_surfaces[r].frames) {
      if (frame.valid) largest = std::max(largest, frame.force.norm());
    }
    most.push_back(largest);
  }
  return median_of(most);
}

Candidate simulated(const std::string& effect, const std::string& key, const std::string& unit,
                    double secant, double sd, bool one_sided) {
  Candidate c;
  c.effect = effect;
  c.key = key;
  c.unit = unit;
  c.secant = secant;
  c.sd = sd;
  c.one_sided = one_sided;
  return c;
}

/// Obstacles where clouds lie highest above the resting surface, and deepest below the lifted one.
void add_obstacles(const ResidualMap& map, std::vector<Candidate>& list) {
  constexpr double kLeast = 1e-3, kMost = 6e-3, kSd = 0.005;  // [m]
  const double rest = median_of(map.at_rest);
  std::size_t below = map.places.size(), above = map.places.size();
  for (std::size_t p = 0; p < map.places.size(); ++p) {
    if (std::isfinite(map.at_rest[p]) &&
        (below == map.places.size() || map.at_rest[p] > map.at_rest[below]))
      below = p;
    if (std::isfinite(map.lifted[p]) &&
        (above == map.places.size() || map.lifted[p] < map.lifted[above]))
      above = p;
  }
  const auto add = [&](std::size_t p, const char* side, double amplitude, double setting) {
    const Vector2d& place = map.places[p];
    Candidate c = simulated(
        "obstacle", fmt::format("obstacle.height@{}:x={:.6g}:y={:.6g}", side, place.x(), place.y()),
        "m", amplitude, kSd, true);
    c.place = place;
    c.setting = setting;
    list.push_back(c);
  };
  if (below < map.places.size())
    add(below, "below", std::clamp(map.at_rest[below] - rest, kLeast, kMost), 0);
  if (above < map.places.size())
    add(above, "above", std::clamp(-map.lifted[above], kLeast, kMost), map.highest[above]);
}

}  // namespace

ResidualMap residual_map(const BaseFit& base) {
  const TissueBody& body = base.data.made.tissue;
  const std::size_t count = body.particles.size();
  ResidualMap map;
  for (const Vector3d& p : body.particles) map.places.push_back(p.head<2>());
  map.highest.assign(count, 0);
  const Eigen::Isometry3d X_BW =
      to_pose(base.data.made.config.tissue().pose(), "scene.tissue.pose").inverse();
  const double lower = -0.5 * base.data.made.config.tissue().thickness_m();
  const Linearisation linear{base.found.state, base.surfaces};
  Means rest(count), lifted(count);
  for (const std::size_t r : base.fitted) {
    const Observation& seen = base.data.observations[r];
    const FitState plain = without_difference(base.data, base.found.state, r);
    const Comparison compared = comparison(base.data, linear, plain, r);
    std::vector<Vector3d> first;
    bool moved = false;
    for (std::size_t f = 0; f < seen.frames.size(); ++f) {
      if (f >= base.surfaces[r].frames.size() || !base.surfaces[r].frames[f].valid) continue;
      const std::vector<Vector3d> vertices = base.data.likelihood.vertices(compared, f);
      if (first.empty()) first = vertices;
      const std::vector<Vector3d> normals =
          normals_of(vertices, count, base.data.likelihood.triangles());
      std::vector<double> by(count);
      for (std::size_t v = 0; v < count; ++v) {
        by[v] = (vertices[v] - first[v]).norm();
        moved = moved || by[v] > kStill;
        const double above = (X_BW * base.surfaces[r].frames[f].vertices[v]).z() - lower;
        map.highest[v] = std::max(map.highest[v], above);
      }
      for (const Vector3d& p : seen.frames[f].points) {
        std::size_t nearest = 0;
        double least = std::numeric_limits<double>::infinity();
        for (std::size_t v = 0; v < count; ++v) {
          const double d = (p - vertices[v]).squaredNorm();
          if (d < least) {
            least = d;
            nearest = v;
          }
        }
        if (least > kReach * kReach) continue;
        const double along = (p - vertices[nearest]).dot(normals[nearest]);
        Means* const of = !moved ? &rest : by[nearest] > kLifted ? &lifted : nullptr;
        if (of == nullptr) continue;
        of->sum[nearest] += along;
        of->count[nearest] += 1;
      }
    }
  }
  map.at_rest = smoothed(rest, map.places);
  map.lifted = smoothed(lifted, map.places);
  return map;
}

std::vector<Candidate> simulated_candidates(const BaseFit& base, const ResidualMap& map,
                                            const std::vector<std::string>& ruled_out) {
  std::vector<Candidate> list;
  add_obstacles(map, list);
  const double pull = pull_of_jaws(base);
  if (pull > 0) {
    constexpr double kSlip = 0.003, kShare = 0.5;
    Candidate slip =
        simulated("grasp_slip", "grasp_slip.total@half_the_pull", "m", kSlip, 0.01, true);
    slip.setting = kShare * pull;
    list.push_back(slip);
  }
  for (const double degrees : {-20.0, 20.0}) {
    list.push_back(simulated("jaw_orientation",
                             fmt::format("jaw_orientation.roll@from={:.0f}deg", degrees), "rad",
                             degrees * kDegree, 1, false));
  }
  // A rigid clamp has a derivative, which holds up to 1e-6 m2/N alone (docs/mismatch.md 5.6).
  constexpr double kGive = 1e-3;  // [m2/N]
  list.push_back(simulated("anchor_compliance",
                           fmt::format("anchor_compliance.inverse_K@of={:g}", kGive), "m2/N", kGive,
                           0.01, true));
  double low = std::numeric_limits<double>::infinity(), high = -low, edge = low;
  for (const Vector2d& p : map.places) {
    low = std::min(low, p.x());
    high = std::max(high, p.x());
    edge = std::min(edge, p.y());
  }
  const double width = high - low, piece = 0.25 * width;
  for (const double share : {0.125, 0.5, 0.875}) {
    Candidate c = simulated(
        "anchor_detachment",
        fmt::format("anchor_detachment.length@of={:.4g}:x={:.6g}", piece, low + share * width), "m",
        piece, 0.05, true);
    c.place = Vector2d(low + share * width, edge);
    list.push_back(c);
  }
  std::erase_if(list,
                [&](const Candidate& c) { return std::ranges::count(ruled_out, c.effect) > 0; });
  return list;
}

}  // namespace omentum

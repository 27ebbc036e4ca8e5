#include "mismatch/calibrate/reference_fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numeric>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "sim_worker/geometry/surface_search.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

using Eigen::Vector3d;
using Eigen::VectorXd;

namespace {

constexpr double kLeastNoise = 2e-4;  // [m] of a point along its ray
constexpr double kLeastForce = 1e-3;  // [N]
constexpr double kOff = 1e-7;         // sd of modes that are not looked for yet [m]

/// Stated prior of a path, its standard deviation in the unit of the number; else `otherwise`.
double stated_sd(const pb::Priors& priors, const std::string& path, double otherwise) {
  for (const pb::Prior& prior : priors.prior()) {
    if (prior.path() == path && prior.sd() > 0) return prior.sd();
  }
  return otherwise;
}

/// slope times (other - base), as a column of a frame.
Eigen::VectorXf difference(const PredictedFrame& other, const PredictedFrame& base, double slope) {
  Eigen::VectorXf by(3 * static_cast<Eigen::Index>(base.vertices.size()) + 3);
  for (std::size_t v = 0; v < base.vertices.size(); ++v) {
    by.segment<3>(3 * static_cast<Eigen::Index>(v)) =
        (slope * (other.vertices[v] - base.vertices[v])).cast<float>();
  }
  by.tail<3>() = (slope * (other.force - base.force)).cast<float>();
  return by;
}

}  // namespace

std::vector<std::size_t> all_of(std::size_t count) {
  std::vector<std::size_t> list(count);
  std::iota(list.begin(), list.end(), std::size_t{0});
  return list;
}

ReferenceFit::ReferenceFit(const pb::Scene& given, std::vector<Observation> seen,
                           const CalibrationOptions& chosen)
    : scene(given), observations(std::move(seen)), options(chosen) {
  if (!options.simulator) options.simulator = std::make_shared<Simulator>(options.threads);
  made = make_scene(scene, options.folder);
  layout.held = scene.has_held_start() ? kHeldColumns : 0;
  layout.markers = static_cast<int>(observations.front().markers.size());
  markers.resize(observations.front().markers.size());
  const TissueBody& body = made.tissue;
  Eigen::AlignedBox3d box;
  for (const Vector3d& p : body.particles) box.extend(p);
  std::vector<Eigen::Vector2d> uv;
  std::vector<Vector3d> rest;
  for (const double side : {0.5, -0.5}) {
    for (const Vector3d& p : body.particles)
      rest.push_back(body.X_WB * (p + side * body.thickness * Vector3d::UnitZ()));
  }
  for (const Vector3d& p : body.particles)
    uv.emplace_back((p - box.min()).head<2>().cwiseQuotient(box.sizes().head<2>()));
  const auto triangles =
      close_sheet(body.surface_triangles, static_cast<int>(body.particles.size()));
  // Motion capture has no one place of a camera to be turned about.
  const bool clouds =
      markers.empty() || std::ranges::any_of(observations, &Observation::has_points);
  const Vector3d pivot = clouds ? observations.front().p_WC : Vector3d(body.X_WB * box.center());
  for (std::size_t k = 0; k < observations.size(); ++k)
    likelihoods_.push_back(std::make_unique<Likelihood>(triangles, rest, uv, pivot));
  for (const Observation& o : observations)
    least_marker_noise_ = std::max(least_marker_noise_, o.marker_noise);
  place_known_markers(triangles, rest);
  const bool with_force = std::ranges::any_of(observations, &Observation::has_force);
  unknowns = unknowns_of(scene, options.priors, with_force);
  set_beliefs();
  first_beliefs = beliefs;
  noise.reach = 0.025;
  noise.sigma = 0.003;
}

void ReferenceFit::set_beliefs() {
  layout.unknowns = static_cast<int>(unknowns.size());
  layout.stiffness = 0;
  OMENTUM_CHECK(unknowns.front().column == "young_modulus", "first is {}", unknowns.front().path);
  beliefs.shared_sd.resize(layout.shared());
  for (std::size_t k = 0; k < unknowns.size(); ++k)
    beliefs.shared_sd[static_cast<Eigen::Index>(k)] = unknowns[k].sd;
  const double metres = stated_sd(options.priors, "scene.depth_sensor.registration_m", 0.003);
  const double turn = kDegree * stated_sd(options.priors, "scene.depth_sensor.registration_deg", 1);
  beliefs.shared_sd.segment<3>(layout.registration()).setConstant(metres);
  beliefs.shared_sd.segment<3>(layout.registration() + 3).setConstant(turn);
  double clock = stated_sd(options.priors, "scene.depth_sensor.time_offset_s", 0);
  for (const Observation& o : observations) clock = std::max(clock, o.clock_sd);
  beliefs.shared_sd[layout.clock()] = clock > 0 ? clock : 0.05;
  for (std::size_t k = 0; k < markers.size(); ++k)
    beliefs.shared_sd.segment<3>(layout.marker(static_cast<int>(k))) = markers[k].sd;
  const VectorXd before = beliefs.own_sd;
  beliefs.own_sd.resize(layout.own());
  beliefs.own_sd.head<2>().setConstant(1.5e-3);  // of the pinch: the paper's arm, 1.7 mm in space
  beliefs.own_sd[2] = 0.05;
  beliefs.own_sd[3] = 0.005;
  beliefs.own_sd.segment<3>(Layout::kOwnForce).setConstant(0.02);  // [N] zero before the jaws close
  beliefs.own_sd[Layout::kOwnForce + 3] = 0.02;                    // gain
  beliefs.own_sd.segment(Layout::kOwnPlace, layout.held).setConstant(0.005);  // [m]
  beliefs.own_sd.tail(kModes).setConstant(kOff);
  if (before.size() == beliefs.own_sd.size()) beliefs.own_sd = before;
}

double independent_share(const std::vector<Block>& blocks) {
  constexpr double kLeast = 0.01;
  double squares = 0, products = 0;
  for (const Block& block : blocks) {
    squares += block.marker_squares;
    products += block.marker_products;
  }
  if (!(squares > 0)) return 1;
  const double alike = std::clamp(products / squares, 0.0, 1.0);
  return std::max(kLeast, (1 - alike) / (1 + alike));  // of a first-order process
}

/// Markers whose place on the body at rest is known sit on its surface at rest.
void ReferenceFit::place_known_markers(const std::vector<Eigen::Vector3i>& triangles,
                                       const std::vector<Vector3d>& rest) {
  constexpr double kAnywhere = 1;   // [m]
  constexpr double kKnown = 0.002;  // [m] of a place that is stated
  SurfaceSearch search(triangles, rest);
  search.fit(rest);
  for (std::size_t k = 0; k < markers.size(); ++k) {
    const auto note = options.markers.by_name.find(observations.front().markers[k]);
    if (note == options.markers.by_name.end() || !note->second.p_B) continue;
    const Vector3d p = made.tissue.X_WB * *note->second.p_B;
    const TrianglePoint foot = search.find(p, rest, kAnywhere);
    if (foot.triangle < 0) throw_error("--markers: {} is nowhere near the body", note->first);
    markers[k] =
        put_marker(triangles[static_cast<std::size_t>(foot.triangle)], foot.share, rest, p);
    markers[k].sd.setConstant(kKnown);
  }
  tell_markers();
}

void ReferenceFit::tell_markers() {
  for (const auto& likelihood : likelihoods_) likelihood->set_markers(markers);
}

bool ReferenceFit::needs_binding() const {
  return !std::ranges::all_of(markers, &MarkerPlace::on_tissue);
}

void ReferenceFit::bind_markers(const std::vector<Prediction>& predictions,
                                std::vector<std::string>& warnings) {
  constexpr double kFar = 0.02;  // [m] from the surface: on no tissue
  const std::vector<Eigen::Vector3i>& triangles = likelihoods_.front()->triangles();
  std::vector<double> distance(markers.size(), -1);  // of those that are not placed
  std::vector<bool> looked_at(markers.size());
  for (std::size_t k = 0; k < markers.size(); ++k) looked_at[k] = markers[k].on_tissue();
  for (std::size_t r = 0; r < predictions.size(); ++r) {
    for (std::size_t f = 0; f < predictions[r].frames.size(); ++f) {
      const PredictedFrame& frame = predictions[r].frames[f];
      if (!frame.valid || observations[r].frames[f].markers.empty()) continue;
      std::optional<SurfaceSearch> search;
      for (const SeenMarker& seen : observations[r].frames[f].markers) {
        const auto k = static_cast<std::size_t>(seen.marker);
        if (looked_at[k]) continue;
        looked_at[k] = true;
        if (!search) {
          search.emplace(triangles, frame.vertices);
          search->fit(frame.vertices);
        }
        const TrianglePoint foot = search->find(seen.p, frame.vertices, 1);
        distance[k] = foot.triangle < 0 ? 1 : std::sqrt(foot.squared);
        if (!(distance[k] < kFar)) continue;
        const Eigen::Vector3i& corner = triangles[static_cast<std::size_t>(foot.triangle)];
        MarkerPlace& place = markers[k];
        const Vector3d sd = place.sd;
        place = put_marker(corner, foot.share, frame.vertices, seen.p);
        // Where the surface is there is only believed.
        Vector3d squares = sd.cwiseAbs2();
        const auto add = [&](int column, double belief) {
          Vector3d by = Vector3d::Zero();
          for (int c = 0; c < 3; ++c) {
            by += foot.share[c] *
                  frame.columns.col(column).segment<3>(3 * corner[c]).cast<double>() * belief;
          }
          squares += (place_marker(place, frame.vertices, Vector3d::Zero()).frame.transpose() * by)
                         .cwiseAbs2();
        };
        for (int c = 0; c < layout.unknowns; ++c) add(c, unknowns[static_cast<std::size_t>(c)].sd);
        for (int c = 0; c < layout.held; ++c)
          add(layout.unknowns + kOwnColumns + c, beliefs.own_sd[Layout::kOwnPlace + c]);
        place.sd = squares.cwiseSqrt();
      }
    }
  }
  std::string far;
  for (std::size_t k = 0; k < markers.size(); ++k) {
    if (markers[k].on_tissue()) continue;
    far += fmt::format("{}{} ({})", far.empty() ? "" : ", ", observations.front().markers[k],
                       distance[k] < 0 ? "seen in no frame that is simulated"
                                       : fmt::format("{:.0f} mm", 1e3 * distance[k]));
  }
  if (!far.empty()) {
    warnings.push_back(
        fmt::format("markers farther than {:.0f} mm from the simulated body are taken "
                    "for none of tissue and left out: {}",
                    1e3 * kFar, far));
  }
  tell_markers();
  set_beliefs();
  first_beliefs = beliefs;
}

FitState ReferenceFit::believed() const {
  FitState state;
  state.shared = VectorXd::Zero(layout.shared());
  state.own.assign(observations.size(), VectorXd::Zero(layout.own()));
  return state;
}

Registration6 ReferenceFit::registration(const FitState& state) const {
  return {state.shared.segment<3>(layout.registration()),
          state.shared.segment<3>(layout.registration() + 3)};
}

VectorXd ReferenceFit::delta(const FitState& at, const FitState& state,
                             std::size_t recording) const {
  VectorXd d = VectorXd::Zero(layout.size());
  for (int k = 0; k < layout.unknowns; ++k) {
    const bool simulated = unknowns[static_cast<std::size_t>(k)].in_scene;
    d[k] = state.shared[k] - (simulated ? at.shared[k] : 0);
  }
  d[layout.clock()] = state.shared[layout.clock()] - at.shared[layout.clock()];
  d.segment(layout.pinch(), 4) = state.own[recording].head(4) - at.own[recording].head(4);
  d.segment(layout.force_zero(), 4) = state.own[recording].segment(Layout::kOwnForce, 4);
  d.segment(layout.place(), layout.held) =
      state.own[recording].segment(Layout::kOwnPlace, layout.held) -
      at.own[recording].segment(Layout::kOwnPlace, layout.held);
  d.segment(layout.modes(), kModes) = state.own[recording].tail(kModes);
  d.segment(layout.marker(0), 3 * layout.markers) =
      state.shared.segment(layout.marker(0), 3 * layout.markers);
  return d;
}

pb::Scene ReferenceFit::scene_of(const FitState& state, std::size_t recording) const {
  const VectorXd& own = state.own[recording];
  pb::Scene at = scene_at(scene, unknowns, state.shared.head(layout.unknowns),
                          {own.head<2>(), own[2], own[3]});
  if (layout.held > 0) {
    pb::HeldStart& held = *at.mutable_held_start();
    pb::Vec3& p = *held.mutable_position_m();
    p.set_x(p.x() + own[Layout::kOwnPlace]);
    p.set_y(p.y() + own[Layout::kOwnPlace + 1]);
    p.set_z(p.z() + own[Layout::kOwnPlace + 2]);
    held.set_until_s(observations[recording].released);
  }
  if (!observations[recording].overrides.empty())
    at = override_scene(at, observations[recording].overrides);
  // One mesh: where lines follow the thickness they jump.
  at.mutable_tissue()->mutable_reference()->set_graded_thickness_m(scene.tissue().thickness_m());
  return at;
}

pb::Scene ReferenceFit::shared_scene(const FitState& state) const {
  return scene_at(scene, unknowns, state.shared.head(layout.unknowns), {});
}

std::vector<Prediction> ReferenceFit::simulate(const FitState& state, const Numerics& numerics,
                                               bool with_columns,
                                               const std::vector<std::size_t>& which) {
  std::vector<Prediction> predictions;
  const auto simulate_all = [&] {
    predictions.assign(observations.size(), {});
    Numerics with = numerics;
    with.slip_speed_m_per_s = slip_speed_;
    run_parallel(which.size(), options.simulator->at_once(), [&](std::size_t k) {
      const std::size_t r = which[k];
      const double clock = state.shared[layout.clock()] + state.own[r][3];
      try {
        predictions[r] = predict(observations[r], scene_of(state, r), options.folder, unknowns,
                                 state.shared.head(layout.unknowns), clock, with, with_columns,
                                 *options.simulator);
      } catch (const Error& error) {
        predictions[r].frames.assign(observations[r].frames.size(), {});
        predictions[r].failure = error.what();
      }
    });
    std::ptrdiff_t valid = 0;
    for (const std::size_t r : which) valid += count_valid(predictions[r]);
    return valid;
  };
  std::size_t wanted = 0;
  for (const std::size_t r : which) wanted += observations[r].frames.size();
  const std::ptrdiff_t valid = simulate_all();
  // Large cells that rub may not come to rest under sharp friction. What is smooth once stays so:
  // the difference of two simulations must not be one of friction.
  constexpr double kSmooth = 1e-4;  // [m/s]
  if (valid < static_cast<std::ptrdiff_t>(wanted) && slip_speed_ < kSmooth &&
      numerics.model == pb::TISSUE_REFERENCE) {
    const std::vector<Prediction> sharp = std::move(predictions);
    slip_speed_ = kSmooth;
    if (simulate_all() <= valid) {
      slip_speed_ = 0;
      predictions = sharp;
    }
  }
  for (const std::size_t r : which) {
    for (std::size_t f = 0; f < predictions[r].frames.size(); ++f) {
      PredictedFrame& frame = predictions[r].frames[f];
      if (frame.columns.size() == 0) continue;
      for (const Difference& d : differences) {
        if (d.by[r][f].size() > 0) frame.columns.col(d.column) = d.by[r][f];
      }
    }
  }
  return predictions;
}

std::vector<Block> ReferenceFit::compare(const std::vector<Prediction>& predictions,
                                         const FitState& at, const std::vector<std::size_t>& which,
                                         const FitState& state, const NoiseModel& with,
                                         bool with_columns) {
  std::vector<Block> blocks(which.size());
  run_parallel(which.size(), options.threads, [&](std::size_t k) {
    const std::size_t r = which[k];
    blocks[k] =
        likelihoods_[r]->compare(observations[r], predictions[r], layout, registration(state),
                                 delta(at, state, r), with, with_columns);
  });
  return blocks;
}

namespace {

std::vector<const Block*> pointers(const std::vector<Block>& blocks) {
  std::vector<const Block*> list;
  for (const Block& block : blocks) list.push_back(&block);
  return list;
}

std::vector<VectorXd> own_of(const FitState& state, const std::vector<std::size_t>& which) {
  std::vector<VectorXd> list;
  for (const std::size_t r : which) list.push_back(state.own[r]);
  return list;
}

}  // namespace

Ranges ReferenceFit::ranges(const FitState& at) const {
  Ranges range{VectorXd::Constant(layout.shared(), -1e9), VectorXd::Constant(layout.shared(), 1e9)};
  const auto near = [&](int k, double reach) {
    range.low[k] = std::max(range.low[k], at.shared[k] - reach);
    range.high[k] = std::min(range.high[k], at.shared[k] + reach);
  };
  for (int k = 0; k < layout.unknowns; ++k) {
    const Unknown& unknown = unknowns[static_cast<std::size_t>(k)];
    const Range whole = range_of(unknown);
    range.low[k] = whole.low;
    range.high[k] = whole.high;
    if (unknown.in_scene) near(k, trust * std::min(0.5, 2 * unknown.sd));
  }
  near(layout.clock(), std::min(0.05 * trust, 0.5 * kWayBeside));
  if (held_clock) range.low[layout.clock()] = range.high[layout.clock()] = *held_clock;
  if (hold_shared) range.low = range.high = at.shared;
  return range;
}

void ReferenceFit::improve(const std::vector<Prediction>& predictions, const FitState& at,
                           const std::vector<std::size_t>& which, int most_steps, FitState& state) {
  const Ranges range = ranges(at);
  // How far one step may go, and how far from `at` a recording's own numbers.
  constexpr double kMostShift = 0.01, kMostTurn = 0.1;  // [m], [rad]
  const double pinch = 0.002 * trust, stiffness = 0.3 * trust, clock = 0.02 * trust;
  const double place = 0.01 * trust;
  const auto inside = [&](FitState& s) {
    s.shared = s.shared.cwiseMax(range.low).cwiseMin(range.high);
    for (const std::size_t r : which) {
      const auto near = [&](int k, double reach) {
        s.own[r][k] = std::clamp(s.own[r][k], at.own[r][k] - reach, at.own[r][k] + reach);
      };
      near(0, pinch);
      near(1, pinch);
      near(2, stiffness);
      near(3, clock);
      for (int k = 0; k < layout.held; ++k) near(Layout::kOwnPlace + k, place);
    }
  };
  inside(state);
  for (int step = 0; step < most_steps; ++step) {
    const std::vector<Block> blocks = compare(predictions, at, which, state, noise, true);
    const auto list = pointers(blocks);
    const auto own = own_of(state, which);
    // Numbers that want to leave their range stay at its end.
    std::vector<bool> fixed(static_cast<std::size_t>(layout.shared()), false);
    ArrowStep found;
    for (bool more = true; more;) {
      found = solve_arrow(list, layout, beliefs, state.shared, own, 1, fixed);
      more = false;
      for (int k = 0; k < layout.shared(); ++k) {
        const double x = state.shared[k], by = found.shared[k];
        // As good as at the end counts: rounding's room would hold all other numbers back.
        const double edge = 1e-6 * (range.high[k] - range.low[k]);
        if ((by > 0 && x >= range.high[k] - edge) || (by < 0 && x <= range.low[k] + edge)) {
          fixed[static_cast<std::size_t>(k)] = true;
          more = true;
        }
      }
    }
    double share = 1, largest = 0;  // the latter against how sure it is
    for (int k = 0; k < layout.shared(); ++k) {
      const double by = found.shared[k];
      const double sd = std::sqrt(std::max(found.shared_covariance(k, k), 1e-30));
      largest = std::max(largest, std::fabs(by) / sd);
      const double room = (by > 0 ? range.high[k] : range.low[k]) - state.shared[k];
      if (by != 0) share = std::min(share, room / by);
    }
    for (int k = 0; k < 6; ++k) {
      const double by = std::fabs(found.shared[layout.registration() + k]);
      const double most = k < 3 ? kMostShift : kMostTurn;
      if (by * share > most) share = most / by;
    }
    const double before = cost(predictions, at, which, state, noise);
    bool better = false;
    constexpr int kHalvings = 5;
    for (int k = 0; k < kHalvings && !better; ++k, share *= 0.5) {
      FitState trial = state;
      trial.shared += share * found.shared;
      for (std::size_t i = 0; i < which.size(); ++i) trial.own[which[i]] += share * found.own[i];
      inside(trial);
      better = cost(predictions, at, which, trial, noise) < before;
      if (better) state = trial;
    }
    noise.sigma = robust_scale(list, &Block::deviation, kLeastNoise);
    noise.force = robust_scale(list, &Block::force_deviation, kLeastForce);
    if (!markers.empty()) {
      noise.marker = robust_scale(list, &Block::marker_deviation, least_marker_noise_);
      noise.marker_share = independent_share(blocks);
    }
    noise.reach = std::clamp(8 * noise.sigma, 0.008, 0.025);
    constexpr double kSmall = 0.05;
    if (!better || largest < kSmall) break;
  }
}

double ReferenceFit::cost(const std::vector<Prediction>& predictions, const FitState& at,
                          const std::vector<std::size_t>& which, const FitState& state,
                          const NoiseModel& with) {
  const std::vector<Block> blocks = compare(predictions, at, which, state, with, false);
  double sum = 0.5 * state.shared.cwiseQuotient(beliefs.shared_sd).squaredNorm();
  for (std::size_t k = 0; k < which.size(); ++k) {
    sum += blocks[k].cost;
    sum += 0.5 * state.own[which[k]].cwiseQuotient(beliefs.own_sd).squaredNorm();
  }
  return sum;
}

ArrowStep ReferenceFit::posterior(const std::vector<Prediction>& predictions, const FitState& at,
                                  const std::vector<std::size_t>& which, const FitState& state) {
  const std::vector<Block> blocks = compare(predictions, at, which, state, noise, true);
  const auto list = pointers(blocks);
  constexpr double kKnown = 1e-6;  // [s]
  Beliefs believed = beliefs;
  if (held_clock) believed.shared_sd[layout.clock()] = kKnown;
  return solve_arrow(list, layout, believed, state.shared, own_of(state, which),
                     row_information(list, noise));
}

void ReferenceFit::adapt_beliefs(const ArrowStep& sure, const std::vector<std::size_t>& which,
                                 const FitState& state) {
  constexpr double kFreedom = 4;       // of what was believed
  constexpr double kMostMode = 0.003;  // [m]
  constexpr double kFirstMode = 1e-4;  // [m]
  const auto adapt = [&](int first, int count, double believed, double most) {
    double squares = kFreedom * believed * believed;
    double number = kFreedom;
    for (std::size_t k = 0; k < which.size(); ++k) {
      for (int j = first; j < first + count; ++j) {
        const double m = state.own[which[k]][j], v = sure.own_sd[k][j];
        squares += m * m + v * v;
        ++number;
      }
    }
    const double sd = std::min(std::sqrt(squares / number), most);
    beliefs.own_sd.segment(first, count).setConstant(sd);
  };
  adapt(0, 2, first_beliefs.own_sd[0], 0.01);
  adapt(2, 1, first_beliefs.own_sd[2], 0.5);
  adapt(3, 1, first_beliefs.own_sd[3], 0.1);
  const int modes = layout.modes() - layout.shared();
  for (int course = 0; course < kCourses; ++course)
    adapt(modes + course * kCosines, kCosines, kFirstMode, kMostMode);
}

std::vector<std::vector<double>> ReferenceFit::distances(const Prediction& prediction,
                                                         std::size_t recording, const FitState& at,
                                                         const FitState& state, double reach) {
  return likelihoods_[recording]->distances(observations[recording], prediction, layout,
                                            registration(state), delta(at, state, recording),
                                            reach);
}

Series ReferenceFit::marker_table(const Prediction& prediction, std::size_t recording,
                                  const FitState& at, const FitState& state) {
  const Observation& seen = observations[recording];
  Series table;
  std::vector<std::size_t> first(markers.size());  // column of each
  for (std::size_t m = 0; m < markers.size(); ++m) {
    first[m] = table.columns.size();
    for (const char* what : {"seen", "simulated"}) {
      for (const char axis : {'x', 'y', 'z'}) {
        if (markers[m].on_tissue())
          table.columns.push_back(fmt::format("{}_{}_{}_m", seen.markers[m], what, axis));
      }
    }
  }
  for (std::size_t k = 0; k < seen.frames.size() && !table.columns.empty(); ++k) {
    const SeenFrame& frame = seen.frames[k];
    if (frame.markers.empty()) continue;
    const std::vector<Vector3d> places = likelihoods_[recording]->marker_places(
        seen, prediction, k, layout, registration(state), delta(at, state, recording));
    table.time_ns.push_back(std::llround(1e9 * frame.t));
    table.values.resize(table.rows() * table.columns.size(), std::nan(""));
    double* row = &table.values[(table.rows() - 1) * table.columns.size()];
    for (std::size_t i = 0; i < frame.markers.size(); ++i) {
      const auto m = static_cast<std::size_t>(frame.markers[i].marker);
      if (!markers[m].on_tissue()) continue;
      Eigen::Map<Vector3d>(row + first[m]) = frame.markers[i].p;
      Eigen::Map<Vector3d>(row + first[m] + 3) = places[i];
    }
  }
  return table;
}

std::vector<Vector3d> ReferenceFit::vertices(const Prediction& prediction, std::size_t recording,
                                             std::size_t frame, const FitState& at,
                                             const FitState& state) const {
  return likelihoods_[recording]->moved(prediction.frames[frame], layout, registration(state),
                                        delta(at, state, recording), Eigen::Vector4d::Zero());
}

void ReferenceFit::change_law(pb::ElasticLaw law) {
  scene.mutable_tissue()->mutable_material()->set_law(law);
}

void ReferenceFit::set_difference(const Unknown& unknown, const std::vector<Prediction>& other,
                                  double slope, std::vector<Prediction>& base, FitState& at,
                                  FitState& state) {
  const auto found = std::ranges::find(unknowns, unknown.path, &Unknown::path);
  const auto place = static_cast<int>(found - unknowns.begin());
  const bool added = found == unknowns.end();
  if (added) {
    unknowns.push_back(unknown);
    set_beliefs();
    const auto widen = [&](VectorXd& shared) {
      VectorXd wide = VectorXd::Zero(shared.size() + 1);
      wide.head(place) = shared.head(place);
      const auto behind = shared.size() - place;
      wide.tail(behind) = shared.tail(behind);
      shared = wide;
    };
    widen(at.shared);
    widen(state.shared);
  }
  std::erase_if(differences, [&](const Difference& d) { return d.column == place; });
  Difference& kept = differences.emplace_back(Difference{place, {}});
  for (std::size_t r = 0; r < base.size(); ++r) {
    std::vector<Eigen::VectorXf>& by = kept.by.emplace_back(observations[r].frames.size());
    for (std::size_t f = 0; f < base[r].frames.size(); ++f) {
      PredictedFrame& frame = base[r].frames[f];
      if (frame.columns.size() == 0) continue;
      if (added) {
        Eigen::MatrixXf wide =
            Eigen::MatrixXf::Zero(frame.columns.rows(), frame.columns.cols() + 1);
        wide.leftCols(place) = frame.columns.leftCols(place);
        const auto behind = frame.columns.cols() - place;
        wide.rightCols(behind) = frame.columns.rightCols(behind);
        frame.columns = std::move(wide);
      }
      if (f < other[r].frames.size() && other[r].frames[f].valid) {
        by[f] = difference(other[r].frames[f], frame, slope);
        frame.columns.col(place) = by[f];
      }
    }
  }
}

}  // namespace omentum

#include "mismatch/calibrate/reference_fit.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/check.h"
#include "core/constants.h"
#include "mismatch/simulation.h"

namespace omentum {

using Eigen::Vector3d;
using Eigen::VectorXd;

namespace {

constexpr double kLeastNoise = 2e-4;  // [m] of a point along its ray
constexpr double kOff = 1e-7;         // sd of modes that are not looked for yet [m]

/// Stated prior of a path, its standard deviation in the unit of the number; else `otherwise`.
double stated_sd(const pb::Priors& priors, const std::string& path, double otherwise) {
  for (const pb::Prior& prior : priors.prior()) {
    if (prior.path() == path && prior.sd() > 0) return prior.sd();
  }
  return otherwise;
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
  made = make_scene(scene, options.folder);
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
  for (std::size_t k = 0; k < observations.size(); ++k)
    likelihoods_.push_back(
        std::make_unique<Likelihood>(triangles, rest, uv, body.X_WB.translation()));
  unknowns = unknowns_of(scene, options.priors);
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
  const VectorXd before = beliefs.own_sd;
  beliefs.own_sd.resize(layout.own());
  beliefs.own_sd.head<2>().setConstant(1.5e-3);  // of the pinch: the paper's arm, 1.7 mm in space
  beliefs.own_sd[2] = 0.05;
  beliefs.own_sd[3] = 0.005;
  beliefs.own_sd.tail(kModes).setConstant(kOff);
  if (before.size() == beliefs.own_sd.size()) beliefs.own_sd = before;
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
    const bool simulated = unknowns[static_cast<std::size_t>(k)].is_parameter;
    d[k] = state.shared[k] - (simulated ? at.shared[k] : 0);
  }
  d[layout.clock()] = state.shared[layout.clock()] - at.shared[layout.clock()];
  d.segment(layout.pinch(), 4) = state.own[recording].head(4) - at.own[recording].head(4);
  d.segment(layout.modes(), kModes) = state.own[recording].tail(kModes);
  return d;
}

pb::Scene ReferenceFit::scene_of(const FitState& state, std::size_t recording) const {
  const VectorXd& own = state.own[recording];
  return scene_at(scene, unknowns, state.shared.head(layout.unknowns),
                  {own.head<2>(), own[2], own[3]});
}

pb::Scene ReferenceFit::shared_scene(const FitState& state) const {
  return scene_at(scene, unknowns, state.shared.head(layout.unknowns), {});
}

std::vector<Prediction> ReferenceFit::simulate(const FitState& state, const Numerics& numerics,
                                               bool with_columns,
                                               const std::vector<std::size_t>& which) const {
  std::vector<Prediction> predictions(observations.size());
  run_parallel(which.size(), options.threads, [&](std::size_t k) {
    const std::size_t r = which[k];
    const double clock = state.shared[layout.clock()] + state.own[r][3];
    predictions[r] = predict(observations[r], scene_of(state, r), options.folder, unknowns,
                             state.shared.head(layout.unknowns), clock, numerics, with_columns);
  });
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

void ReferenceFit::improve(const std::vector<Prediction>& predictions, const FitState& at,
                           const std::vector<std::size_t>& which, int most_steps, FitState& state) {
  for (int step = 0; step < most_steps; ++step) {
    const std::vector<Block> blocks = compare(predictions, at, which, state, noise, true);
    const auto list = pointers(blocks);
    const ArrowStep found =
        solve_arrow(list, layout, beliefs, state.shared, own_of(state, which), 1);
    // What the first order may be trusted for.
    double share = 1;
    const auto limit = [&](double change, double most) {
      if (std::fabs(change) * share > most) share = most / std::fabs(change);
    };
    double largest = 0;  // against how sure it is
    for (int k = 0; k < layout.shared(); ++k) {
      const double sd = std::sqrt(std::max(found.shared_covariance(k, k), 1e-30));
      largest = std::max(largest, std::fabs(found.shared[k]) / sd);
      if (k < layout.unknowns) limit(found.shared[k], 0.7);
    }
    for (int k = 0; k < 3; ++k) {
      limit(found.shared[layout.registration() + k], 0.01);
      limit(found.shared[layout.registration() + 3 + k], 0.1);
    }
    limit(found.shared[layout.clock()], 0.03);
    for (const VectorXd& own : found.own) {
      for (int k = 0; k < 2; ++k) limit(own[k], 0.002);
    }
    state.shared += share * found.shared;
    for (std::size_t k = 0; k < which.size(); ++k) state.own[which[k]] += share * found.own[k];
    for (int k = 0; k < layout.unknowns; ++k) {
      const Unknown& unknown = unknowns[static_cast<std::size_t>(k)];
      const double most = 3 * unknown.sd;
      state.shared[k] = std::clamp(state.shared[k], -most, most);
    }
    noise.sigma = robust_scale(list, kLeastNoise);
    noise.reach = std::clamp(8 * noise.sigma, 0.008, 0.025);
    constexpr double kSmall = 0.05;
    if (largest < kSmall && share == 1) break;
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
  return solve_arrow(list, layout, beliefs, state.shared, own_of(state, which),
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
  adapt(4, kModes / 2, kFirstMode, kMostMode);
  adapt(4 + kModes / 2, kModes / 2, kFirstMode, kMostMode);
}

std::vector<std::vector<double>> ReferenceFit::distances(const Prediction& prediction,
                                                         std::size_t recording, const FitState& at,
                                                         const FitState& state, double reach) {
  return likelihoods_[recording]->distances(observations[recording], prediction, layout,
                                            registration(state), delta(at, state, recording),
                                            reach);
}

std::vector<Vector3d> ReferenceFit::vertices(const Prediction& prediction, std::size_t recording,
                                             std::size_t frame, const FitState& at,
                                             const FitState& state) const {
  return likelihoods_[recording]->moved(prediction.frames[frame], layout, registration(state),
                                        delta(at, state, recording), 0);
}

void ReferenceFit::change_law(pb::ElasticLaw law, FitState& state) {
  const std::vector<Unknown> before = unknowns;
  const VectorXd tail = state.shared.tail(7);
  const VectorXd numbers = state.shared.head(layout.unknowns);
  scene.mutable_tissue()->mutable_material()->set_law(law);
  unknowns = unknowns_of(scene, options.priors);
  set_beliefs();
  state.shared = VectorXd::Zero(layout.shared());
  state.shared.tail(7) = tail;
  for (std::size_t k = 0; k < unknowns.size(); ++k) {
    const auto found = std::find_if(before.begin(), before.end(), [&](const Unknown& u) {
      return u.path == unknowns[k].path && u.is_parameter;
    });
    if (found != before.end())
      state.shared[static_cast<Eigen::Index>(k)] = numbers[found - before.begin()];
  }
}

void ReferenceFit::add_difference(const Unknown& unknown, const std::vector<Prediction>& other,
                                  double slope, std::vector<Prediction>& base, FitState& at,
                                  FitState& state) {
  const int place = layout.unknowns;
  unknowns.push_back(unknown);
  set_beliefs();
  const auto widen = [&](VectorXd& shared) {
    VectorXd wide = VectorXd::Zero(shared.size() + 1);
    wide.head(place) = shared.head(place);
    wide.tail(7) = shared.tail(7);
    shared = wide;
  };
  widen(at.shared);
  widen(state.shared);
  for (std::size_t r = 0; r < base.size(); ++r) {
    for (std::size_t f = 0; f < base[r].frames.size(); ++f) {
      PredictedFrame& frame = base[r].frames[f];
      if (frame.columns.size() == 0) continue;
      Eigen::MatrixXf wide = Eigen::MatrixXf::Zero(frame.columns.rows(), frame.columns.cols() + 1);
      wide.leftCols(place) = frame.columns.leftCols(place);
      wide.rightCols(kOwnColumns) = frame.columns.rightCols(kOwnColumns);
      const bool known = f < other[r].frames.size() && other[r].frames[f].valid;
      for (std::size_t v = 0; known && v < frame.vertices.size(); ++v) {
        const Vector3d by = slope * (other[r].frames[f].vertices[v] - frame.vertices[v]);
        wide.block<3, 1>(3 * static_cast<Eigen::Index>(v), place) = by.cast<float>();
      }
      frame.columns = std::move(wide);
    }
  }
}

}  // namespace omentum

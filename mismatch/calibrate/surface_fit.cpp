#include "mismatch/calibrate/surface_fit.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "mismatch/calibrate/marker_binding.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

using Eigen::Vector3d;
using Eigen::VectorXd;

namespace {

constexpr double kOff = 1e-7;  // sd of modes that are not looked for yet [m]

/// Stated prior of a path, its standard deviation in the unit of the number; else `otherwise`.
double stated_sd(const pb::Priors& priors, const std::string& path, double otherwise) {
  for (const pb::Prior& prior : priors.prior()) {
    if (prior.path() == path && prior.sd() > 0) return prior.sd();
  }
  return otherwise;
}

}  // namespace

Eigen::VectorXf difference(const PredictedFrame& other, const PredictedFrame& base, double slope) {
  Eigen::VectorXf by(3 * static_cast<Eigen::Index>(base.vertices.size()) + 3);
  for (std::size_t v = 0; v < base.vertices.size(); ++v) {
    by.segment<3>(3 * static_cast<Eigen::Index>(v)) =
        (slope * (other.vertices[v] - base.vertices[v])).cast<float>();
  }
  by.tail<3>() = (slope * (other.force - base.force)).cast<float>();
  return by;
}

std::vector<std::size_t> all_of(std::size_t count) {
  std::vector<std::size_t> list(count);
  std::iota(list.begin(), list.end(), std::size_t{0});
  return list;
}

SurfaceFit::SurfaceFit(const pb::Scene& given, std::vector<Observation> seen,
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
  // Motion capture has no one place of a camera to be turned about, nor have fused clouds.
  const bool camera =
      (markers.empty() || std::ranges::any_of(observations, &Observation::has_points)) &&
      std::ranges::all_of(observations, &Observation::rays);
  const Vector3d pivot = camera ? observations.front().p_WC : Vector3d(body.X_WB * box.center());
  for (std::size_t k = 0; k < observations.size(); ++k)
    likelihoods_.push_back(std::make_unique<Likelihood>(triangles, rest, uv, pivot));
  for (const Observation& o : observations)
    least_marker_noise_ = std::max(least_marker_noise_, o.marker_noise);
  place_known_markers(options.markers, observations.front().markers, made.tissue.X_WB, triangles,
                      rest, markers);
  tell_markers();
  const bool with_force = std::ranges::any_of(observations, &Observation::has_force);
  unknowns = unknowns_of(scene, options.priors, with_force);
  set_beliefs();
  first_beliefs = beliefs;
  noise.reach = 0.025;
  noise.sigma = 0.003;
}

void SurfaceFit::set_beliefs() {
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

void SurfaceFit::tell_markers() {
  for (const auto& likelihood : likelihoods_) likelihood->set_markers(markers);
}

void SurfaceFit::set_markers(std::vector<MarkerPlace> places) {
  markers = std::move(places);
  tell_markers();
  set_beliefs();
  first_beliefs = beliefs;
}

FitState SurfaceFit::believed() const {
  FitState state;
  state.shared = VectorXd::Zero(layout.shared());
  state.own.assign(observations.size(), VectorXd::Zero(layout.own()));
  return state;
}

Registration6 SurfaceFit::registration(const FitState& state) const {
  return {state.shared.segment<3>(layout.registration()),
          state.shared.segment<3>(layout.registration() + 3)};
}

VectorXd SurfaceFit::delta(const FitState& at, const FitState& state, std::size_t recording) const {
  VectorXd d = VectorXd::Zero(layout.size());
  for (int k = 0; k < layout.unknowns; ++k) {
    const bool simulated = unknowns[static_cast<std::size_t>(k)].simulated;
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

pb::Scene SurfaceFit::scene_of(const FitState& state, std::size_t recording) const {
  const VectorXd& own = state.own[recording];
  pb::Scene at = scene_at(scene, unknowns, state.shared.head(layout.unknowns),
                          {own.head<2>(), own[2], own[3]}, held_place());
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

pb::Scene SurfaceFit::shared_scene(const FitState& state) const {
  return scene_at(scene, unknowns, state.shared.head(layout.unknowns), {}, held_place());
}

Eigen::Vector2d SurfaceFit::held_place() const { return observations.front().pinch; }

Prediction SurfaceFit::predict_one(const FitState& state, std::size_t r, const Numerics& numerics,
                                   bool with_columns) const {
  const double clock = state.shared[layout.clock()] + state.own[r][3];
  const auto period = std::ranges::find(unknowns, kFramePeriodPath, &Unknown::path);
  std::optional<Observation> in_time;
  if (period != unknowns.end()) {
    const double x = state.shared[period - unknowns.begin()];
    in_time = stretched(observations[r], period->value(x) / period->believed);
  }
  try {
    return predict(in_time ? *in_time : observations[r], scene_of(state, r), options.folder,
                   unknowns, state.shared.head(layout.unknowns), clock, numerics, with_columns,
                   *options.simulator);
  } catch (const Error& error) {
    Prediction failed;
    failed.frames.assign(observations[r].frames.size(), {});
    failed.failure = error.what();
    return failed;
  }
}

std::vector<Prediction> SurfaceFit::simulate(const FitState& state, const Numerics& numerics,
                                             bool with_columns,
                                             const std::vector<std::size_t>& which) {
  std::vector<Prediction> predictions = predict_all(state, numerics, with_columns, which);
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

std::vector<std::vector<double>> SurfaceFit::distances(const Prediction& prediction,
                                                       std::size_t recording, const FitState& at,
                                                       const FitState& state, double reach) {
  return likelihoods_[recording]->distances(observations[recording], prediction, layout,
                                            registration(state), delta(at, state, recording),
                                            reach);
}

std::vector<Vector3d> SurfaceFit::marker_places(const Prediction& prediction, std::size_t recording,
                                                std::size_t frame, const FitState& at,
                                                const FitState& state) {
  return likelihoods_[recording]->marker_places(observations[recording], prediction, frame, layout,
                                                registration(state), delta(at, state, recording));
}

std::vector<Vector3d> SurfaceFit::vertices(const Prediction& prediction, std::size_t recording,
                                           std::size_t frame, const FitState& at,
                                           const FitState& state) const {
  return likelihoods_[recording]->moved(prediction.frames[frame], layout, registration(state),
                                        delta(at, state, recording), Eigen::Vector4d::Zero());
}

void SurfaceFit::change_law(pb::ElasticLaw law) {
  scene.mutable_tissue()->mutable_material()->set_law(law);
}

void SurfaceFit::set_difference(const Unknown& unknown, const std::vector<Prediction>& other,
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
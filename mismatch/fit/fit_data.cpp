#include "mismatch/fit/fit_data.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <optional>
#include <utility>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "mismatch/fit/marker_binding.h"
#include "sim_worker/scene/clamp_rows.h"

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

/// What is stated of the camera's clock, of the set-up or by recordings [s]; 0: nothing.
double stated_clock_sd(const FitData& data) {
  double stated = stated_sd(data.setup.priors, "scene.depth_sensor.time_offset_s", 0);
  for (const Observation& o : data.observations) stated = std::max(stated, o.clock_sd);
  return stated;
}

VectorXd own_beliefs(const FitData& data) {
  const Layout& layout = data.layout;
  VectorXd sd(layout.own());
  const auto set = [&](const Layout::Columns& columns, double value) {
    sd.segment(layout.among_own(columns), columns.count).setConstant(value);
  };
  set(layout.pinch, 1.5e-3);  // [m] the paper's arm, 1.7 mm in space
  set(layout.stiffness_factor, 0.05);
  constexpr double kClock = 0.005;  // [s]
  set(layout.own_clock,
      data.setup.independent_clocks ? std::max(kClock, stated_clock_sd(data)) : kClock);
  set(layout.force_zero, 0.02);  // [N] before the jaws close
  set(layout.force_gain, 0.02);
  set(layout.held_place, 0.005);  // [m]
  set(layout.modes, kOff);
  return sd;
}

VectorXd shared_beliefs(const FitData& data) {
  const Layout& layout = data.layout;
  const pb::Priors& priors = data.setup.priors;
  VectorXd sd(layout.shared());
  for (std::size_t k = 0; k < data.unknowns.size(); ++k)
    sd[static_cast<Eigen::Index>(k)] = data.unknowns[k].sd;
  const double metres = stated_sd(priors, "scene.depth_sensor.registration_m", 0.003);
  const double turn = kDegree * stated_sd(priors, "scene.depth_sensor.registration_deg", 1);
  sd.segment<3>(layout.registration.begin).setConstant(metres);
  sd.segment<3>(layout.registration.begin + 3).setConstant(turn);
  constexpr double kNone = 1e-3, kUnstated = 0.05;  // [s]
  const double clock = stated_clock_sd(data);
  sd[layout.clock.begin] = clock == 0 ? kUnstated : data.setup.independent_clocks ? kNone : clock;
  const std::vector<MarkerPlace>& markers = data.likelihood.markers();
  for (std::size_t k = 0; k < markers.size(); ++k)
    sd.segment<3>(layout.marker(static_cast<int>(k))) = markers[k].sd;
  return sd;
}

/// The body at rest as cameras and discrepancies know it.
Likelihood make_likelihood(const Scene& made, const std::vector<Observation>& observations,
                           const FitSetup& setup) {
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
  std::vector<MarkerPlace> markers(observations.front().markers.size());
  // Motion capture has no one place of a camera to be turned about, nor have fused clouds.
  const bool camera =
      (markers.empty() || std::ranges::any_of(observations, &Observation::has_points)) &&
      std::ranges::all_of(observations, &Observation::rays);
  const Vector3d pivot = camera ? observations.front().p_WC : Vector3d(body.X_WB * box.center());
  place_known_markers(setup.markers, observations.front().markers, body.X_WB, triangles, rest,
                      markers);
  Likelihood likelihood(triangles, rest, std::move(uv), pivot, setup.cosines_per_side);
  likelihood.set_markers(std::move(markers));
  // The bar of a clamp lies on what it holds.
  const pb::Tissue& tissue = made.config.tissue();
  std::vector<bool> covered(rest.size(), false);
  for (std::size_t p = 0; p < body.particles.size(); ++p) {
    const double y = body.particles[p].y();
    covered[p] = in_lower_clamp(tissue, y) || in_upper_clamp(tissue, y);
  }
  likelihood.set_covered(std::move(covered));
  return likelihood;
}

}  // namespace

FitData make_fit_data(const pb::Scene& scene, std::vector<Observation> observations,
                      const FitSetup& setup) {
  Scene made = make_scene(scene, setup.folder);
  Likelihood likelihood = make_likelihood(made, observations, setup);
  FitData data{
      scene, std::move(made), setup, std::move(observations), {}, {}, {}, std::move(likelihood), 0,
      {}};
  if (!data.setup.simulator) data.setup.simulator = std::make_shared<Simulator>(setup.threads);
  for (const Observation& o : data.observations)
    data.least_marker_noise = std::max(data.least_marker_noise, o.marker_noise);
  const bool with_force = std::ranges::any_of(data.observations, &Observation::has_force);
  set_unknowns(unknowns_of(scene, setup.priors, with_force), data);
  return data;
}

void set_unknowns(std::vector<Unknown> unknowns, FitData& data) {
  OMENTUM_CHECK(unknowns.front().column == "young_modulus", "first is {}", unknowns.front().path);
  data.unknowns = std::move(unknowns);
  data.layout = Layout(static_cast<int>(data.unknowns.size()),
                       static_cast<int>(data.likelihood.markers().size()),
                       data.scene.has_held_start() ? kHeldColumns : 0,
                       data.setup.cosines_per_side * data.setup.cosines_per_side);
  data.beliefs = {shared_beliefs(data), own_beliefs(data)};
}

void set_markers(std::vector<MarkerPlace> places, FitData& data) {
  data.likelihood.set_markers(std::move(places));
  set_unknowns(std::move(data.unknowns), data);
}

FitState believed_state(const FitData& data) {
  FitState state;
  state.shared = VectorXd::Zero(data.layout.shared());
  state.own.assign(data.observations.size(), VectorXd::Zero(data.layout.own()));
  return state;
}

Registration6 registration_of(const FitData& data, const FitState& state) {
  const int begin = data.layout.registration.begin;
  return {state.shared.segment<3>(begin), state.shared.segment<3>(begin + 3)};
}

FitState without_difference(const FitData& data, FitState state, std::size_t recording) {
  state.own[recording].tail(data.layout.modes.count).setZero();
  return state;
}

Comparison comparison(const FitData& data, const Linearisation& linear, const FitState& state,
                      std::size_t r) {
  const Layout& layout = data.layout;
  const FitState& at = linear.at;
  VectorXd d = VectorXd::Zero(layout.size());
  for (int k = 0; k < layout.unknowns.count; ++k) {
    const bool simulated = data.unknowns[static_cast<std::size_t>(k)].simulated();
    d[k] = state.shared[k] - (simulated ? at.shared[k] : 0);
  }
  d[layout.clock.begin] = state.shared[layout.clock.begin] - at.shared[layout.clock.begin];
  d.segment(layout.markers.begin, layout.markers.count) =
      state.shared.segment(layout.markers.begin, layout.markers.count);
  // What is simulated counts from where it was; forces and modes act to first order alone.
  d.tail(layout.own()) = state.own[r];
  for (const Layout::Columns& columns :
       {layout.pinch, layout.stiffness_factor, layout.own_clock, layout.held_place})
    d.segment(columns.begin, columns.count) -=
        at.own[r].segment(layout.among_own(columns), columns.count);
  return {data.observations[r], linear.predictions[r], layout, registration_of(data, state),
          std::move(d)};
}

pb::Scene scene_of(const FitData& data, const FitState& state, std::size_t recording) {
  const Layout& layout = data.layout;
  const VectorXd& own = state.own[recording];
  pb::Scene at = scene_at(
      data.scene, data.unknowns, state.shared.head(layout.unknowns.count),
      {own.segment<2>(layout.among_own(layout.pinch)),
       own[layout.among_own(layout.stiffness_factor)], own[layout.among_own(layout.own_clock)]},
      held_place(data));
  if (layout.held_place.count > 0) {
    const int place = layout.among_own(layout.held_place);
    pb::HeldStart& held = *at.mutable_held_start();
    pb::Vec3& p = *held.mutable_position_m();
    p.set_x(p.x() + own[place]);
    p.set_y(p.y() + own[place + 1]);
    p.set_z(p.z() + own[place + 2]);
    held.set_until_s(data.observations[recording].released);
  }
  if (!data.observations[recording].overrides.empty())
    at = override_scene(at, data.observations[recording].overrides);
  // One mesh: where lines follow the thickness they jump.
  at.mutable_tissue()->mutable_reference()->set_graded_thickness_m(
      data.scene.tissue().thickness_m());
  return at;
}

pb::Scene shared_scene(const FitData& data, const FitState& state) {
  return scene_at(data.scene, data.unknowns, state.shared.head(data.layout.unknowns.count), {},
                  held_place(data));
}

Eigen::Vector2d held_place(const FitData& data) { return data.observations.front().pinch; }

Prediction predict_at(const FitData& data, const FitState& state, std::size_t r,
                      const Numerics& numerics, bool with_columns) {
  const Layout& layout = data.layout;
  const std::vector<Unknown>& unknowns = data.unknowns;
  const double clock =
      state.shared[layout.clock.begin] + state.own[r][layout.among_own(layout.own_clock)];
  const auto period = std::ranges::find(unknowns, kFramePeriodPath, &Unknown::path);
  std::optional<Observation> in_time;
  if (period != unknowns.end()) {
    const double x = state.shared[period - unknowns.begin()];
    in_time = stretched(data.observations[r], period->value(x) / period->believed);
  }
  const Observation& seen = in_time ? *in_time : data.observations[r];
  pb::Scene scene;
  try {
    scene = scene_of(data, state, r);
  } catch (const Error& error) {  // an override for this recording that cannot be
    return failed_prediction(seen, error.what());
  }
  return predict(seen, scene, data.setup.folder, unknowns, state.shared.head(layout.unknowns.count),
                 clock, numerics, with_columns, *data.setup.simulator);
}

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

void set_difference(const Unknown& unknown, const std::vector<Prediction>& other, double slope,
                    FitData& data, Linearisation& base, FitState& state) {
  std::vector<Unknown> unknowns = data.unknowns;
  const auto found = std::ranges::find(unknowns, unknown.path, &Unknown::path);
  const auto place = static_cast<int>(found - unknowns.begin());
  const bool added = found == unknowns.end();
  if (added) {
    unknowns.push_back(unknown);
    set_unknowns(unknowns, data);
    const auto widen = [&](VectorXd& shared) {
      VectorXd wide = VectorXd::Zero(shared.size() + 1);
      wide.head(place) = shared.head(place);
      const auto behind = shared.size() - place;
      wide.tail(behind) = shared.tail(behind);
      shared = wide;
    };
    widen(base.at.shared);
    widen(state.shared);
  }
  std::erase_if(data.differences, [&](const DifferenceColumn& d) { return d.column == place; });
  DifferenceColumn& kept = data.differences.emplace_back(DifferenceColumn{place, {}});
  for (std::size_t r = 0; r < base.predictions.size(); ++r) {
    std::vector<Eigen::VectorXf>& by = kept.by.emplace_back(data.observations[r].frames.size());
    for (std::size_t f = 0; f < base.predictions[r].frames.size(); ++f) {
      PredictedFrame& frame = base.predictions[r].frames[f];
      if (added && frame.columns.size() > 0) {
        OMENTUM_CHECK(frame.columns.cols() >= place, "columns of other unknowns: {} of {}",
                      frame.columns.cols(), place);
        Eigen::MatrixXf wide =
            Eigen::MatrixXf::Zero(frame.columns.rows(), frame.columns.cols() + 1);
        wide.leftCols(place) = frame.columns.leftCols(place);
        const auto behind = frame.columns.cols() - place;
        wide.rightCols(behind) = frame.columns.rightCols(behind);
        frame.columns = std::move(wide);
      }
      if (frame.valid && f < other[r].frames.size() && other[r].frames[f].valid) {
        by[f] = difference(other[r].frames[f], frame, slope);
        if (frame.columns.size() > 0) frame.columns.col(place) = by[f];
      }
    }
  }
}

}  // namespace omentum
#include "sim_worker/playback/simulate.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/machine_memory.h"
#include "sim_worker/backend/control_step.h"

namespace omentum {

using Eigen::Vector3d;

SeenState seen_at(const SimulatedRecording& recording, double t) {
  const std::vector<double>& time = recording.time;
  const auto after = std::upper_bound(time.begin(), time.end(), t);
  if (after == time.begin()) return {recording.surface.front(), recording.tip.front()};
  const auto k = static_cast<std::size_t>(after - time.begin()) - 1;
  if (k + 1 >= time.size()) return {recording.surface.back(), recording.tip.back()};
  const double share = (t - time[k]) / (time[k + 1] - time[k]);
  if (share == 0) return {recording.surface[k], recording.tip[k]};
  SeenState seen;
  seen.tip = recording.tip[k] + share * (recording.tip[k + 1] - recording.tip[k]);
  for (std::size_t i = 0; i < recording.surface[k].size(); ++i) {
    const float low = recording.surface[k][i];
    seen.surface.push_back(low + static_cast<float>(share) * (recording.surface[k + 1][i] - low));
  }
  return seen;
}

namespace {

/// Throws Error where what the steps leave does not fit into memory.
void check_memory(const ToolTrack& track, double period, const Tissue<double>& tissue) {
  const double steps = std::ceil((track.end() - track.begin()) / period - 1e-9);
  const double faces = dynamic_cast<const ReferenceTissue*>(&tissue) != nullptr ? 2 : 1;
  const double step_bytes = faces * static_cast<double>(sizeof(Vector3d)) * tissue.particles() +
                            faces * 3.0 * sizeof(float) * tissue.surface_vertices() +
                            500;  // tip, arm, time
  const double bytes = (steps + 1) * step_bytes;
  if (const double memory = machine_memory(); !(bytes <= memory)) {
    throw_error(
        "{}: {:.6g} s of commands are {:.4g} steps of {} s with {} nodes and need {:.3g} GB "
        "of memory, allowed {:.3g} GB (what there is)",
        track.path, track.end() - track.begin(), steps, period, tissue.particles(), bytes / 1e9,
        memory / 1e9);
  }
}

/// A recording without a jaw is one of tissue that is held all the time.
bool is_closed(const ToolTrack& track, const GraspSettings& grasp, double t) {
  return track.jaw_rad.empty() || track.jaw_at(t) <= grasp.closed_rad;
}

void add_surface(Tissue<double>& tissue, SimulatedRecording& result) {
  std::vector<Vector3d>& points = result.points.emplace_back();
  std::vector<float>& surface = result.surface.emplace_back();
  if (const auto* reference = dynamic_cast<const ReferenceTissue*>(&tissue)) {
    const auto& model = static_cast<const ReferenceTissueModel&>(reference->model());
    for (const BodyPoint& point : model.upper_points) points.push_back(reference->point(point));
    for (const BodyPoint& point : model.lower_points) points.push_back(reference->point(point));
    for (const Vector3d& p : points) {
      for (const double c : p) surface.push_back(static_cast<float>(c));
    }
    return;
  }
  for (int i = 0; i < tissue.particles(); ++i) points.push_back(tissue.position(0, i));
  const double* drawn = tissue.surface_positions();
  surface.assign(drawn, drawn + 3L * tissue.surface_vertices());
}

/// Every free point moves at this velocity in W [m/s].
void start_moving(Tissue<double>& tissue, const Vector3d& velocity) {
  if (auto* reference = dynamic_cast<ReferenceTissue*>(&tissue))
    return reference->start_moving(velocity);
  const std::vector<std::uint8_t>& fixed = tissue.model().body.fixed;
  for (int i = 0; i < tissue.particles(); ++i) {
    if (fixed[static_cast<std::size_t>(i)] == 0) tissue.set_velocity(0, i, velocity);
  }
}

}  // namespace

double settle(Tissue<double>& tissue, const Vector3d& tip, const std::function<bool()>& stop) {
  constexpr double kAtRest = 1e-4;  // [m/s]
  constexpr double kFor = 0.2;      // [s] a swing stands still at its ends
  constexpr double kMaxTime = 30;   // [s]
  if (auto* reference = dynamic_cast<ReferenceTissue*>(&tissue)) return reference->settle(tip);
  const double period = tissue.model().control_period;
  const ToolMotion standing{tip, tip};
  tissue.stop_clock(0, true);
  double speed = 0;
  double resting = 0;
  for (double t = 0; t < kMaxTime && resting < kFor && tissue.healthy(0); t += period) {
    if (stop && stop()) break;
    tissue.step({&standing, 1});
    speed = 0;
    for (int i = 0; i < tissue.particles(); ++i)
      speed = std::max(speed, tissue.velocity(0, i).norm());
    resting = speed <= kAtRest ? resting + period : 0;
  }
  tissue.stop_clock(0, false);
  return speed;
}

void hold_at_start(Tissue<double>& tissue, const HeldBody& held) {
  constexpr double kSpeed = 0.02;  // [m/s]
  const TissueModel& model = tissue.model();
  const Vector3d from = model.body.X_WB * Vector3d(held.place.x(), held.place.y(), 0);
  tissue.hold(0, from, held.radius, false);
  if (tissue.held(0).empty()) {
    throw_error(
        "scene.held_start: no tissue within {} m of ({}, {}) m in B, allowed: a place on the body",
        held.radius, held.place.x(), held.place.y());
  }
  tissue.stop_clock(0, true);
  const double way = (held.position - from).norm();
  const auto steps = static_cast<int>(std::ceil(way / (kSpeed * model.control_period) + 1e-9));
  for (int k = 0; k < steps; ++k) {
    const ToolMotion motion{from + static_cast<double>(k) / steps * (held.position - from),
                            from + static_cast<double>(k + 1) / steps * (held.position - from)};
    tissue.step({&motion, 1});
  }
  tissue.stop_clock(0, false);
}

std::size_t count_steps(const ToolTrack& track, double period) {
  return static_cast<std::size_t>(std::ceil((track.end() - track.begin()) / period - 1e-9));
}

std::vector<std::size_t> closings(const ToolTrack& track, const GraspSettings& grasp,
                                  std::span<const double> times) {
  std::vector<std::size_t> found;
  bool was_closed = false;
  for (std::size_t k = 0; k < times.size(); ++k) {
    const bool closed = is_closed(track, grasp, times[k]);
    if (closed && !was_closed) found.push_back(k);
    was_closed = closed;
  }
  return found;
}

std::vector<PinchCircle> pinches_of(const ToolTrack& track, const Scene& scene,
                                    const GraspSettings& grasp, double above) {
  constexpr double kBeside = 0.02;  // [m]
  Eigen::AlignedBox3d sheet;
  for (const Vector3d& p : scene.tissue.particles) sheet.extend(p);
  sheet.min().z() -= above;
  sheet.max().z() += above;
  const Eigen::Isometry3d X_BW = scene.tissue.X_WB.inverse();
  // The rim of a pad must stay on lines; a disc is held in the mean over whatever is under it.
  const pb::GraspOffset& offset = scene.config.tissue().effects().grasp_offset();
  const bool pad = scene.config.tool().grip().hold() == pb::HOLD_PAD;
  const Eigen::Vector2d displaced =
      pad ? Eigen::Vector2d(offset.x_m(), offset.y_m()) : Eigen::Vector2d(0, 0);
  std::vector<PinchCircle> pinches;
  for (const std::size_t k : closings(track, grasp, track.time)) {
    const Vector3d p_BT = X_BW * track.tip_at(track.time[k]);
    if (sheet.exteriorDistance(p_BT) < kBeside)
      pinches.push_back({p_BT.head<2>() + displaced, grasp.patch_radius_m, displaced});
  }
  return pinches;
}

SimulatedRecording simulate_recording(const TissueModel& model, const Arm& arm,
                                      const ToolTrack& track, const GraspSettings& grasp,
                                      const RecordingStart& start, ColumnCarrier* columns,
                                      const std::function<bool()>& stop) {
  const std::unique_ptr<Tissue<double>> tissue = model.make_tissue(f64x1());
  tissue->reset(0, Vector3d::Zero());
  const double period = model.control_period;
  check_memory(track, period, *tissue);
  const std::size_t steps = count_steps(track, period);
  SimulatedRecording result;
  std::vector<ArmState> arms(arm.active() ? 1 : 0);  // none: the tip is where it was told to be
  std::vector<ArmReport> reports(arms.size());
  Vector3d tip = track.tip_at(track.begin());
  if (arm.active()) {
    arm.reset(arms[0], tip);
    reports[0] = arm.step(arms[0], tip, Vector3d::Zero());
    tip = Eigen::Map<const Vector3d>(arms[0].p_WT_true);
  }
  auto* reference = columns != nullptr ? dynamic_cast<ReferenceTissue*>(tissue.get()) : nullptr;
  OMENTUM_CHECK(columns == nullptr || reference != nullptr, "columns of a tissue without");
  if (reference != nullptr) columns->begin(*reference, track.tip_at(track.begin()));
  bool held = start.held.has_value();
  if (held) {
    hold_at_start(*tissue, *start.held);
    if (reference != nullptr) columns->hold_at_start(*reference);
  }
  if (start.from_rest)
    result.start_speed = settle(*tissue, held ? start.held->position : tip, stop);
  // With a velocity of zero, too: there its columns begin.
  if (!start.velocity.isZero(0) || (reference != nullptr && !held))
    start_moving(*tissue, start.velocity);
  if (!tissue->healthy(0)) {
    throw_error("{}: the tissue fails before the first command: {}", track.path,
                tissue->failure(0));
  }
  bool was_closed = false;
  for (std::size_t step = 0; step <= steps; ++step) {
    const double t = track.begin() + static_cast<double>(step) * period;
    if (reference != nullptr) {
      columns->add_state(step, t, *reference);
      columns->begin_step(*reference, track.tip_at(t + period));
      if (held) columns->hold_at_start(*reference);
    }
    if (held && t >= start.held->until - 1e-9) {
      held = false;
      tissue->release(0);
    }
    const bool closed = !held && is_closed(track, grasp, t);
    if (closed && !was_closed) {
      tissue->hold(0, tip, grasp.patch_radius_m, false);
      if (tissue->held(0).empty()) ++result.missed_grasps;
    }
    if (!closed && was_closed) tissue->release(0);
    was_closed = closed;

    result.time.push_back(t);
    result.tip.push_back(tip);
    result.measured_tip.push_back(
        arm.active() ? Vector3d(Eigen::Map<const Vector3d>(arms[0].p_WT_measured)) : tip);
    result.arm.insert(result.arm.end(), reports.begin(), reports.end());
    result.force.push_back(tissue->held_force(0));
    add_surface(*tissue, result);
    if (step == steps) break;
    if (stop && stop()) {
      result.failure = fmt::format("{}: stopped at {:.6g} s", track.path, t);
      break;
    }
    std::vector<ToolMotion> motion = {{tip, track.tip_at(t + period)}};
    if (held) {  // by what is no tool of the commands
      const ToolMotion still{start.held->position, start.held->position};
      tissue->step({&still, 1});
      if (arm.active()) {
        reports[0] = arm.step(arms[0], motion[0].to, Vector3d::Zero());
        motion[0].to = Eigen::Map<const Vector3d>(arms[0].p_WT_true);
      }
    } else {
      control_step<double>({&arm, 1}, arms, *tissue, motion, reports);
    }
    tip = motion[0].to;
    if (!tissue->healthy(0)) {
      result.failure = fmt::format("{}: the tissue fails under the commands at {:.6g} s: {}",
                                   track.path, t + period, tissue->failure(0));
      break;
    }
  }
  return result;
}

}  // namespace omentum

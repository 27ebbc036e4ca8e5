#include "mismatch/fit/forward.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "core/check.h"
#include "sim_worker/reference/reference_model.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kScenePeriod = 0.02;  // [s] what the substeps of a scene are counted for

/// Control steps around a time.
struct Between {
  std::size_t step = 0;
  double share = 0;  ///< of the step behind
};
Between between(const ToolTrack& track, double period, double t) {
  const std::size_t steps = count_steps(track, period);
  const double place = (t - track.begin()) / period;
  if (!(place > 0)) return {0, 0};
  const auto step = static_cast<std::size_t>(place);
  if (step >= steps) return {steps - 1, 1};
  return {step, place - static_cast<double>(step)};
}

/// Both faces of a surface that is known by its middle, as a shell is.
std::vector<Vector3d> faces_of(const std::vector<Vector3d>& middle,
                               const std::vector<Eigen::Vector3i>& triangles, double thickness) {
  std::vector<Vector3d> normal(middle.size(), Vector3d::Zero());
  for (const Eigen::Vector3i& t : triangles) {
    const Vector3d n =
        (middle[static_cast<std::size_t>(t[1])] - middle[static_cast<std::size_t>(t[0])])
            .cross(middle[static_cast<std::size_t>(t[2])] - middle[static_cast<std::size_t>(t[0])]);
    for (const int v : t) normal[static_cast<std::size_t>(v)] += n;
  }
  std::vector<Vector3d> faces;
  for (const double side : {0.5, -0.5}) {
    for (std::size_t i = 0; i < middle.size(); ++i)
      faces.push_back(middle[i] + side * thickness * normal[i].normalized());
  }
  return faces;
}

void fill_columns(const Simulation& simulation, const Between& at,
                  const std::vector<Unknown>& unknowns, const Eigen::VectorXd& x, int first_own,
                  int own_columns, PredictedFrame& frame) {
  const auto first = simulation.columns.find(at.step);
  const auto second = simulation.columns.find(at.step + 1);
  if (first == simulation.columns.end() || second == simulation.columns.end()) {
    frame.valid = false;
    return;
  }
  const auto rows = static_cast<Eigen::Index>(first->second.surface.front().size());
  frame.columns.setZero(rows + 3, static_cast<Eigen::Index>(unknowns.size()) + own_columns);
  std::size_t next = 0;
  const auto take = [&](Eigen::Index column, double factor) {
    const Eigen::Map<const Eigen::VectorXf> a(first->second.surface[next].data(), rows);
    const Eigen::Map<const Eigen::VectorXf> b(second->second.surface[next].data(), rows);
    const auto share = static_cast<float>(at.share);
    const Vector3d force =
        (1 - at.share) * first->second.force[next] + at.share * second->second.force[next];
    frame.columns.col(column) << static_cast<float>(factor) * ((1 - share) * a + share * b),
        (factor * force).cast<float>();
    ++next;
  };
  for (std::size_t k = 0; k < unknowns.size(); ++k) {
    if (unknowns[k].column.empty()) continue;
    const auto column = static_cast<Eigen::Index>(k);
    take(column, unknowns[k].slope(x[column]));
    // Of an effect that is off, which may have no column from some time on, the frame does not
    // hang.
    if (!unknowns[k].simulated() && !frame.columns.col(column).allFinite())
      frame.columns.col(column).setZero();
  }
  for (int k = first_own; k < own_columns; ++k)
    take(static_cast<Eigen::Index>(unknowns.size()) + k, 1);
  frame.valid = frame.columns.allFinite();
}

using Surface = std::shared_ptr<const std::vector<Vector3d>>;

/// Surfaces of the control steps around `place`, which are made once for all frames.
std::vector<TrajectoryPoint> trajectory_of(const Between& place, double period, std::size_t steps,
                                           const std::function<Surface(std::size_t)>& surface_at) {
  const auto beside = static_cast<std::size_t>(std::ceil(kTrajectoryReach / period));
  const std::size_t first = place.step > beside ? place.step - beside : 0;
  const std::size_t last = std::min(place.step + 1 + beside, steps - 1);
  std::vector<TrajectoryPoint> trajectory;
  for (std::size_t k = first; k <= last; ++k) {
    const double steps_later =
        static_cast<double>(k) - static_cast<double>(place.step) - place.share;
    trajectory.push_back({period * steps_later, surface_at(k)});
  }
  return trajectory;
}

}  // namespace

std::ptrdiff_t count_valid(const Prediction& prediction) {
  return std::ranges::count_if(prediction.frames, &PredictedFrame::valid);
}

double surfaces_apart(const std::vector<Prediction>& a, const std::vector<Prediction>& b) {
  double squares = 0, count = 0;
  for (std::size_t r = 0; r < a.size() && r < b.size(); ++r) {
    for (std::size_t f = 0; f < a[r].frames.size() && f < b[r].frames.size(); ++f) {
      if (!a[r].frames[f].valid || !b[r].frames[f].valid) continue;
      for (std::size_t v = 0; v < a[r].frames[f].vertices.size(); ++v) {
        squares += (a[r].frames[f].vertices[v] - b[r].frames[f].vertices[v]).squaredNorm();
        ++count;
      }
    }
  }
  return count > 0 ? std::sqrt(squares / count) : 0;
}

void move_in_time(const PredictedFrame& frame, double later, std::vector<Vector3d>& vertices,
                  std::vector<Vector3d>& velocity) {
  vertices = frame.vertices;
  velocity = frame.velocity;
  if (frame.trajectory.empty()) {
    for (std::size_t i = 0; i < vertices.size(); ++i) vertices[i] += later * velocity[i];
    return;
  }
  // Zero leaves a frame where it is, bit for bit.
  if (later == 0) return;
  const std::vector<TrajectoryPoint>& points = frame.trajectory;
  const auto correct = [&] {
    for (std::size_t i = 0; i < frame.correction.size(); ++i) vertices[i] += frame.correction[i];
  };
  if (later <= points.front().later || later >= points.back().later) {
    vertices = later <= points.front().later ? *points.front().vertices : *points.back().vertices;
    velocity.assign(vertices.size(), Vector3d::Zero());
    correct();
    return;
  }
  std::size_t k = 1;
  while (points[k].later <= later) ++k;
  const double length = points[k].later - points[k - 1].later;
  const double share = (later - points[k - 1].later) / length;
  const std::vector<Vector3d>& a = *points[k - 1].vertices;
  const std::vector<Vector3d>& b = *points[k].vertices;
  for (std::size_t i = 0; i < vertices.size(); ++i) {
    vertices[i] = a[i] + share * (b[i] - a[i]);
    velocity[i] = (b[i] - a[i]) / length;
  }
  correct();
}

std::array<int, 3> count_elements(const pb::Scene& scene, const std::string& folder,
                                  std::span<const Observation> observations, double tolerance_m) {
  constexpr std::array<int, 3> kMost = {200, 200, 20};  // that a scene can state
  std::array<int, 3> most = {1, 1, 1};
  for (const Observation& observation : observations) {
    SimulationTask task = make_calibration_task(observation, scene, folder, {});
    pb::Tissue& tissue = *task.scene.mutable_tissue();
    // The mesh for neo-Hooke is made for the singular clamp: with a stated number it is not.
    tissue.mutable_material()->set_law(pb::LAW_COROTATED);
    pb::ReferenceModel& mesh = *tissue.mutable_reference();
    mesh.set_tolerance_m(tolerance_m);
    mesh.clear_elements_x();
    mesh.clear_elements_y();
    mesh.clear_elements_z();
    const Scene made = make_scene(task.scene, folder);
    std::vector<std::string> ignored;
    const auto model = make_reference_model(made, task.period, ignored,
                                            pinches_of(task.commands, made, task.grasp));
    const std::array<int, 3> cells = {model->cells(0), model->free_cells_y(), model->cells(2)};
    for (std::size_t k = 0; k < 3; ++k) most[k] = std::min(kMost[k], std::max(most[k], cells[k]));
  }
  return most;
}

std::array<int, 3> fewer_elements(const std::array<int, 3>& elements, double ratio) {
  const auto fewer = [&](int count) {
    return std::max(1, static_cast<int>(std::lround(count / ratio)));
  };
  return {fewer(elements[0]), fewer(elements[1]), fewer(elements[2])};
}

SimulationTask make_calibration_task(const Observation& observation, const pb::Scene& scene,
                                     const std::string& folder, const Numerics& numerics) {
  SimulationTask task;
  task.scene = scene;
  task.folder = folder;
  task.commands = observation.track;
  task.period = numerics.period * observation.period;
  task.grasp = observation.grasp;
  if (observation.held) task.scene.mutable_held_start()->set_until_s(observation.released);
  pb::Tissue& tissue = *task.scene.mutable_tissue();
  tissue.set_model(numerics.model);
  // Where the shaft is no recording says; it must not push what the jaws hold.
  task.scene.mutable_tool()->set_contact(false);
  if (numerics.elements[0] > 0) {
    pb::ReferenceModel& mesh = *tissue.mutable_reference();
    mesh.set_elements_x(static_cast<std::uint32_t>(numerics.elements[0]));
    mesh.set_elements_y(static_cast<std::uint32_t>(numerics.elements[1]));
    mesh.set_elements_z(static_cast<std::uint32_t>(numerics.elements[2]));
  }
  pb::ReferenceModel& solver = *tissue.mutable_reference();
  solver.set_friction_slip_speed_m_per_s(
      std::max(solver.friction_slip_speed_m_per_s(), numerics.slip_speed_m_per_s));
  solver.set_newton_tolerance(std::max(solver.newton_tolerance(), numerics.newton_tolerance));
  const double share = numerics.substeps * observation.period / kScenePeriod;
  const auto scaled = [&](std::uint32_t substeps) {
    return static_cast<std::uint32_t>(std::max(1.0, std::round(share * substeps)));
  };
  tissue.mutable_cluster()->set_substeps(scaled(tissue.cluster().substeps()));
  tissue.mutable_elastic()->set_substeps(scaled(tissue.elastic().substeps()));
  tissue.mutable_reference()->set_substeps(scaled(tissue.reference().substeps()));
  return task;
}

namespace {

/// From the tip to the simulated tissue where the jaws close, the farthest of all times [m].
double missed_by(const SimulationTask& task, const SimulatedRecording& recording) {
  double farthest = 0;
  for (const std::size_t k : closings(task.commands, task.grasp, recording.time)) {
    double nearest = std::numeric_limits<double>::infinity();
    for (const Vector3d& p : recording.points[k])
      nearest = std::min(nearest, (p - recording.tip[k]).norm());
    farthest = std::max(farthest, nearest);
  }
  return farthest;
}

/// With numbers far from the truth the tissue may hang beside where the jaws closed. They held it,
/// so they reach as far as it is then, and hold a patch of the same size.
Simulation simulate_held(SimulationTask task, Simulator& simulator) {
  constexpr double kReach = 0.03;  // [m]
  Simulation simulation = simulator.simulate(task);
  if (simulation.recording.missed_grasps == 0) return simulation;
  const double away = missed_by(task, simulation.recording);
  if (away > kReach) return simulation;
  const double to_middle = away + 0.5 * simulation.scene.tissue.thickness;
  task.grasp.patch_radius_m = std::hypot(task.grasp.patch_radius_m, to_middle);
  return simulator.simulate(task);
}

Prediction predict_or_throw(const Observation& observation, const pb::Scene& scene,
                            const std::string& folder, const std::vector<Unknown>& unknowns,
                            const Eigen::VectorXd& x, double clock, const Numerics& numerics,
                            bool with_columns, Simulator& simulator) {
  SimulationTask task = make_calibration_task(observation, scene, folder, numerics);
  const bool held = task.scene.has_held_start();
  std::vector<Between> places;
  for (const SeenFrame& frame : observation.frames)
    places.push_back(between(task.commands, task.period, frame.t - clock));
  if (with_columns) {
    std::string list;
    for (const Unknown& unknown : unknowns) {
      if (!unknown.column.empty()) list += unknown.column + ",";
    }
    if (!holds_pad(scene)) list += "grasp_offset.x,grasp_offset.y,";
    if (held) list += "held_start.x,held_start.y,held_start.z,";
    task.parameters = list.substr(0, list.size() - 1);
    for (const Between& place : places) {
      task.column_steps.push_back(place.step);
      task.column_steps.push_back(place.step + 1);
    }
    std::sort(task.column_steps.begin(), task.column_steps.end());
    task.column_steps.erase(std::unique(task.column_steps.begin(), task.column_steps.end()),
                            task.column_steps.end());
  }
  const Simulation simulation = simulate_held(task, simulator);
  const SimulatedRecording& recording = simulation.recording;
  Prediction made;
  made.failure = recording.failure;
  for (const Vector3d& tip : recording.tip)
    made.lift = std::max(made.lift, tip.z() - recording.tip.front().z());
  const TissueBody& body = simulation.scene.tissue;
  std::vector<Surface> surfaces(recording.points.size());
  const auto surface_at = [&](std::size_t step) {
    Surface& surface = surfaces[step];
    const std::vector<Vector3d>& points = recording.points[step];
    if (!surface) {
      surface = std::make_shared<const std::vector<Vector3d>>(
          simulation.reference ? points : faces_of(points, body.surface_triangles, body.thickness));
    }
    return surface;
  };
  for (const Between& place : places) {
    PredictedFrame& frame = made.frames.emplace_back();
    if (place.step + 1 >= recording.points.size()) continue;
    frame.valid = true;
    const std::vector<Vector3d>& a = *surface_at(place.step);
    const std::vector<Vector3d>& b = *surface_at(place.step + 1);
    for (std::size_t i = 0; i < a.size(); ++i) {
      frame.vertices.push_back(a[i] + place.share * (b[i] - a[i]));
      frame.velocity.push_back((b[i] - a[i]) / task.period);
    }
    frame.trajectory = trajectory_of(place, task.period, recording.points.size(), surface_at);
    frame.tip = recording.tip[place.step] +
                place.share * (recording.tip[place.step + 1] - recording.tip[place.step]);
    frame.force = recording.force[place.step] +
                  place.share * (recording.force[place.step + 1] - recording.force[place.step]);
    if (!with_columns) continue;
    fill_columns(simulation, place, unknowns, x, holds_pad(scene) ? kOwnColumns : 0,
                 kOwnColumns + (held ? kHeldColumns : 0), frame);
    // Of what jaws never take the place in them is none.
    if (held && !observation.pinched && frame.columns.size() > 0)
      frame.columns.middleCols<kOwnColumns>(static_cast<Eigen::Index>(unknowns.size())).setZero();
  }
  return made;
}

}  // namespace

bool holds_pad(const pb::Scene& scene) { return scene.tool().grip().hold() == pb::HOLD_PAD; }

Prediction failed_prediction(const Observation& observation, const std::string& why) {
  Prediction failed;
  failed.frames.assign(observation.frames.size(), {});
  failed.failure = why;
  failed.refused = true;
  return failed;
}

Prediction predict(const Observation& observation, const pb::Scene& scene,
                   const std::string& folder, const std::vector<Unknown>& unknowns,
                   const Eigen::VectorXd& x, double clock, const Numerics& numerics,
                   bool with_columns, Simulator& simulator) {
  try {
    return predict_or_throw(observation, scene, folder, unknowns, x, clock, numerics, with_columns,
                            simulator);
  } catch (const Error& error) {
    return failed_prediction(observation, error.what());
  }
}

}  // namespace omentum

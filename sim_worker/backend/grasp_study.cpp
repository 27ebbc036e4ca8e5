#include "sim_worker/backend/grasp_study.h"

#include <fmt/core.h>
#include <google/protobuf/descriptor.h>

#include <algorithm>

#include "core/config.h"
#include "core/csv.h"
#include "core/hash.h"
#include "core/rollout.h"
#include "sim_worker/models.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kCloseDistance =
    0.0014;  // [m] inside every min_pinch of the sweep but the largest
constexpr std::uint32_t kDescentSteps = 230;  // from the start height to the board
constexpr std::uint32_t kCloseSteps = 12;     // the slowest jaw of the sweep closes within them
constexpr std::uint32_t kLiftSteps = 230;

struct Sweep {
  const char* parameter;
  const char* unit;
  std::vector<double> values;
};

const std::vector<Sweep>& sweeps() {
  static const std::vector<Sweep> all = {
      {"jaw_open_deg", "deg", {10, 14, 17, 20, 30, 45}},
      {"max_approach_deg", "deg", {10, 20, 30, 40, 60, 90}},
      {"min_pinch_m", "m", {0.0001, 0.0003, 0.0005, 0.0007, 0.001, 0.0015}},
      {"slip_force_n", "N", {0.05, 0.1, 0.2, 0.4, 0.8, 1.6}},
      {"slip_rate_m_per_s_n", "m/s/N", {0.0005, 0.001, 0.003, 0.01, 0.03, 0.1}},
      {"loss_slip_m", "m", {0.0005, 0.001, 0.0025, 0.005, 0.0075, 0.01}},
  };
  return all;
}

/// The slip law only shows where slip happens: its rate and its limit are varied with this load
/// threshold [N].
constexpr double kSlipForceOfSlipSweeps = 0.2;

enum class Phase { kDescend, kClose, kLift };

/// What the scripted operator of one environment is doing.
struct LaneScript {
  Phase phase = Phase::kDescend;
  std::uint32_t steps = 0;
  PinchResult result = PinchResult::kTooFar;
};

/// Decides the actions of one step from the states before it.
void act(SimBackend& backend, std::span<LaneScript> scripts, std::span<Action> actions) {
  const Tissue<float>& tissue = backend.tissue_of(0);
  std::vector<Nearest> nearest(tissue.lanes());
  std::vector<Vector3d> points(nearest.size(), Vector3d::Zero());
  for (std::size_t k = 0; k < scripts.size(); ++k) {
    const EpisodeFacts facts = backend.clock(static_cast<int>(k));
    points[k] = Vector3d(facts.tool_position[0], facts.tool_position[1], facts.tool_position[2]);
  }
  tissue.find_nearest(points, nearest);
  for (std::size_t k = 0; k < scripts.size(); ++k) {
    LaneScript& s = scripts[k];
    const int lane = static_cast<int>(k);
    if (s.phase == Phase::kDescend &&
        (nearest[k].distance < kCloseDistance || ++s.steps > kDescentSteps)) {
      s = {Phase::kClose, 0, s.result};
      // Judged as the back end will judge it, so that each start has its cause.
      if (nearest[k].distance < kCloseDistance) s.result = backend.judge(lane, nearest[k]);
    }
    if (s.phase == Phase::kClose && ++s.steps > kCloseSteps) s.phase = Phase::kLift;
    actions[k] = backend.hold_action(lane);
    if (s.phase == Phase::kDescend) actions[k].branch = {1, 1, 0, 0};
    if (s.phase == Phase::kClose) actions[k].branch = {1, 1, 1, 1};
  }
}

/// Runs the starts first ... first + count - 1, one per lane.
void run_batch(SimBackend& backend, std::uint32_t first, std::uint32_t count, GraspStudyRow& row) {
  std::vector<LaneScript> scripts(count);
  std::vector<RolloutTask> tasks(count);
  for (std::uint32_t k = 0; k < count; ++k) {
    tasks[k].start_set = StartSet::kRobotGrid;
    tasks[k].start_index = first + k;
    tasks[k].episode_limit = 1U << 30;
    tasks[k].steps = kDescentSteps + kCloseSteps + kLiftSteps;
    tasks[k].reset = true;
  }
  const Actor actor(
      [&](std::uint32_t, std::span<Action> actions) { act(backend, scripts, actions); }, false);
  const std::vector<RolloutSegment> segments = run_rollout(backend, actor, tasks, {});
  for (std::size_t k = 0; k < count; ++k) {
    const RolloutSegment& segment = segments[k];
    const bool held = segment.failed == 0 && segment.episode_held.front() != 0;
    const bool taken = held || std::any_of(segment.flags.begin(), segment.flags.end(),
                                           [](auto f) { return (f & step_flag::kHeld) != 0; });
    ++row.starts;
    row.held += held ? 1 : 0;
    row.lost += !held && taken ? 1 : 0;
    row.not_taken += taken ? 0 : 1;
    ++row.causes[static_cast<std::size_t>(scripts[k].result)];
  }
}

}  // namespace

std::vector<GraspStudyRow> study_grasps(const SimSetup& setup) {
  std::vector<GraspStudyRow> rows;
  const auto starts = static_cast<std::uint32_t>(setup.scene.robot_starts.size());
  if (starts == 0 || setup.config.task().action() != pb::ACTION_XYZ_GRIPPER) return rows;
  for (const Sweep& sweep : sweeps()) {
    const auto* field = pb::Grasp::descriptor()->FindFieldByName(sweep.parameter);
    const pb::Grasp& shipped = setup.config.grasp();
    std::vector<double> values = sweep.values;
    const double own = shipped.GetReflection()->GetDouble(shipped, field);
    if (own > 0 && std::find(values.begin(), values.end(), own) == values.end())
      values.push_back(own);
    std::sort(values.begin(), values.end());
    for (const double value : values) {
      auto varied = std::make_shared<SimSetup>(setup);
      pb::Grasp& grasp = *varied->config.mutable_grasp();
      const std::string name = sweep.parameter;
      if (name == "slip_rate_m_per_s_n" || name == "loss_slip_m")
        grasp.set_slip_force_n(kSlipForceOfSlipSweeps);
      grasp.GetReflection()->SetDouble(&grasp, field, value);
      GraspStudyRow row;
      row.parameter = name;
      row.unit = sweep.unit;
      row.value = value;
      row.shipped = value == own;
      const LaneKernel<float>& kernel = choose_kernel(0);
      SimBackend backend(varied, kernel.lanes);
      const auto lanes = static_cast<std::uint32_t>(kernel.lanes);
      for (std::uint32_t first = 0; first < starts; first += lanes) {
        run_batch(backend, first, std::min(lanes, starts - first), row);
      }
      rows.push_back(row);
    }
  }
  return rows;
}

std::uint64_t grasp_study_id(const pb::Config& config, std::uint64_t build_id) {
  pb::Config read;  // the rest, seed, learning and evaluation, has no part in it
  *read.mutable_scene() = config.scene();
  *read.mutable_task() = config.task();
  *read.mutable_grasp() = config.grasp();
  *read.mutable_defects() = config.defects();
  *read.mutable_randomise() = config.randomise();
  return fnv1a64(fmt::format("{:016x}\n{}", build_id, print_config(read)));
}

std::string grasp_study_csv(const std::vector<GraspStudyRow>& rows, std::uint64_t id) {
  std::string text =
      "parameter,unit,value,shipped,starts,held,lost,not_taken,too_far,jaw_not_open,bad_approach,"
      "too_thin,study_id\n";
  for (const GraspStudyRow& r : rows) {
    text += fmt::format("{},{},{},{},{},{},{},{},{},{},{},{},{:016x}\n", r.parameter, r.unit,
                        r.value, r.shipped ? 1 : 0, r.starts, r.held, r.lost, r.not_taken,
                        r.causes[1], r.causes[2], r.causes[3], r.causes[4], id);
  }
  return text;
}

bool is_grasp_study(const std::string& path, std::uint64_t id) {
  const Result<CsvTable> table = load_csv(path);
  const std::string wanted = fmt::format("{:016x}", id);
  const auto column = table ? table.value().column("study_id") : std::nullopt;
  return column && table.value().cut_off.empty() && !table.value().rows.empty() &&
         table.value().rows.back()[*column].text == wanted;
}

}  // namespace omentum

#include "dvrk_gateway/experiment.h"

#include <fmt/core.h>

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <thread>

#include "core/clock.h"
#include "core/durable_file.h"
#include "core/evaluation_table.h"
#include "core/utc_time.h"
#include "dvrk_gateway/gateway.h"
#include "dvrk_gateway/loop/jaw_watch.h"
#include "report/experiment_page.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

// A jaw that holds nothing ends within a few hundredths of a radian of its goal; 1 mm of tissue
// between jaws of 10 mm keeps them 0.1 rad apart.
constexpr double kGap_rad = 0.1;
constexpr double kShutBelow_rad = 0.05;
/// The watch has seen the last period of the episode after it.
constexpr auto kWatchDelay = std::chrono::milliseconds(400);

void write_or_throw(const fs::path& path, const std::string& text) {
  if (const Result<void> written = write_durably(path.string(), text); !written)
    throw_error("{}", written.error());
}

std::vector<EvaluationRow> rows_so_far(const fs::path& path) {
  if (!fs::exists(path)) return {};
  const Result<CsvTable> table = load_csv(path.string());
  if (!table) throw_error("{}", table.error());
  Result<std::vector<EvaluationRow>> rows = read_evaluation(table.value());
  if (!rows) throw_error("{}", rows.error());
  return std::move(rows).value();
}

/// One experiment in its folder.
class Run {
 public:
  Run(const GatewayOptions& options, Gateway& gateway, JawWatch& jaw)
      : options_(options), folder_(options.folder), jaw_(jaw), gateway_(gateway) {
    starts_ = std::min(options.starts, robot_starts(gateway_.config().scene()));
    if (starts_ == 0) throw_error("--starts: the scene of the policy has no robot_grid");
    fs::create_directories(folder_);
    robot_ = rows_so_far(folder_ / "robot.csv");
    predict();
    save();
  }

  bool finished() const { return robot_.size() >= starts_; }

  /// The next start that has no row; false when the program ends.
  bool next() {
    std::uint32_t start = 0;
    while (std::any_of(robot_.begin(), robot_.end(),
                       [&](const EvaluationRow& row) { return row.index == start; }))
      ++start;
    fmt::print("start {} of {}\n", start + 1, starts_);
    std::fflush(stdout);
    jaw_.forget();
    const RolloutTask task = gateway_.next_task(StartSet::kRobotGrid, start, 0);
    const std::optional<RolloutSegment> segment = gateway_.run_episode(task);
    if (!segment || gateway_.session().ended()) return false;
    if (segment->failed != 0) {  // once more, when the operator has armed
      ++stops_;
      fmt::print("stopped: {}\n", segment->failure);
      return true;
    }
    std::this_thread::sleep_for(kWatchDelay);
    EvaluationRow row = row_of(task, *segment);
    if (!judge(row)) return !gateway_.session().ended();
    robot_.push_back(row);
    save();
    fmt::print("start {}: {}\n", start + 1,
               row.held   ? "held to the end"
               : row.lost ? "held, then lost"
                          : "not held");
    return true;
  }

  void save() const {
    write_or_throw(folder_ / "robot.csv", grid_table(robot_));
    Experiment experiment;
    experiment.title = fmt::format("{} starts on the robot", starts_);
    experiment.subtitle =
        fmt::format("Mode {}, policy version {} of {}, instrument {}. {}.",
                    mode_name(options_.mode), gateway_.weights().policy_version, options_.policy,
                    options_.instrument, utc_text(wall_now_ns()));
    experiment.grid = gateway_.config().scene().robot_grid();
    experiment.robot = robot_;
    experiment.prediction = prediction_;
    experiment.facts = {{"what", "value"},
                        {"outcome", options_.ask_outcome ? "asked for" : "read from the jaw"},
                        {"stops so far", std::to_string(stops_)},
                        {"registration", options_.registration}};
    write_or_throw(folder_ / "report.html", make_experiment_page(experiment));
  }

 private:
  EvaluationRow row_of(const RolloutTask& task, const RolloutSegment& segment) const {
    EvaluationRow row = row_of_episode(segment);
    const std::uint32_t columns = std::max(1U, gateway_.config().scene().robot_grid().columns());
    row.index = task.start_index;
    row.row = task.start_index / columns + 1;
    row.column = task.start_index % columns + 1;
    row.greedy = task.greedy;
    return row;
  }

  /// What simulation alone makes of the starts.
  void predict() {
    for (std::uint32_t start = 0; start < starts_; ++start) {
      const RolloutTask task = gateway_.next_task(StartSet::kRobotGrid, start, 0);
      prediction_.push_back(row_of(task, gateway_.predict(task)));
    }
    write_or_throw(folder_ / "prediction.csv", grid_table(prediction_));
  }

  /// What became of the tissue; false when the operator wants the start again.
  bool judge(EvaluationRow& row) {
    bool held = jaw_.holds(), ever = jaw_.held_ever();
    if (options_.ask_outcome) {
      fmt::print("s held to the end, l lost on the way, f not held, r once more\n");
      std::fflush(stdout);
      const std::optional<char> key = gateway_.ask_key("slfr");
      if (!key || *key == 'r') return false;
      held = *key == 's';
      ever = *key != 'f';
    }
    row.held = held;
    row.lost = ever && !held;
    row.grasp_held = held;
    row.reached = row.reached && held;
    if (!held) row.exposure = 0;
    return true;
  }

  GatewayOptions options_;
  fs::path folder_;
  JawWatch& jaw_;
  Gateway& gateway_;
  std::uint32_t starts_ = 0;
  std::vector<EvaluationRow> robot_, prediction_;
  std::uint64_t stops_ = 0;
};

}  // namespace

int run_experiment(const GatewayOptions& options) {
  JawWatch jaw(kShutBelow_rad, kGap_rad);
  const std::unique_ptr<Gateway> gateway = Gateway::start(options, {&jaw});
  if (!gateway) return 1;
  Run run(options, *gateway, jaw);
  while (!run.finished() && run.next()) {
  }
  fmt::print("{}\n", (fs::path(options.folder) / "report.html").string());
  return gateway->end() && run.finished() ? 0 : 1;
}

}  // namespace omentum

// The robot's starts in simulated time: a trained policy, the gateway in mode twin or measured, and
// a double with or without tissue under its jaw. Prints a row per start and writes the page that
// `dvrk_gateway experiment` writes. See --help.
#include <fmt/core.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <fstream>

#include "core/checkpoint_file.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/evaluation_table.h"
#include "core/limits.h"
#include "dvrk_gateway/backend/dvrk_backend.h"
#include "dvrk_gateway/dvrk_double/attached_tissue.h"
#include "dvrk_gateway/loop/jaw_watch.h"
#include "report/experiment_page.h"
#include "tests/dvrk_gateway/two_sides.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using test::TwoSides;

struct StudyOptions {
  std::string policy, mode = "twin", preset = "omentum", out;
  std::vector<std::string> robot_knobs;             ///< scene.arm....=value, of the double alone
  std::vector<double> registration_error{0, 0, 0};  ///< of the gateway's belief, in W [m]
  bool tissue = false;
};

/// Simulated time, seen by the jaw watch and with an operator who arms whenever he may.
class StudyPort final : public ControlPort {
 public:
  StudyPort(ControlLoop& loop, TwoSides& sides, JawWatch& watch)
      : sides_(sides), watch_(watch), port_(loop, sides, events_) {}

  const Period& exchange(const PolicyRequest& request) override {
    const SafetyPhase phase = port_.period().judgement.memory.phase;
    if (phase == SafetyPhase::kReady) events_.arm_ns = sides_.now_ns();
    if (phase == SafetyPhase::kStopped) events_.acknowledge_ns = sides_.now_ns();
    const Period& period = port_.exchange(request);
    watch_.on_period(period);
    if (sides_.now_ns() - begun_ns_ > 120 * TwoSides::kS)
      throw_error("not armed: {}", describe(period.judgement.finding));
    return period;
  }
  const Period& period() const override { return port_.period(); }
  bool ended() const override { return false; }
  void begin_start() { begun_ns_ = sides_.now_ns(); }

 private:
  TwoSides& sides_;
  JawWatch& watch_;
  GatewayEvents events_;
  SteppedPort port_;
  std::int64_t begun_ns_ = 0;
};

/// One robot and gateway for all starts.
class Study {
 public:
  explicit Study(const StudyOptions& options) : options_(options) {
    Result<SavedPolicy> saved = load_policy(options.policy);
    if (!saved) throw_error("{}", saved.error());
    config_ = saved.value().config;
    policy_.emplace(policy_shape(config_), saved.value().weights);
    setup_ = make_sim_setup(config_);
    const pb::Config robot = load_config(options.preset, options.robot_knobs);
    sides_.emplace(DoubleOptions{}, robot.scene().arm(), setup_->mount);
    const Vector3d middle = 0.5 * (setup_->mount.workspace_min + setup_->mount.workspace_max);
    sides_->bring_to(joints_for_tip(setup_->mount, middle).value());
    if (options.tissue) attach_tissue();
    ToolMount believed = setup_->mount;
    believed.X_WR.translation() +=
        Vector3d(options.registration_error[0], options.registration_error[1],
                 options.registration_error[2]);
    safety_ = make_safety_setup({}, believed, Eigen::Isometry3d::Identity(), true);
    loop_.emplace(sides_->gateway_link, *sides_, safety_);
    port_.emplace(*loop_, *sides_, watch_);
    scene_.emplace(setup_, 1);
    guide_.emplace(*port_, safety_, ArmGuideOptions{});
    if (options.mode == "twin") backend_ = std::make_unique<TwinBackend>(*scene_, *guide_);
    if (options.mode == "measured") backend_ = std::make_unique<MeasuredBackend>(*scene_, *guide_);
  }

  RolloutTask task(std::uint32_t start) const {
    RolloutTask t;
    t.kind = TaskKind::kEvaluate;
    t.greedy = config_.randomise().empty();  // as dvrk_gateway does
    t.reset = true;
    t.run_seed = 1;
    t.start_set = StartSet::kRobotGrid;
    t.start_index = start;
    t.policy_steps = std::max(1U, config_.task().episode_steps() / config_.task().action_repeat());
    t.hold_steps = hold_steps(config_.task());
    t.steps = evaluation_steps(config_, false);
    return t;
  }
  EvaluationRow row_of(std::uint32_t start, const RolloutSegment& segment) const {
    EvaluationRow row = row_of_episode(segment);
    row.index = start;
    row.row = start / grid().columns() + 1;
    row.column = start % grid().columns() + 1;
    row.greedy = config_.randomise().empty();
    return row;
  }
  EvaluationRow predict(std::uint32_t start) {
    SimBackend alone(setup_, 1);
    return row_of(start, run_rollout(alone, *policy_, std::array{task(start)}, {})[0]);
  }
  /// Of the scene behind the gateway; with tissue under the jaw, of that.
  EvaluationRow run(std::uint32_t start) {
    watch_.forget();
    port_->begin_start();
    if (tissue_) tissue_->lay();
    const RolloutSegment segment = run_rollout(*backend_, *policy_, std::array{task(start)}, {})[0];
    EvaluationRow row = row_of(start, segment);
    if (segment.failed != 0) fmt::print("start {}: stopped: {}\n", start, segment.failure);
    if (!tissue_) return row;
    for (int i = 0; i < 15; ++i) (void)guide_->hold();
    row.held = row.grasp_held = watch_.holds();
    row.lost = watch_.held_ever() && !watch_.holds();
    row.reached = row.reached && row.held;
    return row;
  }
  const pb::StartGrid& grid() const { return config_.scene().robot_grid(); }

 private:
  void attach_tissue() {
    tissue_ = std::make_unique<AttachedTissue>(setup_);
    sides_->after_period = [this, periods = 0](DvrkDouble& robot) mutable {
      if (++periods % 2 != 0) return;  // the tissue has the control period, two of the robot's
      RobotArm& arm = robot.arm();
      arm.set_load(tissue_->step(arm.true_tip(), arm.jaw()));
      arm.set_jaw_stop(tissue_->jaw_stop_rad());
    };
  }

  StudyOptions options_;
  pb::Config config_;
  std::optional<Policy> policy_;
  std::shared_ptr<const SimSetup> setup_;
  std::optional<TwoSides> sides_;
  std::unique_ptr<AttachedTissue> tissue_;
  SafetySetup safety_;
  JawWatch watch_{0.05, 0.1};
  std::optional<ControlLoop> loop_;
  std::optional<StudyPort> port_;
  std::optional<SimBackend> scene_;
  std::optional<ArmGuide> guide_;
  std::unique_ptr<DvrkBackend> backend_;
};

const char* end_of(const EvaluationRow& row) {
  return row.failed ? "stopped" : row.held ? "held" : row.lost ? "lost" : "not_held";
}

int run(int argc, char** argv) {
  CLI::App app{"The robot's starts in simulated time: the gateway against a double."};
  StudyOptions options;
  app.add_option("--policy", options.policy, "Run folder or checkpoint")->required();
  app.add_option("--mode", options.mode)->check(CLI::IsMember({"twin", "measured"}));
  app.add_option("--preset", options.preset, "That the robot's scene belongs to");
  app.add_option("--set", options.robot_knobs, "Effect of the robot, scene.arm....=value")
      ->allow_extra_args(false);
  app.add_option("--registration-error", options.registration_error, "x y z in W [m]")->expected(3);
  app.add_flag("--tissue", options.tissue, "Tissue under the jaw of the robot; its ends are told");
  app.add_option("--out", options.out, "Folder for robot.csv, prediction.csv and report.html");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  Study study(options);
  Experiment page;
  page.title = "The robot's starts in simulated time";
  page.subtitle = fmt::format("Mode {}, policy {}.", options.mode, options.policy);
  page.grid = study.grid();
  int same = 0;
  const std::uint32_t starts = study.grid().rows() * study.grid().columns();
  for (std::uint32_t start = 0; start < starts; ++start) {
    page.prediction.push_back(study.predict(start));
    page.robot.push_back(study.run(start));
    const EvaluationRow &told = page.prediction.back(), &done = page.robot.back();
    same += std::string_view(end_of(told)) == end_of(done) && told.reached == done.reached ? 1 : 0;
    fmt::print("start {} robot {} reached {} exposure {:.3f}, simulation {} reached {} {:.3f}\n",
               start, end_of(done), done.reached, done.exposure, end_of(told), told.reached,
               told.exposure);
  }
  fmt::print("starts={} as_simulation={}\n", starts, same);
  if (options.out.empty()) return 0;
  std::filesystem::create_directories(options.out);
  page.facts = {
      {"what", "value"},
      {"tissue under the robot's jaw", options.tissue ? "yes" : "no"},
      {"effects of the robot", fmt::format("{}", fmt::join(options.robot_knobs, " "))},
      {"registration error [m]", fmt::format("{}", fmt::join(options.registration_error, " "))}};
  const std::filesystem::path out(options.out);
  std::ofstream(out / "robot.csv") << grid_table(page.robot);
  std::ofstream(out / "prediction.csv") << grid_table(page.prediction);
  std::ofstream(out / "report.html") << make_experiment_page(page);
  return 0;
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  try {
    return omentum::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "modes_study: %s\n", error.what());
  }
  return 2;
}

// The learner: owns the environments' states, trains PPO, evaluates. See --help.
#include <csignal>
#include <cstdio>

#include "core/command_line.h"
#include "core/config.h"
#include "core/crash_report.h"
#include "core/limits.h"
#include "core/log.h"
#include "core/printable.h"
#include "core/product_blocks.h"
#include "core/scheduling.h"
#include "core/topics.h"
#include "learner/check_scene.h"
#include "learner/learner.h"

namespace {

volatile std::sig_atomic_t stop_requested = 0;
void on_signal(int) { stop_requested = 1; }

int run(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  CLI::App app{
      "Omentum learner: hands tasks to simulation workers over DDS, trains a policy with PPO, "
      "evaluates it and writes the run folder runs/<name>/. Start any number of "
      "`sim_worker --run <name>` beside it."};
  std::string preset = "omentum";
  std::string name;
  std::vector<std::string> overrides;
  LearnerOptions options;
  bool dry_run = false;
  bool print_dds = false;
  app.add_option("--preset", preset, "Name of the configuration in deploy/presets")
      ->capture_default_str();
  app.add_option("--run", name,
                 "Name of the run and of its folder below run.runs_dir; a run that has a "
                 "checkpoint is resumed; default: knob run.name, else the preset's name");
  app.add_option(
         "--set", overrides,
         "Override a knob of the list below, a.b=value, as ppo.learning_rate=1e-4; may be repeated")
      ->allow_extra_args(false);
  app.add_flag("--restart", options.restart, "Move an existing run folder aside and start anew");
  app.add_option("--initialise-from", options.initialise_from,
                 "Checkpoint file whose weights a new run starts from; default: fresh weights");
  app.add_option("--initialise-from-recordings", options.initialise_from_recordings,
                 "Folder of recordings (sim_worker --demonstrate makes one) whose actions the "
                 "policy of a new run is fitted to before PPO begins, with the knobs cloning.*");
  app.add_option("--max-wait", options.max_wait_s,
                 "Stop with code 1 after so long without a worker [s]; 0: wait for ever")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
  app.add_option("--unsaved-limit", options.unsaved_limit_s,
                 "Time for which training goes on while no checkpoint can be written [s]; then it "
                 "pauses until one can")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
  app.add_flag("--quiet", options.quiet, "Print no progress lines");
  app.add_flag("--dry-run", dry_run,
               "Print the resolved configuration and its hash, have the sim_worker beside this "
               "program check its scene, and exit: 0, or 2 with the reason");
  app.add_flag("--print-dds-env", print_dds, "Print CYCLONEDDS_URI for other tools and exit");
  add_dds_options(app, options.dds);
  app.add_option(
         "--heartbeat", options.heartbeat,
         "File that the main loop touches every second, for the health check of a container")
      ->envname("OMENTUM_HEARTBEAT");
  app.footer("\n" + knob_help() +
             "\nExit codes: 0 done, 2 wrong input, 130 stopped with a resumable checkpoint, 1 "
             "integrity check failed, physics diverged or a newer learner serves the run.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  pb::Config config = load_config(preset, overrides);
  if (print_dds) {
    const Result<DdsProfile> profile =
        find_dds_profile(options.dds, DdsRole::kOther, config.run().domain(), 0);
    if (!profile) throw_error("--print-dds-env: {}", profile.error());
    std::puts(dds_environment(profile.value()).c_str());
    return 0;
  }
  if (name.empty()) name = config.run().name().empty() ? preset : config.run().name();
  check_run_name(name);
  config.mutable_run()->set_name(name);
  const std::uint32_t width = config.run().lane_width();
  if (width != 0 && width != 1 && width != 8 && width != 16) {
    throw_error("run.lane_width: {}, allowed: 0 (widest), 1, 8, 16", width);
  }
  if (config.run().runs_dir().empty())
    throw_error("run.runs_dir: empty, allowed: a folder, as runs or .");
  options.run_dir = config.run().runs_dir() + "/" + name;
  if (dry_run) {
    std::printf("%s# config_hash %016llx\n", print_config(config).c_str(),
                static_cast<unsigned long long>(config_hash(config)));
    std::fflush(stdout);
  }
  check_limits(config);
  if (dry_run) return check_scene(print_config(config));
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  Learner learner(std::move(config), std::move(options));
  return learner.run([] { return stop_requested != 0; });
}

}  // namespace

int main(int argc, char** argv) {
  omentum::report_crashes("learner");
  omentum::name_log("learner");
  omentum::keep_freed_memory();
  omentum::fix_product_blocks();
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "learner: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

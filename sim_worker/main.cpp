// The simulation worker: stateless executor of rollout tasks. See --help.
#include <algorithm>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>

#include "core/build_id.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/crash_report.h"
#include "core/dds_options.h"
#include "core/durable_file.h"
#include "core/fp_mode.h"
#include "core/limits.h"
#include "core/log.h"
#include "core/printable.h"
#include "core/product_blocks.h"
#include "core/read_file.h"
#include "core/rollout.h"
#include "core/scheduling.h"
#include "core/topics.h"
#include "sim_worker/backend/demonstrate.h"
#include "sim_worker/backend/grasp_study.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/replay.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/bus/bus_worker.h"
#include "sim_worker/models.h"
#include "sim_worker/playback/simulation_bytes.h"

namespace {

volatile std::sig_atomic_t stop_requested = 0;
void on_signal(int) { stop_requested = 1; }

/// The simulation of a configuration, or Error with the reason why a worker cannot run it.
std::unique_ptr<omentum::SimBackend> make_backend(const omentum::pb::Config& config, int lanes,
                                                  unsigned width) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  check_limits(config);
  const auto setup = make_sim_setup(config);
  for (const std::string& warning : setup->warnings) log().warn("{}", warning);
  auto backend = std::make_unique<SimBackend>(setup, lanes, width, make_image_source(*setup));
  std::vector<float> frame;
  backend->positions(0, frame);
  check_scene_limits(config, backend->save(0).size(), frame.size());
  return backend;
}

/// Everything a worker does with a configuration before the first task.
int check(const std::string& path) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  const Result<std::string> text = read_file(path);
  if (!text) throw_error("--check-config {}", text.error());
  if (text.value().empty()) throw_error("--check-config {}: is empty", path);
  const pb::Config config = parse_config(path, text.value());
  const auto backend = make_backend(config, 1, 0);
  const SimSetup& setup = backend->setup();
  std::printf("%s: config_hash=%016llx particles=%zu rigid_bodies=%zu observations=%d\n",
              path.c_str(), static_cast<unsigned long long>(config_hash(config)),
              setup.scene.tissue.particles.size(), setup.scene.bodies.size(),
              backend->observation_size());
  return 0;
}

/// One line per recording. A bad file does not keep the others from being compared.
int replay(const std::vector<std::string>& paths, unsigned width) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  Replayer replayer(width);
  int code = 0;
  const auto try_to = [&code](auto what) {
    try {
      what();
    } catch (const Error& error) {
      std::fprintf(stderr, "sim_worker: --replay %s\n", error.what());
      code = 2;
    }
  };
  const auto replay_one = [&](const std::string& path) {
    const ReplayReport report = replayer.replay(path);
    std::printf("%s: %s\n", path.c_str(), report.text.c_str());
    code = std::max(code, !report.complete ? 2 : report.identical ? 0 : 1);
  };
  for (const std::string& path : paths) {
    try_to([&] {
      for (const std::string& file : recordings_of(path)) try_to([&] { replay_one(file); });
    });
  }
  return code;
}

/// Makes evaluation/grasp_study.csv of a run folder; says so where there is nothing to study.
int grasp_study(const std::string& folder) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  const std::string path = folder + "/config.txtpb";
  const Result<std::string> text = read_file(path);
  if (!text) throw_error("--grasp-study {}: {}", folder, text.error());
  const pb::Config config = parse_config(path, text.value());
  const auto setup = make_sim_setup(config);
  if (!(config.grasp().jaw_open_deg() > 0) || setup->scene.robot_starts.empty() ||
      config.task().action() != pb::ACTION_XYZ_GRIPPER) {
    std::printf("%s: no grasp study: its grasp cannot fail, or it has no robot grid or gripper\n",
                folder.c_str());
    return 0;
  }
  const std::string out = folder + "/evaluation/grasp_study.csv";
  const std::uint64_t id = grasp_study_id(config, build_id());
  if (is_grasp_study(out, id)) {
    std::printf("%s: is of this configuration and build already\n", out.c_str());
    return 0;
  }
  // Before the study, which takes its time.
  if (const Result<void> can = write_durably(out + ".try", ""); !can)
    throw_error("{}", can.error());
  std::filesystem::remove(out + ".try");
  const Result<void> written = write_durably(out, grasp_study_csv(study_grasps(*setup), id));
  if (!written) throw_error("{}", written.error());
  std::printf("%s\n", out.c_str());
  return 0;
}

/// Records episodes of the scripted expert.
int record_demonstrations(const std::string& preset, const std::vector<std::string>& overrides,
                          omentum::DemonstrationOptions options) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  if (options.folder.empty()) throw_error("--demonstrate: -o names the folder of the recordings");
  const pb::Config config = load_config(preset, overrides);
  check_limits(config);
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  options.git_revision = git_revision();
  const DemonstrationCount count = demonstrate(config, options, [] { return stop_requested != 0; });
  if (count.stopped) return 130;
  std::printf("%s: episodes=%u reached=%u steps=%llu\n", options.folder.c_str(), count.episodes,
              count.reached, static_cast<unsigned long long>(count.steps));
  return count.reached > 0 ? 0 : 1;
}

int run(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  // A picture that a policy sees is one tile of the rasteriser (llvmpipe), whose threads would only
  // hand it to and fro. Read once at start, before any thread is made.
  setenv("LP_NUM_THREADS", "0", 0);  // NOLINT(concurrency-mt-unsafe)
  // A name server that does not answer must not keep a worker from leaving.
  setenv("RES_OPTIONS", "timeout:2 attempts:1", 0);  // NOLINT(concurrency-mt-unsafe)
  CLI::App app{
      "Omentum simulation worker: takes tasks from a learner over DDS, simulates one environment "
      "per SIMD lane and sends the steps back. It waits for a learner of the same run name; while "
      "there is none it simulates recordings for mismatch --run, one at a time. It may be started, "
      "stopped and killed at any time."};
  std::string run_name = "omentum";  // as the learner's: the name of its default preset
  unsigned domain = 0;
  unsigned lanes = 0;
  unsigned width = 0;
  bool print_dds = false;
  bool print_knobs = false;
  std::string check_config;
  std::string study;
  std::vector<std::string> replays;
  app.add_option("--run", run_name, "Name of the run to work for")->capture_default_str();
  CLI::Option* domain_option = app.add_option("--domain", domain, "DDS domain, 0 ... 230")
                                   ->check(CLI::Range(0, 230))
                                   ->capture_default_str();
  double max_wait_s = 0;
  app.add_option("--max-wait", max_wait_s,
                 "Stop with code 1 after so long without a learner [s]; 0: wait for ever")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
  app.add_option("--lanes", lanes,
                 "Number of environments that are simulated side by side; 0: as many as the SIMD "
                 "kernel is wide")
      ->check(CLI::Range(0, 1024))
      ->capture_default_str();
  app.add_option("--lane-width", width,
                 "Environments per SIMD instruction: 1, 8 or 16; 0: the most that this CPU has")
      ->capture_default_str();
  app.add_option("--check-config", check_config,
                 "File of a resolved configuration (learner --dry-run prints one): make its scene "
                 "as a worker would, and exit: 0, or 2 with the reason");
  app.add_option(
      "--replay", replays,
      "Recordings (runs/<name>/recordings/*.mcap, a folder of them, or a run folder) to simulate "
      "again and compare at every step; exit: 0 identical, 1 different, 2 a bad file");
  app.add_option("--grasp-study", study,
                 "Run folder: vary each parameter of its grasp alone, write its "
                 "evaluation/grasp_study.csv for the report, and exit: 0, or 2 with the reason");
  DemonstrationOptions demonstration;
  demonstration.episodes = 0;
  std::string preset = "omentum";
  std::vector<std::string> overrides;
  CLI::Option* demonstrate =
      app.add_option(
             "--demonstrate", demonstration.episodes,
             "Record so many episodes of a scripted expert into the folder of -o, for learner "
             "--initialise-from-recordings, and exit: 0, or 1 if none reached the target")
          ->check(CLI::Range(1, 100000));
  app.add_option("--preset", preset,
                 "Name of the configuration in deploy/presets, for --demonstrate")
      ->capture_default_str()
      ->needs(demonstrate);
  app.add_option("--set", overrides,
                 "Override a knob, a.b=value, for --demonstrate; may be repeated")
      ->allow_extra_args(false)
      ->needs(demonstrate);
  app.add_option("--tremor", demonstration.tremor,
                 "Share of the decisions of --demonstrate in which an axis moves at random, so "
                 "that what lies beside the expert's path is shown as well")
      ->check(number_between(0, 1))
      ->capture_default_str()
      ->needs(demonstrate);
  app.add_option("-o,--output", demonstration.folder,
                 "Folder for the recordings of --demonstrate; it must not exist yet")
      ->needs(demonstrate);
  // What joins no domain would ignore it.
  for (const char* alone : {"--demonstrate", "--check-config", "--replay", "--grasp-study"})
    domain_option->excludes(app.get_option(alone));
  app.add_flag("--print-dds-env", print_dds, "Print CYCLONEDDS_URI for other tools and exit");
  DdsOptions dds;
  add_dds_options(app, dds);
  std::string heartbeat;
  app.add_option(
         "--heartbeat", heartbeat,
         "File that the main loop touches every second, for the health check of a container")
      ->envname("OMENTUM_HEARTBEAT");
  app.add_flag("--knobs", print_knobs,
               "Print every knob of a run with unit, range, default and source, and exit");
  app.footer(
      "The learner decides the configuration; see learner --help. Exit codes: 0 stopped or run "
      "finished, 1 a replay differs, no demonstration reached the target or --max-wait has passed, "
      "2 wrong input, 130 --demonstrate was stopped.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  if (demonstration.episodes > 0) return record_demonstrations(preset, overrides, demonstration);
  if (!check_config.empty()) return check(check_config);
  if (!study.empty()) return grasp_study(study);
  if (!replays.empty()) return replay(replays, width == 0 ? 1 : width);
  check_run_name(run_name);
  if (print_knobs) {
    std::fputs(knob_help().c_str(), stdout);
    return 0;
  }
  const LaneKernel<float>& kernel = choose_kernel(width);
  if (lanes == 0) lanes = static_cast<unsigned>(kernel.lanes);
  const auto find_profile = [&] {
    return find_dds_profile(dds, DdsRole::kOther, domain, kReceiveBufferBytes);
  };
  if (print_dds) {
    const Result<DdsProfile> profile = find_profile();
    if (!profile) throw_error("--print-dds-env: {}", profile.error());
    std::puts(dds_environment(profile.value()).c_str());
    return 0;
  }
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  OMENTUM_CHECK(fp_mode_is_default());
  const auto stopped = [] { return stop_requested != 0; };
  const auto max_wait_ns = static_cast<std::int64_t>(1e9 * max_wait_s);
  const std::optional<DdsProfile> profile =
      wait_for_dds_profile(dds, DdsRole::kOther, domain, kReceiveBufferBytes, max_wait_ns, stopped);
  if (!profile) return stopped() ? 0 : 1;

  BusWorkerOptions options;
  options.run = run_name;
  options.domain = domain;
  options.profile = *profile;
  options.find_profile = find_profile;
  options.heartbeat = heartbeat;
  options.build_id = build_id();
  options.program_version = git_revision();
  options.max_wait_ns = max_wait_ns;
  options.rollout = [](Backend& backend, Policy& policy, std::span<const RolloutTask> tasks,
                       const std::function<bool()>& stop) {
    return run_rollout(backend, policy, tasks, stop);
  };
  options.simulate = run_task_bytes;
  options.make_setup = [&](const RunManifest& manifest) {
    pb::Config config = parse_config("manifest of run " + manifest.run_id, manifest.config_text);
    WorkerSetup made;
    made.backend = make_backend(config, static_cast<int>(lanes), width);
    made.shape = policy_shape(config);
    made.config_hash = config_hash(config);
    made.decision_s = config.task().control_period_s() * config.task().action_repeat();
    return made;
  };
  log().info("run={} domain={} lanes={} kernel={} dds={} receive_buffer_bytes={}", run_name, domain,
             lanes, kernel.name, profile->name, profile->receive_buffer_bytes);
  BusWorker worker(std::move(options));
  return worker.run(stopped);
}

}  // namespace

int main(int argc, char** argv) {
  omentum::report_crashes("sim_worker");
  omentum::name_log("sim_worker");
  omentum::keep_freed_memory();
  omentum::fix_product_blocks();
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "sim_worker: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

// Program dvrk_double: a UDP robot for tests and demonstrations. See --help and docs/dvrk.md 5.
#include <unistd.h>

#include <csignal>
#include <cstdio>
#include <map>

#include "core/command_line.h"
#include "core/config.h"
#include "core/crash_report.h"
#include "core/log.h"
#include "core/printable.h"
#include "dvrk_gateway/dvrk_double/double_program.h"
#include "dvrk_gateway/protocol/base_frame.h"
#include "sim_worker/scene/scene.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace): a program of this very namespace

volatile std::sig_atomic_t stop_requested = 0;
void on_signal(int) { stop_requested = 1; }

struct SceneOptions {
  std::string preset = "omentum";
  std::string file;
  std::vector<std::string> overrides;
  bool tissue = false;
  std::string base_frame = "0,0,0,1,0,0,0";
  std::string instrument = large_needle_driver().name;
};

void add_robot(CLI::App& app, DoubleProgramOptions& options) {
  app.add_option("--port", options.port, "UDP port that the state of the arm is sent to")
      ->check(CLI::Range(1, 65535))
      ->required();
  app.add_option("--to", options.host, "Host that it is sent to")->capture_default_str();
  options.robot.home_at_s = 0.9;
  app.add_option(
         "--home-at", options.robot.home_at_s,
         "Time at which the operator powers and homes the arm [s]; -1: not before `home` is typed")
      ->check(number_between(-1, 1e6))
      ->capture_default_str();
  app.add_flag("--hardware-like", options.robot.hardware_like,
               "Start DISABLED; home in place at an insertion of 0.02 m");
  const std::map<std::string, DoubleOptions::Shape> shapes = {
      {"today", DoubleOptions::Shape::kToday},
      {"all-in-one", DoubleOptions::Shape::kAllInOne},
      {"2019", DoubleOptions::Shape::k2019}};
  app.add_option("--shape", options.robot.shape, "Form of the messages (docs/dvrk.md 4.6)")
      ->transform(CLI::CheckedTransformer(shapes));
  app.add_option("--missing", options.robot.missing_stream,
                 "Name of a stream that is not sent, as measured_cp");
  app.add_option("--invalid", options.robot.invalid_stream,
                 "Name of a stream whose Valid is false");
  app.add_option("--not-finite", options.robot.not_finite_stream,
                 "Name of a stream whose numbers are null");
  app.add_option("--at", options.at,
                 "\"SECONDS COMMAND\": run the command at that time, as if it were typed then; may "
                 "be repeated")
      ->allow_extra_args(false);
  app.add_option("--seconds", options.seconds, "End after so long [s]; 0: until Ctrl-C or `quit`")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
}

void add_network(CLI::App& app, DoubleProgramOptions& options) {
  Disturbance& network = options.network;
  app.add_option("--loss", network.loss, "Share of datagrams that get lost, each way")
      ->check(number_between(0, 1));
  app.add_option("--duplication", network.duplication, "Share of datagrams that arrive twice")
      ->check(number_between(0, 1));
  app.add_option("--reordering", network.reordering,
                 "Share of datagrams that are held back by 15 ms")
      ->check(number_between(0, 1));
  app.add_option("--delay", network.delay_s, "Delay of every datagram [s]")
      ->check(number_between(0, 10));
  app.add_option("--jitter", network.jitter_s,
                 "Random delay of a datagram beside --delay, uniform between 0 and this [s]")
      ->check(number_between(0, 10));
  app.add_option("--period-jitter", options.period_jitter_s,
                 "Time by which periods begin late, uniform between 0 and this [s]")
      ->check(number_between(0, 0.01));
  app.add_option("--seed", options.seed, "Seed of all random numbers")
      ->check(whole_number())
      ->capture_default_str();
}

void add_scene(CLI::App& app, SceneOptions& scene) {
  app.add_option("--preset", scene.preset,
                 "Name of the configuration in deploy/presets whose scene is used")
      ->capture_default_str();
  app.add_option("--scene", scene.file,
                 "Scene file instead of the preset's: effects of the arm, its base, the tissue");
  app.add_option("--set", scene.overrides,
                 "Override a knob, a.b=value, as scene.arm.droop_s.yaw=0.05; may be repeated")
      ->allow_extra_args(false);
  app.add_option("--base-frame", scene.base_frame,
                 "Base frame as set on the robot's console, where the arm stands in the frame of "
                 "its poses and goals: x,y,z,qw,qx,qy,qz, position [m] and quaternion")
      ->capture_default_str();
  app.add_option("--instrument", scene.instrument,
                 "Name or number of the instrument on the arm (docs/dvrk.md 1.1)")
      ->capture_default_str();
  app.add_flag("--tissue", scene.tissue,
               "Simulate the scene's tissue under the jaw, which pulls at the arm");
}

void read_scene(const SceneOptions& chosen, DoubleProgramOptions& options) {
  std::vector<std::string> overrides = chosen.overrides;
  if (!chosen.file.empty()) overrides.insert(overrides.begin(), "scene_file=" + chosen.file);
  const pb::Config config = load_config(chosen.preset, overrides);
  options.effects = config.scene().arm();
  if (chosen.tissue) {
    options.tissue = make_sim_setup(config);
    options.mount = options.tissue->mount;
  } else {
    options.mount = scene_tool_mount(make_scene(config.scene(), scene_directory(config)));
  }
  options.mount.instrument = &find_instrument(chosen.instrument);
  options.robot.X_AR = parse_base_frame(chosen.base_frame);
}

int run(int argc, char** argv) {
  CLI::App app{
      "Double of a robot in software: a da Vinci PSM that speaks the JSON of sawSocketStreamer "
      "over UDP and moves as one does, in real time. Type commands as its operator would:\n" +
      DoubleProgram::commands_help()};
  DoubleProgramOptions options;
  SceneOptions scene;
  add_robot(app, options);
  add_network(app, options);
  add_scene(app, scene);
  app.footer("Exit codes: 0 ended, 2 wrong input.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  read_scene(scene, options);
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  DoubleProgram program(options);
  program.run(stop_requested, STDIN_FILENO);
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  omentum::report_crashes("dvrk_double");
  omentum::name_log("dvrk_double");
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "dvrk_double: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

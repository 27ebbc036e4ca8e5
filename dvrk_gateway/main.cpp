// Program dvrk_gateway: a trained policy on a da Vinci PSM. See --help and docs/dvrk.md 8.
#include <cstdio>
#include <map>

#include "core/command_line.h"
#include "core/crash_report.h"
#include "core/log.h"
#include "core/printable.h"
#include "dvrk_gateway/experiment.h"
#include "dvrk_gateway/gateway_program.h"
#include "dvrk_gateway/recording/convert_program.h"
#include "dvrk_gateway/touch_program.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace): a program of this very namespace

/// HOST:PORT
void split_robot(const std::string& text, GatewayOptions& options) {
  const std::size_t colon = text.rfind(':');
  const double port =
      colon == std::string::npos ? 0 : parse_number(text.substr(colon + 1)).value_or(0);
  if (colon == 0 || !(port >= 1 && port <= 65535) || port != static_cast<std::uint16_t>(port)) {
    throw_error(
        "--robot {}: HOST:PORT, the host that sends and the port 1 ... 65535 of this "
        "machine to which it sends",
        text);
  }
  options.robot_host = text.substr(0, colon);
  options.robot_port = static_cast<std::uint16_t>(port);
}

int run(int argc, char** argv) {
  // It needs neither policy nor robot.
  if (argc > 1 && std::string_view(argv[1]) == "convert")
    return convert_program(argc - 1, argv + 1);
  CLI::App app{
      "Omentum gateway: runs a trained policy on a da Vinci Research Kit over UDP. The arm moves "
      "only after you armed it here; any stop disarms, and nothing resumes by itself."};
  GatewayOptions options;
  std::string robot, starts = "training", outcome = "jaw";
  app.fallthrough();
  app.add_option("--robot", robot,
                 "HOST:PORT, where HOST sends the state of the arm (sawSocketStreamer) and PORT is "
                 "the UDP port of this machine that it sends to");
  app.add_option("--policy", options.policy,
                 "Policy to run: a run folder, a checkpoint file, or bus: the newest that the "
                 "learner of --run publishes")
      ->required();
  const std::map<std::string, GatewayMode> modes = {{"twin", GatewayMode::kTwin},
                                                    {"measured", GatewayMode::kMeasured},
                                                    {"replay", GatewayMode::kReplay},
                                                    {"teach", GatewayMode::kTeach}};
  app.add_option(
         "--mode", options.mode,
         "twin: the policy acts in the simulated scene and the robot follows; measured: the policy "
         "observes where the robot is and the scene follows; replay: the robot follows --motion; "
         "teach: an operator moves the robot and nothing is sent. Default: twin")
      ->transform(CLI::CheckedTransformer(modes));
  app.add_option("--motion", options.motion,
                 "Motion for mode replay: FILE.mcap, a tool.csv, or the folder that holds one");
  app.add_option("--slow", options.slow,
                 "Factor by which mode replay stretches the time of the motion")
      ->check(number_between(0.1, 1000))
      ->capture_default_str();
  app.add_option("--registration", options.registration,
                 "File registration.txtpb, which says where the base of the arm stands; `register` "
                 "writes it, and without it nothing is armed");
  app.add_option("--instrument", options.instrument, "Name or number of the instrument on the arm")
      ->capture_default_str();
  app.add_option(
         "--base-frame", options.base_frame,
         "Base frame as set on the robot's console: x,y,z,qw,qx,qy,qz, position [m] and quaternion")
      ->capture_default_str();
  app.add_option("--limits", options.limits,
                 "Text file with limits of the safety function (SafetyLimits, docs/dvrk.md 7.2); "
                 "default: those built in");
  app.add_option("--episodes", options.episodes, "Number of episodes")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  app.add_option("--starts", starts,
                 "Where episodes start: training: at points drawn by --seed, as in training; "
                 "robot_grid: at the points of the scene's robot_grid, one after the other")
      ->check(CLI::IsMember({"training", "robot_grid"}))
      ->capture_default_str();
  app.add_option("--seed", options.run_seed, "Seed of drawn starts")
      ->check(whole_number())
      ->capture_default_str();
  const std::map<std::string, bool> actions = {{"probable", false}, {"drawn", true}};
  app.add_option("--actions", options.drawn_actions,
                 "probable: the policy's most probable action; drawn: drawn by its probabilities, "
                 "as in training. Default: drawn where training drew scenes, as in preset "
                 "omentum_robust, else probable")
      ->transform(CLI::CheckedTransformer(actions));
  app.add_flag("--dry-run", options.dry_run, "Judge every command and send nothing to the robot");
  add_recording_options(app, options.recording);
  add_bus_options(app, options.bus);
  CLI::App* check = app.add_subcommand("check", "List what the robot sends and what is missing");
  check->add_option("--seconds", options.seconds, "Time to listen [s]")
      ->check(number_between(0.5, 3600))
      ->capture_default_str();
  CLI::App* touch = app.add_subcommand("register",
                                       "Find where the arm stands from points that its tip has "
                                       "touched; writes the file of --registration");
  touch
      ->add_option("--touches", options.touches,
                   "CSV file of the touched points (docs/formats.md 8)")
      ->required();
  touch->add_option("--pivots", options.pivots,
                    "CSV file of poses that turn the tip about one point, to find where the tip is "
                    "(docs/formats.md 8)");
  CLI::App* touches = app.add_subcommand(
      "touches",
      "Write the table that `register` reads while the operator touches point after point");
  touches
      ->add_option("--points", options.points,
                   "CSV file with the columns name, world_x_m, world_y_m, world_z_m and a row for "
                   "each point")
      ->required();
  touches
      ->add_option("--out", options.touches,
                   "CSV file to write, which must not exist (docs/formats.md 8)")
      ->required();
  CLI::App* experiment = app.add_subcommand("experiment",
                                            "Run the policy once from each start of the scene's "
                                            "robot_grid and compare with the simulation");
  experiment
      ->add_option(
          "--out", options.folder,
          "Folder for the table and the report; an experiment that was stopped goes on there")
      ->required();
  experiment->add_option("--starts", options.starts, "Number of starts: the first ones of the grid")
      ->check(CLI::Range(1, 1'000'000))
      ->capture_default_str();
  experiment
      ->add_option("--outcome", outcome,
                   "How it is judged whether tissue is held: jaw: by the jaw, which stops short of "
                   "closing on tissue; ask: by a key that you press after each start")
      ->check(CLI::IsMember({"jaw", "ask"}))
      ->capture_default_str();
  const CLI::App* convert = app.add_subcommand(
      "convert", "Make a recording of a captured wire log; must be the first word");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  if (convert->parsed()) throw_error("convert: is the first word: dvrk_gateway convert LOG ...");
  if (touch->parsed()) {
    if (options.registration.empty()) throw_error("--registration: names the file to write");
    return register_robot(options);
  }
  split_robot(robot, options);
  check_bus_options(options.bus);
  options.robot_grid = starts == "robot_grid";
  options.ask_outcome = outcome == "ask";
  if (experiment->parsed()) return run_experiment(options);
  if (touches->parsed()) return write_touches(options);
  return check->parsed() ? check_robot(options) : run_gateway(options);
}

}  // namespace

int main(int argc, char** argv) {
  omentum::report_crashes("dvrk_gateway");
  omentum::name_log("dvrk_gateway");
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "dvrk_gateway: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

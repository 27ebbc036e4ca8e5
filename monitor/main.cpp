// Program omentum: looks at a run over DDS and tells its learner what to do. See --help and
// docs/monitor.md.
#include <cstdio>

#include "core/command_line.h"
#include "core/crash_report.h"
#include "core/log.h"
#include "core/printable.h"
#include "monitor/control.h"
#include "monitor/doctor.h"
#include "monitor/mirror.h"
#include "monitor/record.h"
#include "monitor/top.h"
#include "monitor/web_server.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace): a program of this very namespace

constexpr double kLongestS = 1e6;

void add_top(CLI::App& app, TopOptions& options) {
  add_tool_options(app, options.tool);
  app.add_flag("--once", options.once, "Print one table and end, as is done without a terminal");
  app.add_option("--interval", options.interval_s, "Time between two tables [s]")
      ->check(number_between(0.1, 3600))
      ->capture_default_str();
  app.add_option("--patience", options.patience_s,
                 "Time to wait for a learner or robot with --once [s]")
      ->check(number_between(0, kLongestS))
      ->capture_default_str();
}

void add_monitor(CLI::App& app, MonitorOptions& options) {
  add_tool_options(app, options.tool);
  app.add_option("--port", options.port, "TCP port of the page; 0: any free one, printed")
      ->check(number_between(0, 65535))
      ->capture_default_str();
  app.add_option("--address", options.address,
                 "Address to listen on; with 0.0.0.0 other machines can look as well")
      ->capture_default_str();
}

void add_record(CLI::App& app, RecordOptions& options) {
  add_tool_options(app, options.tool);
  app.add_option("--out", options.out, "File to write, .mcap; it must not exist")->required();
  app.add_option("--topics", options.topics,
                 "Names of the topics to record, A,B,...; default: all public topics")
      ->delimiter(',')
      ->allow_extra_args(false);
  app.add_option("--seconds", options.seconds, "Time to record [s]; 0: until Ctrl-C")
      ->check(number_between(0, 1e9))
      ->capture_default_str();
}

void add_mirror(CLI::App& app, MirrorOptions& options) {
  add_tool_options(app, options.tool);
  app.add_option("--to-domain", options.to_domain,
                 "DDS domain on loopback to publish into, without security, 0 ... 230")
      ->check(CLI::Range(0, 230))
      ->required();
}

void add_doctor(CLI::App& app, DoctorOptions& options) {
  add_tool_options(app, options.tool)
      ->required(false)
      ->description("Also listen to this run; default: the machine alone");
  app.add_option("--patience", options.patience_s, "Time to listen to the run [s]")
      ->check(number_between(0.5, kLongestS))
      ->capture_default_str();
  options.version = program_version();
}

/// One subcommand per action; `choose` runs when it is parsed.
CLI::App* add_action(CLI::App& app, ControlOptions& options, const char* name, ControlAction action,
                     const char* help) {
  CLI::App* sub = app.add_subcommand(name, help);
  sub->fallthrough();  // --run and the like may stand behind it
  sub->callback([&options, action] { options.command.action = action; });
  return sub;
}

void add_control(CLI::App& app, ControlOptions& options) {
  add_tool_options(app, options.tool);
  app.add_option("--timeout", options.timeout_s, "Time to wait for the reply [s]")
      ->check(number_between(0.1, kLongestS))
      ->capture_default_str();
  app.require_subcommand(1);
  ControlCommand& command = options.command;
  add_action(app, options, "pause", ControlAction::kPause, "Hand out no tasks until `resume`");
  add_action(app, options, "resume", ControlAction::kResume, "Hand out tasks again");
  add_action(app, options, "evaluate", ControlAction::kEvaluate,
             "Evaluate the present policy before the next batch");
  add_action(app, options, "checkpoint", ControlAction::kCheckpoint, "Write a checkpoint now");
  add_action(app, options, "stop", ControlAction::kStop,
             "End the run with a checkpoint from which it can be resumed");
  add_action(app, options, "drain", ControlAction::kDrain,
             "Have a worker hand its work back and leave")
      ->add_option("worker", command.worker_id, "Number of the worker, as `omentum top` shows it")
      ->check(whole_number())
      ->required();
  CLI::App* on = add_action(app, options, "frames", ControlAction::kFramesOn,
                            "Publish live frames of an environment (topic omentum/sim/frame)");
  command.frames_hz = 10;
  on->add_option("slot", command.slot, "Number of the environment (slot), from 0")
      ->check(whole_number())
      ->required();
  on->add_option("--hz", command.frames_hz, "Frames per second [Hz]")
      ->check(number_between(0.1, static_cast<double>(kMaxFramesHz)))
      ->capture_default_str();
  add_action(app, options, "frames-off", ControlAction::kFramesOff,
             "Stop the live frames of an environment")
      ->add_option("slot", command.slot, "Number of the environment (slot), from 0")
      ->check(whole_number())
      ->required();
}

int run(int argc, char** argv) {
  CLI::App app{
      "Looks at a run over DDS: tables, a web page, recordings, a mirror for generic tools, what "
      "is wrong with a machine; and tells the learner what to do."};
  app.require_subcommand(1);
  TopOptions top;
  CLI::App* top_app =
      app.add_subcommand("top", "Show workers, progress, counts of tasks and alarms as a table");
  add_top(*top_app, top);
  MonitorOptions monitor;
  CLI::App* monitor_app = app.add_subcommand(
      "monitor", "Serve the same, with curves and a live 3-D view, as a web page");
  add_monitor(*monitor_app, monitor);
  RecordOptions record;
  CLI::App* record_app = app.add_subcommand("record", "Record topics of the run into an MCAP file");
  add_record(*record_app, record);
  MirrorOptions mirror;
  CLI::App* mirror_app = app.add_subcommand(
      "mirror", "Republish the public topics into an open domain on loopback, for generic tools");
  add_mirror(*mirror_app, mirror);
  DoctorOptions doctor;
  CLI::App* doctor_app = app.add_subcommand(
      "doctor", "Look for what is wrong with machine, network and run, and say what to type");
  add_doctor(*doctor_app, doctor);
  ControlOptions control;
  CLI::App* control_app =
      app.add_subcommand("control",
                         "Tell the learner to pause, resume, evaluate, save or stop; a worker to "
                         "leave; an environment to publish frames");
  add_control(*control_app, control);
  app.footer("Exit codes: 0 done, 1 refused, nothing there or something wrong, 2 wrong input.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  for (ToolOptions* tool :
       {&top.tool, &monitor.tool, &record.tool, &mirror.tool, &doctor.tool, &control.tool}) {
    find_domain(*tool);  // of those that are not asked for there is no run
  }
  if (top_app->parsed()) return run_top(top);
  if (monitor_app->parsed()) return run_monitor(monitor);
  if (record_app->parsed()) return run_record(record);
  if (mirror_app->parsed()) return run_mirror(mirror);
  if (doctor_app->parsed()) return run_doctor(doctor);
  return run_control(control);
}

}  // namespace

int main(int argc, char** argv) {
  omentum::report_crashes("omentum");
  omentum::name_log("omentum");
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "omentum: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

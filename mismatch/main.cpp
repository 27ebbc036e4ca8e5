// mismatch: where simulation and recordings differ. Recordings in and out, simulation of recorded
// commands, calibration, and what physics was left out.

#include <cstdio>
#include <exception>
#include <new>
#include <optional>

#include "core/command_line.h"
#include "core/printable.h"
#include "core/product_blocks.h"
#include "mismatch/calibrate/calibrate_program.h"
#include "mismatch/explain/explain_program.h"
#include "mismatch/explain/limits_program.h"
#include "mismatch/explain/predict_program.h"
#include "mismatch/explain/verdict_program.h"
#include "mismatch/recording/recording_program.h"
#include "mismatch/scene/scene_program.h"
#include "mismatch/simulate/simulate_program.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

int run(int argc, char** argv) {
  CLI::App app{"Omentum mismatch: compares simulation with recordings of the real thing."};
  app.require_subcommand(1);
  const std::function<int()> simulate = add_simulate_command(app);
  const std::function<int()> recordings = add_recording_commands(app);
  const std::function<int()> scene = add_scene_command(app);
  const std::function<int()> calibrate = add_calibrate_command(app);
  const std::function<int()> explain = add_explain_command(app);
  const std::function<int()> limits = add_limits_command(app);
  const std::function<int()> predict = add_predict_command(app);
  const std::function<int()> verdict = add_verdict_commands(app);
  app.footer(
      "Exit codes: 0 done, 1 the tissue fails under the commands, 2 wrong input, or the output "
      "cannot be written.");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  if (app.got_subcommand("calibrate")) return calibrate();
  if (app.got_subcommand("explain")) return explain();
  if (app.got_subcommand("limits")) return limits();
  if (app.got_subcommand("predict")) return predict();
  for (const char* part : {"locate", "name", "model", "show"}) {
    if (app.got_subcommand(part)) return verdict();
  }
  if (app.got_subcommand("scene")) return scene();
  return app.got_subcommand("simulate") ? simulate() : recordings();
}

}  // namespace

int main(int argc, char** argv) {
  omentum::fix_product_blocks();
  try {
    return run(argc, argv);
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "mismatch: scene and commands need more memory than there is\n");
  } catch (const std::exception& error) {
    std::fprintf(stderr, "mismatch: %s\n", omentum::printable(error.what()).c_str());
  }
  return 2;
}

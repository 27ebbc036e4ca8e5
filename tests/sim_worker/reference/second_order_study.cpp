// Tables of decision 0030: reference solid at its default tolerance and shell against
// second-order bricks (tests/reference/README.md), and the error that `mismatch simulate` prints
// against the true one. Run by hand:
//
//   second_order_study [--tolerance M] FILE ...     of tests/reference/results/second_order
//   second_order_study --no-reference --map FILE ...     the shell alone, and where it is off

#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "core/check.h"
#include "core/command_line.h"
#include "sim_worker/playback/mesh_error.h"
#include "support/second_order.h"

namespace omentum {
namespace {

SimulatedRecording recording_of(const test::StaticState& state) {
  SimulatedRecording recording;
  recording.time = {0};
  recording.points = {state.points};
  recording.force = {state.force};
  recording.failure = state.failure;
  return recording;
}

double force_error(const test::SecondOrder& c, const test::StaticState& state) {
  if (!c.has("force")) return 0;
  return (state.force - c.vector("force")).norm() / c.vector("force").norm();
}

struct Options {
  double tolerance = 5e-5;
  bool with_reference = true, with_shell = true, map = false;
  unsigned finer = 1;
};

/// The model less the bricks at every point [mm].
void print_map(const test::SecondOrder& c, const test::StaticState& state) {
  for (std::size_t i = 0; i < c.rest.size(); ++i) {
    const Eigen::Vector3d off = 1e3 * (state.points[i] - c.deformed[i]);
    std::printf("# %5.1f %5.1f  %7.3f %7.3f %7.3f\n", 1e3 * c.rest[i].x(), 1e3 * c.rest[i].y(),
                off.x(), off.y(), off.z());
  }
}

void print_reference(const test::SecondOrder& c, const Scene& scene, bool with_map) {
  std::array<int, 3> cells{};
  const test::StaticState state = test::settle_reference(c, scene, &cells);
  const double rms = test::rms_distance(state.points, c.deformed);
  std::printf(" %d x %d x %d | %.4f | %.2f |", cells[0], cells[1], cells[2], 1e3 * rms,
              100 * force_error(c, state));
  if (!state.failure.empty()) std::printf(" %s", state.failure.c_str());
  std::fflush(stdout);
  const auto run = [&](const pb::ReferenceModel& mesh) {
    Scene other = scene;
    *other.config.mutable_tissue()->mutable_reference() = mesh;
    return recording_of(test::settle_reference(c, other));
  };
  std::vector<std::string> warnings;
  const std::optional<MeshError> error =
      find_mesh_error(recording_of(state), scene.config.tissue().reference(), cells, run, warnings);
  if (error) std::printf(" %.4f | %.2f |", 1e3 * error->rms_m, error->rms_m / rms);
  for (const std::string& warning : warnings) std::printf(" %s", warning.c_str());
  if (with_map) {
    std::puts("");
    print_map(c, state);
  }
}

void print_row(const std::string& path, const Options& options) {
  const test::SecondOrder c = test::read_second_order(path);
  const std::string name = std::filesystem::path(path).stem().string();
  Scene scene = test::make_second_order_scene(c);
  scene.config.mutable_tissue()->mutable_reference()->set_tolerance_m(options.tolerance);
  std::printf("| %s | %.4f |", name.c_str(), 1e3 * c.values.at("own_error")[0]);
  if (options.with_reference) print_reference(c, scene, options.map);
  if (!options.with_shell || c.body != "sheet") {
    std::puts(" - | - |");
    return;
  }
  const test::StaticState shell = test::settle_shell(c, scene, options.finer);
  std::printf(" %.3f | %.2f |%s\n", 1e3 * test::rms_distance(shell.points, c.deformed),
              100 * force_error(c, shell), shell.failure.c_str());
  if (options.map) print_map(c, shell);
  std::fflush(stdout);
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  omentum::Options options;
  std::vector<std::string> files;
  CLI::App app{"Reference solid and shell against second-order bricks."};
  app.add_option("--tolerance", options.tolerance, "Of the reference's mesh [m]");
  app.add_option("--finer", options.finer, "Cells of the shell per pitch of 3 mm");
  app.add_flag("!--no-shell", options.with_shell, "The reference alone");
  app.add_flag("!--no-reference", options.with_reference, "The shell alone");
  app.add_flag("--map", options.map, "Model less bricks at every point, x y at rest, x y z [mm]");
  app.add_option("files", files, "Results of tests/reference/run_second_order.py")->required();
  CLI11_PARSE(app, argc, argv);
  std::printf("| case | own error, mm |%s shell, mm rms | force, %% |\n",
              options.with_reference
                  ? " mesh | reference, mm rms | force, % | printed error, mm | printed / true |"
                  : "");
  std::printf("|---|---|%s---|---|\n", options.with_reference ? "---|---|---|---|---|" : "");
  for (const std::string& file : files) {
    try {
      omentum::print_row(file, options);
    } catch (const omentum::Error& error) {
      std::printf("| %s | %s |\n", file.c_str(), error.what());
    }
  }
  return 0;
}

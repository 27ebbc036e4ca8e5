#include "tests/support/synthetic_run.h"

#include <fmt/core.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <random>
#include <stdexcept>

#include "core/episode_recording.h"
#include "tests/support/paper_scene.h"

namespace omentum::test {
namespace {

namespace fs = std::filesystem;

void write_text(const fs::path& path, const std::string& text) {
  std::ofstream file(path, std::ios::binary);
  file << text;
  if (!file) throw std::runtime_error("cannot write " + path.string());
}

double logistic(double x) { return 1 / (1 + std::exp(-x)); }

std::string metrics_csv(int seed) {
  std::mt19937 random(static_cast<unsigned>(seed));
  std::normal_distribution<double> noise(0, 1);
  std::string text =
      "update,charts/steps_total,charts/physics_steps_total,charts/episodic_return,charts/"
      "episodic_length,"
      "charts/success_rate,charts/exposure_fraction,charts/SPS,losses/entropy,losses/"
      "explained_variance\n";
  const double lag = 0.12e6 * (seed - 2);
  for (int update = 1; update <= 293; ++update) {
    const double steps = 10240.0 * update;
    const double approach = logistic((steps - 0.45e6 - lag) / 0.09e6);
    const double grasp = logistic((steps - 1.4e6 - lag) / 0.22e6);
    const double lift = logistic((steps - 2.2e6 - lag) / 0.25e6);
    const double reward =
        -0.86 + 0.2 * approach + 0.3 * grasp + 0.24 * lift + 0.012 * noise(random);
    text += fmt::format("{},{},{},{:.3f},600,{:.4f},{:.4f},{:.0f},{:.4f},{:.4f}\n", update,
                        10240 * update, 102400 * update, 600 * reward,
                        std::clamp(lift + 0.02 * noise(random), 0.0, 1.0),
                        0.62 * lift * (0.95 + 0.05 * noise(random)), 21500 + 350 * noise(random),
                        3.98 - 2.1 * grasp, std::min(0.97, 0.2 + 0.75 * approach));
  }
  return text;
}

double exposure_of_cell(int row, int column, int seed) {
  return std::clamp(
      0.92 * logistic((row - 4.2 - 0.15 * (seed - 2)) / 0.9) * (1 - 0.025 * std::abs(column - 6)) -
          0.02,
      0.0, 1.0);
}

std::string grid_csv(int rows, int columns, int first_row, int seed, bool robot) {
  std::string text =
      "index,row,column,start_x_m,start_y_m,start_z_m,greedy,reached,held,exposed,exposure,best_"
      "exposure,lost,return,length,"
      "grasp_x_m,grasp_y_m,grasp_z_m\n";
  for (int row = 1; row <= rows; ++row) {
    for (int column = 1; column <= columns; ++column) {
      const double exposure =
          exposure_of_cell(row + first_row - 1, robot ? 2 * column : column, seed);
      const bool failed = robot && (row * 7 + column * 3 + seed) % 5 < 2;
      const bool lost = robot && !failed && (row + column) % 6 == 0;
      text += fmt::format(
          "{},{},{},{:.4f},{:.4f},0.1076,1,{},{},{},{:.4f},{:.4f},{},{:.2f},600,0.0121,{:.4f},0."
          "0312\n",
          (row - 1) * columns + column - 1, row, column, -0.0172 + (column - 5.5) * 0.008867,
          0.0536 + (row - 5.5) * 0.008833, failed || lost ? 0 : 1, failed || lost ? 0 : 1,
          exposure > 0.2 ? 1 : 0, failed || lost ? 0 : exposure, exposure, lost ? 1 : 0,
          -150 + 60 * exposure, 0.02 + 0.008 * row);
    }
  }
  return text;
}

std::string lattice_csv(const Scene& scene) {
  std::string text = "particle,x_m,y_m,z_m,exposure,reached\n";
  for (std::size_t k = 0; k < scene.tissue.particles.size(); ++k) {
    const Eigen::Vector3d& p = scene.tissue.particles[k];
    const double exposure = std::exp(-std::pow((p.x() - 0.021) / 0.028, 2)) *
                            std::clamp((p.y() + 0.03) / 0.06, 0.0, 1.0);
    text += fmt::format("{},{:.4f},{:.4f},{:.4f},{:.4f},1\n", k, p.x(), p.y(), p.z(), exposure);
  }
  return text;
}

/// An episode of 600 steps: down to the sheet, grasp, up to the target, hold.
void write_recording(const fs::path& path, const Scene& scene, int index, double quality) {
  constexpr std::uint32_t kSteps = 600, kGrasp = 190, kLifted = 430;
  RolloutTask task;
  task.kind = TaskKind::kEvaluate;
  task.start_set = StartSet::kGrid;
  task.start_index = static_cast<std::uint32_t>(index);
  task.greedy = true;
  task.steps = kSteps;
  task.frame_stride = 10;
  task.policy_version = 293;
  RolloutSegment segment;
  segment.steps = kSteps;
  const double grasp_y = 0.04 * quality - 0.012;
  const Eigen::Vector3d grasp = scene.tissue.X_WB * Eigen::Vector3d(0.012, grasp_y, 0);
  const Eigen::Vector3d start(-0.0172 + (index % 10 - 4.5) * 0.008867,
                              0.0536 + (index / 10 - 4.5) * 0.008833, 0.1076);
  for (std::uint32_t step = 0; step <= kSteps; ++step) {
    const double down = std::clamp(step / double(kGrasp), 0.0, 1.0);
    const double up = std::clamp((double(step) - kGrasp) / (kLifted - kGrasp), 0.0, 1.0);
    const Eigen::Vector3d tool = step < kGrasp
                                     ? Eigen::Vector3d(start + down * (grasp - start))
                                     : Eigen::Vector3d(grasp + up * (scene.target - grasp));
    if (step % 10 == 0) {
      const std::vector<float> positions =
          lifted_positions(scene, 0.012, grasp_y, scene.target, up);
      segment.frame_positions_in_world_m.insert(segment.frame_positions_in_world_m.end(),
                                                positions.begin(), positions.end());
    }
    if (step == kSteps) break;
    for (int k = 0; k < 14; ++k) segment.observations.push_back(0.1F * static_cast<float>(k));
    for (int k = 0; k < 4; ++k) segment.actions.push_back(1);
    segment.rewards.push_back(static_cast<float>(-0.9 + 0.5 * down + 0.3 * up));
    segment.flags.push_back(step >= kGrasp ? step_flag::kHeld : 0);
    segment.exposures.push_back(static_cast<float>(quality * std::pow(up, 1.5)));
    for (const double value : tool)
      segment.tool_positions_in_world_m.push_back(static_cast<float>(value));
  }
  const RecordingContext context{
      "grid100_greedy", "synthetic", 0xabcdefULL,
      "0123456789ab",   0.02,        static_cast<std::uint32_t>(scene.tissue.particles.size())};
  const Result<void> saved = save_episode(path.string(), task, segment, context);
  if (!saved) throw std::runtime_error(saved.error());
}

}  // namespace

void write_synthetic_run(const std::string& folder, int seed) {
  const fs::path root(folder);
  fs::create_directories(root / "evaluation");
  fs::create_directories(root / "recordings");
  const Scene scene = make_paper_scene();
  write_text(root / "metrics.csv", metrics_csv(seed));
  write_text(root / "evaluation/grid100_greedy.csv", grid_csv(10, 10, 1, seed, false));
  write_text(root / "evaluation/grid100_sampled.csv", grid_csv(10, 10, 1, seed + 1, false));
  write_text(root / "evaluation/robot25_greedy.csv", grid_csv(5, 5, 6, seed, true));
  write_text(root / "evaluation/grasp_lattice.csv", lattice_csv(scene));
  write_text(root / "evaluation/grasp_study.csv",
             "parameter,unit,value,shipped,starts,held,lost,not_taken,too_far,jaw_not_open,"
             "bad_approach,too_thin\n"
             "min_pinch_m,m,0.0003,1,25,20,2,3,0,0,1,2\nmin_pinch_m,m,0.001,0,25,5,0,20,0,0,1,19\n"
             "slip_force_n,N,0.4,0,25,9,11,5,0,0,1,4\n");
  write_text(root / "figures.csv",
             "name,value,unit,command,machine\ntraining time,142.6,s,\"train.sh --set "
             "a=1,b=2\",\"2 cores, made up\"\n"
             "steps per second,21500,1/s,train.sh,\"2 cores, made up\"\n");
  write_text(root / "config.txtpb",
             fmt::format("preset: \"omentum\"\nrollout {{\n  run_seed: {}\n "
                         " slots: 32\n}}\n# <script>alert(1)</script>\n"
                         "report {{\n  task: \"Lift <script>alert(1)</script>.\"\n"
                         "  reward: \"figure <i>4</i>\"\n  starts: \"Two <b>starts</b>.\"\n"
                         "  marked_start {{ row: 8 column: 6 text: \"(8, 6): shown\" }}\n"
                         "  milestone {{ steps: 500000 label: \"approach & more\" }}\n}}\n",
                         seed));
  for (const int index : {75, 64, 53, 42, 19}) {
    write_recording(root / fmt::format("recordings/grid100_greedy_{}.mcap", index), scene, index,
                    exposure_of_cell(index / 10 + 1, index % 10 + 1, seed));
  }
}

}  // namespace omentum::test

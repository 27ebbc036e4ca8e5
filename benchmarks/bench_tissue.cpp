// Environment steps per second of the shipped tissues on one core: robot, contact, grasp,
// observation, reward. One environment step is one decision (20 ms simulated). Best of several
// chunks, thread CPU time; the end state hash tells whether two figures are of the same physics.

#include <algorithm>
#include <cstdio>
#include <string>
#include <vector>

#include "core/clock.h"
#include "core/config.h"
#include "core/rng.h"
#include "sim_worker/backend/image_source.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/cluster/cluster_tissue.h"
#include "sim_worker/models.h"

namespace {

/// Scripted lift with every part of a step at work: down to the sheet, close, up to p_T, hold; the
/// lanes in different phases.
void measure(const std::string& name, const omentum::pb::Config& config, unsigned width) {
  using namespace omentum;  // NOLINT
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  const int lanes = choose_kernel(width).lanes;
  SimBackend backend(setup, lanes, width);
  std::vector<Action> actions(static_cast<std::size_t>(lanes));
  std::vector<StepOutcome> outcomes(actions.size());
  std::vector<float> observation(static_cast<std::size_t>(backend.observation_size()));
  for (int lane = 0; lane < lanes; ++lane) {
    // Half of the lanes hold tissue from the start, as in a training batch.
    EpisodeStart start;
    start.run_seed = 1;
    start.slot = static_cast<std::uint32_t>(lane);
    start.episode_limit = 1U << 30;
    if (lane % 2 == 1 || lanes == 1) {
      start.start_set = StartSet::kGraspLattice;
      start.start_index = static_cast<std::uint32_t>(400 + 20 * lane);
    }
    backend.reset(lane, start);
  }
  double best = 1e9;
  int held = 0;
  constexpr int kChunk = 50;
  for (int chunk = 0; chunk < 9; ++chunk) {
    const double begin = thread_seconds();
    for (int step = 0; step < kChunk; ++step) {
      for (int lane = 0; lane < lanes; ++lane) {
        const auto k = static_cast<std::size_t>(lane);
        actions[k] = backend.hold_action(lane);
        if (lane % 2 == 0 && lanes > 1) {
          const PhiloxWords words = philox(
              {static_cast<std::uint32_t>(lane), static_cast<std::uint32_t>(step), 0, 0}, {0, 0});
          for (std::size_t b = 0; b < 3; ++b)
            actions[k].branch[b] = static_cast<std::uint8_t>(bounded(words[b], 3));
          actions[k].branch[3] = 1;
        }
        backend.observe(lane, observation);
      }
      backend.step(actions, outcomes);
    }
    if (chunk > 0) best = std::min(best, (thread_seconds() - begin) / (kChunk * lanes));
  }
  std::uint64_t hash = 0;
  for (int lane = 0; lane < lanes; ++lane) {
    hash ^= fnv1a64(backend.save(lane));
    held += backend.facts(lane).held ? 1 : 0;
  }
  std::printf("%s %.0f steps/s\n", name.c_str(), 1 / best);
  const auto* cluster = dynamic_cast<const ClusterTissueModel*>(setup->tissue.get());
  std::fprintf(stderr,
               "# %s: %d lanes, %d particles, %zu memberships, %u ticks per step, %d lanes hold, "
               "%.2f us/step, hash %016lx\n",
               name.c_str(), lanes, backend.tissue_of(0).particles(),
               cluster == nullptr ? 0 : cluster->clusters.member.size(), backend.ticks_per_step(),
               held, 1e6 * best, hash);
}

/// Cost of the reward's exposure alone: sheets lifted half way, every lane wanted.
void measure_exposure(const omentum::pb::Config& config, unsigned width) {
  using namespace omentum;  // NOLINT
  const auto setup = make_sim_setup(config, deploy_dir() + "/scenes");
  const int lanes = choose_kernel(width).lanes;
  SimBackend backend(setup, lanes, width);
  std::vector<Action> actions(static_cast<std::size_t>(lanes));
  std::vector<StepOutcome> outcomes(actions.size());
  for (int lane = 0; lane < lanes; ++lane) {
    EpisodeStart start;
    start.start_set = StartSet::kGraspLattice;
    start.start_index = static_cast<std::uint32_t>(400 + 20 * lane);
    start.episode_limit = 1U << 30;
    backend.reset(lane, start);
  }
  for (int step = 0; step < 80; ++step) {
    for (int lane = 0; lane < lanes; ++lane) {
      actions[static_cast<std::size_t>(lane)] = backend.hold_action(lane);
    }
    backend.step(actions, outcomes);
  }
  ExposureEstimator estimator = *setup->exposure;
  std::vector<float> exposures(static_cast<std::size_t>(lanes));
  double best = 1e9;
  constexpr int kChunk = 100;
  for (int chunk = 0; chunk < 9; ++chunk) {
    const double begin = thread_seconds();
    for (int i = 0; i < kChunk; ++i) {
      estimator.of_lanes(backend.tissue_of(0), (1U << lanes) - 1, exposures);
    }
    best = std::min(best, (thread_seconds() - begin) / (kChunk * lanes));
  }
  double mean = 0;
  for (const float e : exposures) mean += static_cast<double>(e) / lanes;
  std::printf("tissue.exposure.us_per_env_step %.2f us\n", 1e6 * best);
  std::fprintf(stderr, "# exposure: %d lanes, %d samples, mean exposure %.3f\n", lanes,
               estimator.subset_samples().size(), mean);
}

/// Time of one observation with the picture of preset omentum_image, sheets held on their way up:
/// of the caller, and of all threads of the process (the rasteriser has its own).
void measure_picture(const std::string& kind, int size) {
  using namespace omentum;  // NOLINT
  const auto setup = make_sim_setup(
      load_config(
          "omentum_image",
          std::vector<std::string>{"task.image=" + kind, fmt::format("task.image_size={}", size)}),
      deploy_dir() + "/scenes");
  SimBackend backend(setup, 1, 1, make_image_source(*setup));
  EpisodeStart start;
  start.start_set = StartSet::kGraspLattice;
  start.start_index = 420;
  start.episode_limit = 1U << 30;
  backend.reset(0, start);
  std::vector<float> observation(static_cast<std::size_t>(backend.observation_size()));
  std::vector<Action> actions(1);
  std::vector<StepOutcome> outcomes(1);
  double best_wall = 1e9, best_cpu = 1e9;
  constexpr int kChunk = 50;
  for (int chunk = 0; chunk < 6; ++chunk) {
    for (int step = 0; step < 20; ++step) {
      actions[0] = backend.hold_action(0);
      backend.step(actions, outcomes);
    }
    const std::int64_t began = steady_now_ns();
    const std::int64_t cpu = clock_ns(CLOCK_PROCESS_CPUTIME_ID);
    for (int i = 0; i < kChunk; ++i) backend.observe(0, observation);
    best_wall = std::min(best_wall, 1e-3 * static_cast<double>(steady_now_ns() - began) / kChunk);
    best_cpu = std::min(
        best_cpu, 1e-3 * static_cast<double>(clock_ns(CLOCK_PROCESS_CPUTIME_ID) - cpu) / kChunk);
  }
  std::printf("tissue.picture.%s_%d.us %.1f us\n", kind == "IMAGE_SHADED" ? "shaded" : "ids", size,
              best_cpu);
  std::fprintf(
      stderr, "# picture %s %d px: %.1f us of wall time, %.1f us of all threads, hash %016lx\n",
      kind.c_str(), size, best_wall, best_cpu, fnv1a64(std::as_bytes(std::span(observation))));
}

}  // namespace

int main(int argc, char** argv) {
  const unsigned width = argc > 1 ? static_cast<unsigned>(std::stoul(argv[1])) : 0;
  // A step of these figures is a control period.
  const std::vector<std::string> period = {"task.action_repeat=1"};
  const std::vector<std::string> cluster_case = {
      period.front(), "scene.tissue.cluster.cluster_spacing_m=0.0127",
      "scene.tissue.cluster.cluster_radius_m=0.0095",
      "scene.tissue.cluster.cluster_stiffness=0.361",
      "scene.tissue.cluster.orphan_policy=ORPHANS_ATTACH_NEAREST"};
  try {
    measure("tissue.cluster.env_steps_per_s", omentum::load_config("omentum", cluster_case), width);
    measure("tissue.omentum.env_steps_per_s", omentum::load_config("omentum", period), width);
    measure("tissue.omentum_elastic.env_steps_per_s",
            omentum::load_config("omentum_elastic", period), width);
    measure("tissue.omentum_soft.env_steps_per_s", omentum::load_config("omentum_soft", period),
            width);
    measure("tissue.paper.env_steps_per_s", omentum::load_config("paper_literal", {}), width);
    measure("tissue.paper_swapped.env_steps_per_s", omentum::load_config("paper_swapped", {}),
            width);
    measure_exposure(omentum::load_config("omentum", period), width);
    for (const char* kind : {"IMAGE_OBJECT_IDS", "IMAGE_SHADED"}) {
      for (const int size : {16, 32, 64}) measure_picture(kind, size);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_tissue: %s\n", error.what());
    return 2;
  }
  return 0;
}

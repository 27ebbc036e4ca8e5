#include "mismatch/simulate/simulator.h"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <utility>

#include "core/check.h"
#include "core/simulation_records.h"
#include "sim_worker/playback/simulation_bytes.h"

namespace omentum {

void add_simulator_options(CLI::App& app, SimulatorOptions& options) {
  app.add_option("--run", options.run,
                 "Simulate on the workers of this run (sim_worker --run NAME) instead of here; "
                 "results do not depend on it");
  app.add_option("--domain", options.domain, "DDS domain of --run, 0 ... 230")
      ->check(CLI::Range(0, 230))
      ->capture_default_str();
  add_dds_options(app, options.dds);
}

Simulator::Simulator(std::size_t threads)
    : threads_(threads), turns_(static_cast<std::ptrdiff_t>(threads)) {}

Simulator::Simulator(std::size_t threads, const SimulatorOptions& options, Tell tell)
    : threads_(threads), tell_(std::move(tell)), turns_(static_cast<std::ptrdiff_t>(threads)) {
  if (options.run.empty()) return;
  constexpr std::size_t kBurst = 2 * kPartBytes;
  // In a hub its workers know this host only, as those of a learner know the learner's.
  const Result<DdsProfile> profile =
      find_dds_profile(options.dds, DdsRole::kHub, options.domain, kBurst);
  if (!profile) throw_error("--run {}: {}", options.run, profile.error());
  asker_ = std::make_unique<SimulationAsker>(SimulationAskerOptions{.run = options.run,
                                                                    .domain = options.domain,
                                                                    .profile = profile.value(),
                                                                    .program = "mismatch",
                                                                    .build_id = options.build_id,
                                                                    .tell = tell_});
}

Simulation Simulator::simulate(const SimulationTask& task) {
  const std::size_t steps = count_steps(task.commands, task.period);
  if (!asker_) {
    Simulation made = omentum::simulate(task);
    steps_ += steps;
    return made;
  }
  Result<Bytes> bytes = task_bytes(task);
  if (!bytes) return simulate_here(task, bytes.error());
  const Result<Bytes> answer = asker_->ask(
      std::move(bytes).value(), static_cast<std::uint32_t>(std::max<std::size_t>(steps, 1)));
  if (!answer) return simulate_here(task, answer.error());
  Result<Simulation> made = read_result(answer.value(), task);
  if (!made) return simulate_here(task, made.error());
  steps_ += steps;
  return std::move(made).value();
}

/// What went wrong elsewhere goes wrong here as well, and in the same words as without workers.
Simulation Simulator::simulate_here(const SimulationTask& task, const std::string& why) {
  Simulation made;
  work_here([&] { made = omentum::simulate(task); });
  steps_ += count_steps(task.commands, task.period);
  const std::lock_guard lock(mutex_);
  if (told_.insert(why).second) tell_("simulated here instead of on a worker: " + why);
  return made;
}

void Simulator::work_here(const std::function<void()>& work) {
  struct Place {
    explicit Place(std::counting_semaphore<>& turns) : turns_(turns) { turns_.acquire(); }
    ~Place() { turns_.release(); }
    Place(const Place&) = delete;
    Place& operator=(const Place&) = delete;
    std::counting_semaphore<>& turns_;
  };
  const Place place(turns_);
  work();
}

std::string Simulator::describe() const {
  const std::string steps = fmt::format("{} steps", steps_.load());
  if (!asker_) return steps;
  const std::uint32_t workers = asker_->state().workers;
  return fmt::format("{}, {} worker{}", steps, workers, workers == 1 ? "" : "s");
}

}  // namespace omentum

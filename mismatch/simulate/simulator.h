#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <mutex>
#include <semaphore>
#include <set>
#include <string>

#include "core/dds_options.h"
#include "granting/simulation_asker.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {

/// Whose workers simulate; no run: this process.
struct SimulatorOptions {
  std::string run;
  std::uint32_t domain = 0;
  DdsOptions dds;
  std::uint64_t build_id = 0;  ///< of this program: workers of another one decline
};

/// Adds --run, --domain and the options of add_dds_options().
void add_simulator_options(CLI::App& app, SimulatorOptions& options);

/// Where simulations are done: on threads of this process, or on the workers of a run. Results are
/// the same bit for bit. Any number of threads at a time.
class Simulator {
 public:
  using Tell = std::function<void(const std::string& line)>;

  /// On so many threads, here.
  explicit Simulator(std::size_t threads);
  /// As the options say. `tell`: what a person should know, from any thread. Throws Error.
  Simulator(std::size_t threads, const SimulatorOptions& options, Tell tell);

  /// simulate(task), and throws what it throws. What cannot be done elsewhere is done here.
  Simulation simulate(const SimulationTask& task);
  /// Jobs that keep it busy, each of which simulates and waits for it.
  std::size_t at_once() const { return asker_ ? kAskedAtOnce : threads_; }
  /// Calls work(), in so many threads at a time as there are.
  void work_here(const std::function<void()>& work);

  /// Processor time of workers [s].
  double seconds_elsewhere() const { return asker_ ? asker_->state().compute_s : 0; }
  /// For a line of progress: "12,345 steps, 2 workers".
  std::string describe() const;

 private:
  static constexpr std::size_t kAskedAtOnce = 64;  // two for each of 32 workers

  Simulation simulate_here(const SimulationTask& task, const std::string& why);

  std::size_t threads_;
  Tell tell_;
  std::counting_semaphore<> turns_;
  std::atomic<std::uint64_t> steps_{0};
  std::mutex mutex_;
  std::set<std::string> told_;  // guarded by mutex_
  std::unique_ptr<SimulationAsker> asker_;
};

}  // namespace omentum

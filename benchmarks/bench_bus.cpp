// What the bus carries: real DDS between real processes over loopback. See --help.
#include <signal.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdio>

#include "benchmarks/synthetic_worker.h"
#include "core/build_id.h"
#include "core/clock.h"
#include "core/command_line.h"
#include "core/config.h"
#include "core/log.h"
#include "core/scheduling.h"
#include "learner/bus.h"
#include "sim_worker/backend/sim_backend.h"

namespace omentum {
namespace {

constexpr std::uint32_t kSlots = 64;
constexpr std::uint32_t kSteps = 256;
constexpr std::int64_t kMs = 1'000'000;

volatile std::sig_atomic_t stop_requested = 0;
void on_signal(int) { stop_requested = 1; }
bool stopped() { return stop_requested != 0; }

double cpu_s() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

/// Workers as processes of their own; ended with this object.
class WorkerProcesses {
 public:
  WorkerProcesses(int count, std::vector<std::string> arguments) {
    for (int i = 0; i < count; ++i) {
      const pid_t child = fork();  // before this process has a participant
      if (child == 0) {
        std::vector<char*> raw;
        for (std::string& argument : arguments) raw.push_back(argument.data());
        raw.push_back(nullptr);
        execv("/proc/self/exe", raw.data());
        _exit(127);
      }
      children_.push_back(child);
    }
  }
  ~WorkerProcesses() {
    for (const pid_t child : children_) kill(child, SIGTERM);
    for (const pid_t child : children_) waitpid(child, nullptr, 0);
  }
  WorkerProcesses(const WorkerProcesses&) = delete;
  WorkerProcesses& operator=(const WorkerProcesses&) = delete;

 private:
  std::vector<pid_t> children_;
};

/// The learner's end without learning: batches are taken and forgotten.
class Loop {
 public:
  Loop(std::uint32_t domain, const std::string& run, const PolicyShape& shape)
      : bus_(options(domain, run)) {
    TaskBookConfig config;
    config.config_hash = kSyntheticConfigHash;
    config.learner_epoch = 1;
    config.slots = kSlots;
    config.steps = kSteps;
    config.lead = 1;
    config.stagger = false;
    config.state_format = kSimStateFormat;
    config.shape = shape;
    book_ = std::make_unique<TaskBook>(config);
    RunManifest manifest;
    manifest.config_hash = kSyntheticConfigHash;
    manifest.layout_hash = config.shape.layout_hash();
    manifest.build_id = build_id();
    manifest.state_format = kSimStateFormat;
    if (Result<void> sent = bus_.publish_manifest(manifest); !sent) throw_error("{}", sent.error());
    weights_.parameters.assign(config.shape.parameter_count(), 0.01F);
    weights_.layout_hash = manifest.layout_hash;
    weights_.config_hash = kSyntheticConfigHash;
    publish();
  }

  /// New weights, of the next version.
  void publish() {
    weights_.parameters[0] += 1;
    weights_.weights_hash = hash_weights(weights_.parameters, {}, {});
    if (Result<void> sent = bus_.publish_weights(weights_); !sent) throw_error("{}", sent.error());
    book_->announce_weights(weights_.policy_version++, weights_.weights_hash);
  }

  /// Serves for so long, publishing after every batch; throws Error when the ledger does not
  /// balance or something was lost.
  void serve(double seconds) {
    const std::int64_t end = steady_now_ns() + static_cast<std::int64_t>(1e9 * seconds);
    while (steady_now_ns() < end) {
      bus_.serve(*book_, steady_now_ns());
      while (book_->batch_complete()) {
        (void)book_->take_batch();
        publish();
        bus_.serve(*book_, steady_now_ns());
      }
      bus_.wait(20 * kMs);
    }
    if (const Result<void> balance = book_->check_balance(); !balance)
      throw_error("{}", balance.error());
    const BusStatistics statistics = bus_.statistics();
    if (statistics.lost + statistics.refused > 0 || book_->ledger().invalid > 0) {
      throw_error("lost {}, refused {}, invalid {}: {}", statistics.lost, statistics.refused,
                  book_->ledger().invalid, book_->last_refusal());
    }
  }

  void wait_for_workers(std::uint32_t count) {
    const std::int64_t end = steady_now_ns() + 30'000 * kMs;
    while (bus_.workers_ready() < count) {
      if (steady_now_ns() > end) throw_error("{} of {} workers", bus_.workers_ready(), count);
      bus_.serve(*book_, steady_now_ns());
      bus_.wait(10 * kMs);
    }
  }

  std::uint64_t steps() const { return book_->ledger().admitted * kSteps; }
  Ledger ledger() const { return book_->ledger(); }

 private:
  static LearnerBusOptions options(std::uint32_t domain, const std::string& run) {
    LearnerBusOptions options;
    options.run = run;
    options.domain = domain;
    options.slots = kSlots;
    options.profile = find_dds_profile({}, DdsRole::kHub, domain, 0).value();
    return options;
  }

  LearnerBus bus_;
  std::unique_ptr<TaskBook> book_;
  PolicyWeights weights_;
};

/// bus.steps_per_s and bus.core_share_at_20k.
int measure_loop(std::uint32_t domain, int workers, double seconds, double pace) {
  const std::string run = "bench_bus";
  const WorkerProcesses processes(
      workers, {"bench_bus", "worker", "--run", run, "--domain", std::to_string(domain), "--pace",
                std::to_string(pace / workers), "--lanes",
                std::to_string(kSlots / static_cast<std::uint32_t>(workers))});
  Loop loop(domain, run, synthetic_shape());
  loop.wait_for_workers(static_cast<std::uint32_t>(workers));
  loop.serve(2);
  const std::uint64_t before = loop.steps();
  const std::int64_t began = steady_now_ns();
  const double cpu = cpu_s();
  loop.serve(seconds);
  const double spent = 1e-9 * static_cast<double>(steady_now_ns() - began);
  const double rate = static_cast<double>(loop.steps() - before) / spent;
  const double share = (cpu_s() - cpu) / spent;
  const Ledger ledger = loop.ledger();
  if (pace > 0) {
    std::printf("bus.core_share_at_20k %.2f %% # of a core, learner, at %.0f steps/s\n",
                100 * share * 20'000 / rate, rate);
  } else {
    std::printf(
        "bus.steps_per_s %.0f steps/s # %d workers, E %u, T %u; %llu segments, %llu twice, learner "
        "%.2f cores\n",
        rate, workers, kSlots, kSteps, static_cast<unsigned long long>(ledger.admitted),
        static_cast<unsigned long long>(ledger.duplicate), share);
  }
  return 0;
}

/// A worker that computes the physics of preset paper_literal for ever and tells of every version
/// when its weights are there and compared with their hash.
int run_physics_worker(const std::string& run, std::uint32_t domain, int delays) {
  const pb::Config config = load_config("paper_literal", {});
  SimBackend backend(make_sim_setup(config), 16, 0, nullptr);
  for (int lane = 0; lane < backend.lanes(); ++lane) {
    EpisodeStart start;
    start.slot = static_cast<std::uint32_t>(lane);
    backend.reset(lane, start);
  }
  WorkerBusOptions options;
  options.run = run;
  options.domain = domain;
  options.profile = find_dds_profile({}, DdsRole::kOther, domain, 0).value();
  options.worker_id = make_worker_id();
  options.on_weights = [delays](const PolicyWeights& weights) {
    const double delay_ms = 1e-6 * static_cast<double>(wall_now_ns() - weights.published_at_ns);
    dprintf(delays, "%llu %.4f\n", static_cast<unsigned long long>(weights.policy_version),
            delay_ms);
  };
  WorkerBus bus(options);
  yield_to_bus();
  const std::vector<Action> actions(static_cast<std::size_t>(backend.lanes()));
  std::vector<StepOutcome> outcomes(actions.size());
  while (!stopped()) {
    backend.step(actions, outcomes);
    (void)bus.take();
  }
  return 0;
}

/// bus.weights_p99_ms_8_workers
int measure_weights(std::uint32_t domain, int workers, double seconds) {
  const std::string run = "bench_weights";
  int ends[2];
  if (pipe(ends) != 0) throw_error("no pipe");
  std::vector<double> delays;
  {
    const WorkerProcesses processes(
        workers, {"bench_bus", "physics", "--run", run, "--domain", std::to_string(domain),
                  "--delays", std::to_string(ends[1])});
    close(ends[1]);
    PolicyShape shape = synthetic_shape();
    shape.hidden = 128;  // 150 kB, as the presets
    Loop loop(domain, run, shape);
    loop.serve(5);  // they make their scene
    const std::int64_t end = steady_now_ns() + static_cast<std::int64_t>(1e9 * seconds);
    while (steady_now_ns() < end) {
      loop.publish();
      loop.serve(0.05);
    }
  }
  FILE* file = fdopen(ends[0], "r");
  unsigned long long version = 0;
  double delay = 0;
  while (std::fscanf(file, "%llu %lf", &version, &delay) == 2) {
    if (version > 20) delays.push_back(delay);  // not those that were kept for who came late
  }
  std::fclose(file);
  if (delays.size() < 100) throw_error("{} arrivals only", delays.size());
  std::sort(delays.begin(), delays.end());
  const auto quantile = [&](double q) {
    return delays[static_cast<std::size_t>(q * static_cast<double>(delays.size() - 1))];
  };
  std::printf("bus.weights_p99_ms_8_workers %.2f ms # p50 %.2f, max %.2f, %zu arrivals\n",
              quantile(0.99), quantile(0.5), delays.back(), delays.size());
  return 0;
}

int run(int argc, char** argv) {
  CLI::App app{"Figures of the bus over loopback, one line \"name value unit\" each."};
  app.require_subcommand(1);
  SyntheticWorker synthetic;
  double seconds = 10;
  int workers = 8;
  int delays = 1;
  const auto common = [&](CLI::App* sub) {
    sub->add_option("--domain", synthetic.domain, "DDS domain")->check(CLI::Range(0, 230));
    sub->add_option("--seconds", seconds, "Duration of the measurement [s]");
    sub->add_option("--workers", workers, "Processes");
    sub->add_option("--run", synthetic.run, "Name of the run");
    return sub;
  };
  CLI::App* loop = common(app.add_subcommand("loop", "Tasks to segments, nothing simulated"));
  CLI::App* share = common(app.add_subcommand("share", "CPU of the learner at 20,000 steps/s"));
  CLI::App* weights = common(app.add_subcommand("weights", "Delay of weights to busy workers"));
  CLI::App* worker = common(app.add_subcommand("worker", "A synthetic worker for any learner"));
  worker->add_option("--pace", synthetic.steps_per_s, "Its speed [steps/s]; 0 = no limit");
  worker->add_option("--lanes", synthetic.lanes, "Environments")->check(CLI::Range(1, 1024));
  CLI::App* physics = common(app.add_subcommand("physics", "A busy worker of weights"));
  physics->add_option("--delays", delays, "File descriptor for the delays");
  if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
  if (loop->parsed()) return measure_loop(synthetic.domain, workers, seconds, 0);
  if (share->parsed()) return measure_loop(synthetic.domain, workers, seconds, 20'000);
  if (weights->parsed()) return measure_weights(synthetic.domain, workers, seconds);
  if (worker->parsed()) return BusWorker(synthetic_worker(synthetic)).run(stopped);
  return run_physics_worker(synthetic.run, synthetic.domain, delays);
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  omentum::name_log("bench_bus");
  omentum::keep_freed_memory();
  try {
    return omentum::run(argc, argv);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_bus: %s\n", error.what());
  }
  return 2;
}

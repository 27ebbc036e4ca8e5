#include "monitor/mirror.h"

#include <fmt/core.h>

#include <atomic>
#include <chrono>
#include <cstdio>
#include <thread>

#include "core/check.h"
#include "core/log.h"
#include "core/wire.h"

namespace omentum {
namespace {

constexpr std::int64_t kLookNs = 100'000'000;  // a signal does not wake the wait set
/// Of a best-effort reader: what is beyond is lost to the mirror, not to the run.
constexpr std::int32_t kMaxSegments = 1024;

struct Counts {
  std::atomic<std::uint64_t> passed = 0, lost = 0, refused = 0;
};

/// One topic on a thread of its own, so that a slow reader of one in the open domain holds up no
/// other.
template <typename Record>
class Relay {
 public:
  Relay(const dds::Participant& from, const dds::Participant& to, const std::string& run,
        Counts& counts, std::int32_t max_samples = 0, bool best_effort = false,
        std::int32_t keep_last = 0)
      : counts_(counts),
        reader_(from, tool_partitions(run), "mirror-reader", max_samples, best_effort),
        writer_(to, public_partitions(run), "mirror-writer", keep_last),
        waitset_(from) {
    waitset_.attach(reader_.raw());
    thread_ = std::jthread([this](const std::stop_token& stop) { pass(stop); });
  }

 private:
  void pass(const std::stop_token& stop) {
    std::uint64_t lost = 0, refused = 0;
    while (!stop.stop_requested()) {
      waitset_.wait(kLookNs);
      const Result<int> taken =
          reader_.take(1024, [this](Arrival<Record>&& arrival) { pass_one(arrival); });
      if (!taken) log().warn("event=not_taken reason=\"{}\"", taken.error());
      counts_.lost += reader_.raw().lost() - lost;
      counts_.refused += reader_.refused() - refused;
      lost = reader_.raw().lost();
      refused = reader_.refused();
    }
  }

  /// The end of an instance comes by itself or with its last sample.
  void pass_one(const Arrival<Record>& arrival) {
    if (arrival.info.valid) count(writer_.write(arrival.record));
    if (arrival.info.state == dds::InstanceState::kDisposed) {
      count(writer_.dispose(arrival.record));
    } else if (arrival.info.state == dds::InstanceState::kNoWriters) {
      count(writer_.unregister(arrival.record));
    }
  }

  void count(const Result<void>& done) {
    if (done) {
      ++counts_.passed;
    } else {
      ++counts_.lost;
      log().warn("event=not_mirrored reason=\"{}\"", done.error());
    }
  }

  Counts& counts_;
  BusReader<Record> reader_;
  BusWriter<Record> writer_;
  dds::Waitset waitset_;
  std::jthread thread_;  // last: it uses the others
};

}  // namespace

int run_mirror(const MirrorOptions& options) {
  if (options.to_domain == options.tool.domain) {
    throw_error("--to-domain {}: is the run's own, allowed: any other of 0 ... 230",
                options.to_domain);
  }
  catch_stop_signals();
  const std::unique_ptr<dds::Participant> from = join_run(options.tool, "omentum-mirror-source");
  if (!from) return 0;
  // Whatever the source needs, and whatever the environment says: the open domain stays on this
  // machine.
  const dds::Participant to(options.to_domain, dds_config_xml({}), "omentum-mirror");
  const std::string& run = options.tool.run;
  Counts counts;
  {
    const Relay<PolicyWeights> weights(*from, to, run, counts);
    const Relay<RolloutSegment> segments(*from, to, run, counts, kMaxSegments, true, kMaxSegments);
    const Relay<WorkerStatus> workers(*from, to, run, counts);
    const Relay<LearnerStatus> learner(*from, to, run, counts);
    const Relay<EpisodeSummary> episodes(*from, to, run, counts);
    const Relay<RunManifest> manifest(*from, to, run, counts);
    const Relay<ControlCommand> commands(*from, to, run, counts);
    const Relay<ControlReply> replies(*from, to, run, counts);
    const Relay<SimFrame> frames(*from, to, run, counts);
    const Relay<RobotStatus> robots(*from, to, run, counts);
    fmt::print("run {} of domain {} can be read in domain {} on loopback\n", run,
               options.tool.domain, options.to_domain);
    std::fflush(stdout);
    while (!stop_requested()) std::this_thread::sleep_for(std::chrono::milliseconds(100));
  }
  fmt::print("{} samples mirrored, {} lost, {} refused\n", counts.passed.load(), counts.lost.load(),
             counts.refused.load());
  return 0;
}

}  // namespace omentum

#include "monitor/record.h"

#include <fmt/format.h>

#include <algorithm>
#include <condition_variable>
#include <cstdio>
#include <deque>
#include <filesystem>
#include <fstream>
#include <functional>
#include <memory>
#include <mutex>
#include <thread>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/log.h"
#include "core/mcap.h"
#include "core/wire.h"
#include "monitor/bus_messages.h"

namespace omentum {
namespace {

constexpr std::int64_t kLookNs = 100'000'000;                // a signal does not wake the wait set
constexpr std::int64_t kFlushNs = 2'000'000'000;             // a crash loses no more than that
constexpr std::size_t kQueueBytes = std::size_t{256} << 20;  // between bus and disk
constexpr std::int32_t kMaxSegments = 4096;                  // of the best-effort reader

/// Every topic that can be recorded; the learner's tasks are for one worker each and not public.
constexpr TopicId kRecordable[] = {TopicId::kPolicyWeights,  TopicId::kRolloutSegment,
                                   TopicId::kWorkerStatus,   TopicId::kLearnerStatus,
                                   TopicId::kEpisodeSummary, TopicId::kRunManifest,
                                   TopicId::kControlCommand, TopicId::kControlReply,
                                   TopicId::kSimFrame,       TopicId::kRobotState};

/// A message on its way to the file.
struct Item {
  TopicId topic = TopicId::kSimFrame;
  std::uint64_t time_ns = 0;
  std::unique_ptr<google::protobuf::Message> message;
  std::size_t bytes = 0;
};

/// Bounded by bytes; what does not fit is dropped and counted.
class Queue {
 public:
  void push(Item&& item) {
    const std::lock_guard lock(mutex_);
    if (bytes_ + item.bytes > kQueueBytes) {
      ++dropped_;
      return;
    }
    bytes_ += item.bytes;
    items_.push_back(std::move(item));
    filled_.notify_one();
  }
  /// All that is there, after a wait when there is nothing.
  std::deque<Item> take_all() {
    std::unique_lock lock(mutex_);
    filled_.wait_for(lock, std::chrono::nanoseconds(kLookNs), [this] { return !items_.empty(); });
    bytes_ = 0;
    return std::exchange(items_, {});
  }
  std::uint64_t dropped() {
    const std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  std::mutex mutex_;
  std::condition_variable filled_;
  std::deque<Item> items_;     // guarded by mutex_
  std::size_t bytes_ = 0;      // guarded by mutex_
  std::uint64_t dropped_ = 0;  // guarded by mutex_
};

/// A topic that is recorded; used by the drain thread alone once made.
class Tap {
 public:
  Tap() = default;
  Tap(const Tap&) = delete;
  Tap& operator=(const Tap&) = delete;
  virtual ~Tap() = default;
  virtual void take_into(Queue& queue) = 0;
  virtual const dds::Reader& raw() const = 0;
  virtual std::uint64_t refused() const = 0;
  virtual const google::protobuf::Descriptor& type() const = 0;
};

template <typename Record>
class TapOf : public Tap {
 public:
  using Message = decltype(to_message(std::declval<const Record&>()));

  TapOf(const dds::Participant& participant, const std::string& run, TopicId topic)
      : topic_(topic),
        reader_(participant, tool_partitions(run), "recorder",
                topic == TopicId::kRolloutSegment ? kMaxSegments : 0,
                topic == TopicId::kRolloutSegment) {}

  void take_into(Queue& queue) override {
    const Result<int> taken = reader_.take(1024, [&](Arrival<Record>&& arrival) {
      if (!arrival.info.valid) return;
      Item item{topic_, static_cast<std::uint64_t>(wall_now_ns()),
                std::make_unique<Message>(to_message(arrival.record)), 0};
      item.bytes = item.message->SpaceUsedLong();
      queue.push(std::move(item));
    });
    if (!taken) log().warn("event=not_taken reason=\"{}\"", taken.error());
  }
  const dds::Reader& raw() const override { return reader_.raw(); }
  std::uint64_t refused() const override { return reader_.refused(); }
  const google::protobuf::Descriptor& type() const override { return *Message::descriptor(); }

 private:
  TopicId topic_;
  BusReader<Record> reader_;
};

std::unique_ptr<Tap> make_tap(TopicId topic, const dds::Participant& participant,
                              const std::string& run) {
  switch (topic) {
    case TopicId::kPolicyWeights:
      return std::make_unique<TapOf<PolicyWeights>>(participant, run, topic);
    case TopicId::kRolloutSegment:
      return std::make_unique<TapOf<RolloutSegment>>(participant, run, topic);
    case TopicId::kWorkerStatus:
      return std::make_unique<TapOf<WorkerStatus>>(participant, run, topic);
    case TopicId::kLearnerStatus:
      return std::make_unique<TapOf<LearnerStatus>>(participant, run, topic);
    case TopicId::kEpisodeSummary:
      return std::make_unique<TapOf<EpisodeSummary>>(participant, run, topic);
    case TopicId::kRunManifest:
      return std::make_unique<TapOf<RunManifest>>(participant, run, topic);
    case TopicId::kControlCommand:
      return std::make_unique<TapOf<ControlCommand>>(participant, run, topic);
    case TopicId::kControlReply:
      return std::make_unique<TapOf<ControlReply>>(participant, run, topic);
    case TopicId::kSimFrame:
      return std::make_unique<TapOf<SimFrame>>(participant, run, topic);
    case TopicId::kRobotState:
      return std::make_unique<TapOf<RobotStatus>>(participant, run, topic);
    case TopicId::kRolloutTask:
    case TopicId::kSimulationTask:
    case TopicId::kSimulationResult:
      break;
  }
  OMENTUM_CHECK(false, "topic {} is not recorded", topic_spec(topic).name);
  return nullptr;
}

std::vector<TopicId> chosen_topics(const std::vector<std::string>& names) {
  std::vector<TopicId> chosen;
  for (const TopicId topic : kRecordable) {
    const bool named = std::find(names.begin(), names.end(), topic_spec(topic).name) != names.end();
    if (names.empty() || named) chosen.push_back(topic);
  }
  return chosen;
}

/// Opens the file, before the bus is joined: what cannot be written is told at once, and no domain
/// is taken down while it is still being made.
std::ofstream open_out(const RecordOptions& options) {
  const std::vector<std::string> allowed = recordable_topics();
  for (const std::string& name : options.topics) {
    if (std::find(allowed.begin(), allowed.end(), name) == allowed.end())
      throw_error("--topics {}: allowed {}", name, fmt::join(allowed, ", "));
  }
  if (std::filesystem::exists(options.out))
    throw_error("--out {}: is there already; name another file or remove it", options.out);
  std::ofstream file(options.out, std::ios::binary);
  if (!file) throw_error("--out {}: cannot be written", options.out);
  return file;
}

/// The file and its channels.
class Recorder {
 public:
  Recorder(std::ofstream&& file, const std::map<TopicId, std::unique_ptr<Tap>>& taps)
      : file_(std::move(file)), writer_(file_) {
    for (const auto& [topic, tap] : taps)
      channels_[topic] = {writer_.add_channel(topic_spec(topic).name, tap->type()), 0};
  }
  void write(const std::deque<Item>& items) {
    for (const Item& item : items) {
      auto& [channel, count] = channels_.at(item.topic);
      writer_.write(channel, item.time_ns, static_cast<std::uint32_t>(count++), *item.message);
    }
    if (steady_now_ns() - flushed_at_ns_ < kFlushNs) return;
    writer_.flush();
    file_.flush();
    flushed_at_ns_ = steady_now_ns();
  }
  bool good() const { return file_.good(); }
  Result<void> finish() {
    Result<void> finished = writer_.finish();
    file_.close();
    if (finished && !file_) return Failure{"the file could not be closed"};
    return finished;
  }
  std::uint64_t count(TopicId topic) const { return channels_.at(topic).second; }

 private:
  std::ofstream file_;
  McapWriter writer_;
  std::map<TopicId, std::pair<McapWriter::ChannelId, std::uint64_t>> channels_;
  std::int64_t flushed_at_ns_ = steady_now_ns();
};

}  // namespace

std::vector<std::string> recordable_topics() {
  std::vector<std::string> names;
  for (const TopicId topic : kRecordable) names.emplace_back(topic_spec(topic).name);
  return names;
}

int run_record(const RecordOptions& options) {
  check_run_name(options.tool.run);
  std::ofstream file = open_out(options);
  catch_stop_signals();
  const std::unique_ptr<dds::Participant> participant = join_run(options.tool, "omentum-record");
  if (!participant) return 0;
  std::map<TopicId, std::unique_ptr<Tap>> taps;
  dds::Waitset waitset(*participant);
  for (const TopicId topic : chosen_topics(options.topics)) {
    taps[topic] = make_tap(topic, *participant, options.tool.run);
    waitset.attach(taps[topic]->raw());
  }
  Recorder recorder(std::move(file), taps);
  Queue queue;
  std::jthread drain([&](const std::stop_token& stop) {
    while (!stop.stop_requested()) {
      waitset.wait(kLookNs);
      for (const auto& [topic, tap] : taps) tap->take_into(queue);
    }
  });
  const std::int64_t began = steady_now_ns();
  const auto over = [&] { return options.seconds > 0 && seconds_since(began) >= options.seconds; };
  while (!stop_requested() && !over() && recorder.good()) recorder.write(queue.take_all());
  drain.request_stop();
  drain.join();
  recorder.write(queue.take_all());
  const Result<void> finished = recorder.finish();
  for (const auto& [topic, tap] : taps) {
    fmt::print("{}: {} samples, {} lost, {} refused\n", topic_spec(topic).name,
               recorder.count(topic), tap->raw().lost(), tap->refused());
  }
  fmt::print("{}: {} samples dropped, as the disk was too slow\n", options.out, queue.dropped());
  if (!finished) {
    fmt::print(stderr, "--out {}: {}\n", options.out, finished.error());
    return 1;
  }
  const bool any = std::ranges::any_of(taps, [&](const auto& entry) {
    return recorder.count(entry.first) > 0 || entry.second->raw().matched() > 0;
  });
  if (any) return 0;
  fmt::print(stderr, "nothing came: nobody of run {} spoke on domain {}, so {} is empty\n",
             options.tool.run, options.tool.domain, options.out);
  return 1;
}

}  // namespace omentum

#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/dds.h"
#include "core/result.h"
#include "core/segment_fields.h"
#include "core/topics.h"
#include "core/types.h"

/// The bus in terms of core/types.h. core/wire.cpp and wire_fields.h alone know the types idlc
/// generates. Records: PolicyWeights, RolloutTask, RolloutSegment, WorkerStatus, LearnerStatus,
/// EpisodeSummary, RunManifest, ControlCommand, ControlReply, SimFrame, RobotStatus; of
/// core/simulation_records.h SimulationGrant, SimulationPart.
///
/// On the way out sequences borrow the memory of the record's vectors; nothing is copied before
/// serialisation. On the way in every length, enumerator and relation between lengths is checked
/// before anything is copied; what fails is counted in refused() and dropped. A segment is checked
/// further against its task, by check_segment() of learner/segment_check.h.
namespace omentum {

/// A sample as received. With info.valid false only the key fields of `record` are set.
template <typename Record>
struct Arrival {
  Record record;
  dds::SampleInfo info;
};

/// One writer of a topic. One thread at a time.
template <typename Record>
class BusWriter {
 public:
  /// Throws Error. `partitions` from core/topics.h; `name` is shown by tools; `keep_last` > 0:
  /// never waits for readers, also where the topic keeps all.
  BusWriter(const dds::Participant& participant, std::vector<std::string> partitions,
            const std::string& name, std::int32_t keep_last = 0);

  /// Returns when the record is serialised. A failure with timed_out() may be retried with the same
  /// record.
  [[nodiscard]] Result<void> write(const Record& record);
  /// Announces that the instance with the key of `record` left on purpose.
  [[nodiscard]] Result<void> dispose(const Record& record);
  /// Leaves the instance with the key of `record`: readers see it as if this writer had crashed.
  [[nodiscard]] Result<void> unregister(const Record& record);

  // See dds::Writer.
  bool timed_out() const { return writer_.timed_out(); }
  int matched() const { return writer_.matched(); }
  dds::WriterCounters counters() const { return writer_.counters(); }
  bool wait_for_acknowledgments(std::int64_t timeout_ns) const {
    return writer_.wait_for_acknowledgments(timeout_ns);
  }
  std::int32_t handle() const { return writer_.handle(); }

 private:
  dds::Topic topic_;
  dds::Writer writer_;
};

/// One reader of a topic. One thread at a time.
template <typename Record>
class BusReader {
 public:
  /// Throws Error. `max_samples`: limit of a KEEP_ALL reader, beyond which the whole process
  /// receives nothing (docs/wire.md 5.1), 0 = none; depth of a KEEP_LAST reader, 0 = the topic's.
  /// `best_effort`: no writer waits for this reader; every tool's but a recorder's (docs/wire.md
  /// 5.2).
  BusReader(const dds::Participant& participant, std::vector<std::string> partitions,
            const std::string& name, std::int32_t max_samples = 0, bool best_effort = false);

  /// Hands up to `limit` arrivals to fn and returns how many were taken, refused ones included.
  [[nodiscard]] Result<int> take(int limit, const std::function<void(Arrival<Record>&&)>& fn);
  /// Samples that arrived but failed the checks, since creation; and why the last one did.
  std::uint64_t refused() const { return refused_; }
  const std::string& last_refusal() const { return last_refusal_; }
  const dds::Reader& raw() const { return reader_; }

 private:
  dds::Topic topic_;
  dds::Reader reader_;
  std::uint64_t refused_ = 0;
  std::string last_refusal_;
};

/// Checks a sample of the generated type, as the middleware hands it out, and copies it into
/// `record`. Returns what is wrong with it; the record is to be dropped then. What
/// BusReader::take() does, apart from it for the fuzz target.
template <typename Record>
std::optional<std::string> read_sample(const void* sample, Record& record);

/// Serialised size estimate of the bulk records, for the bytes-per-second counters.
std::size_t wire_bytes(const RolloutSegment& segment);
std::size_t wire_bytes(const RolloutTask& task);
std::size_t wire_bytes(const PolicyWeights& weights);

}  // namespace omentum

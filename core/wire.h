#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "core/dds.h"
#include "core/result.h"
#include "core/segment_fields.h"
#include "core/topics.h"
#include "core/types.h"

/// The bus in terms of core/types.h. core/wire.cpp and what it is made of (wire_fields.h,
/// wire_check.cpp) alone know the types idlc generates. Records: PolicyWeights, RolloutTask,
/// RolloutSegment, WorkerStatus, LearnerStatus, EpisodeSummary, RunManifest.
///
/// On the way out sequences borrow the memory of the record's vectors; nothing is copied before
/// serialisation. On the way in every length, enumerator and relation between lengths is checked
/// before anything is copied; what fails is counted in refused() and dropped, never handed to the
/// caller.
namespace omentum {

/// Topic of a record: topic_of<RolloutTask>() and so on.
template <typename Record>
TopicId topic_of();

/// Relations between the fields of a record that came from outside, beside the bounds and
/// enumerators that every record is held to; one line naming the field. A segment has none here:
/// check_segment() of learner/segment_check.h knows the task that it must fit.
template <typename Record>
Result<void> check_record(const Record& record);

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
  /// Throws Error. `partitions` from core/topics.h; `name` is shown by tools.
  BusWriter(const dds::Participant& participant, std::vector<std::string> partitions,
            const std::string& name);
  ~BusWriter();
  BusWriter(BusWriter&&) noexcept;
  BusWriter& operator=(BusWriter&&) noexcept;

  /// Returns when the record is serialised. A failure with timed_out() may be retried with the same
  /// record.
  [[nodiscard]] Result<void> write(const Record& record);
  bool timed_out() const;
  /// Announces that the instance with the key of `record` left on purpose.
  [[nodiscard]] Result<void> dispose(const Record& record);
  int matched() const;
  dds::WriterCounters counters() const;
  bool wait_for_acknowledgments(std::int64_t timeout_ns) const;
  std::int32_t handle() const;

 private:
  struct Endpoint;
  std::unique_ptr<Endpoint> endpoint_;
};

/// One reader of a topic. One thread at a time.
template <typename Record>
class BusReader {
 public:
  struct Options {
    std::int32_t max_samples = 0;  ///< fuse of a KEEP_ALL reader; 0 = unlimited
    bool best_effort = false;      ///< for tools
  };
  /// Throws Error.
  BusReader(const dds::Participant& participant, std::vector<std::string> partitions,
            const std::string& name, Options options = {});
  ~BusReader();
  BusReader(BusReader&&) noexcept;
  BusReader& operator=(BusReader&&) noexcept;

  /// Hands up to `limit` arrivals to fn and returns how many were taken, refused ones included.
  [[nodiscard]] Result<int> take(int limit, const std::function<void(Arrival<Record>&&)>& fn);
  /// Samples that arrived but failed the checks, since creation; and why the last one did.
  std::uint64_t refused() const;
  const std::string& last_refusal() const;
  /// See dds::Reader.
  std::uint64_t lost() const;
  std::uint64_t rejected() const;
  int matched() const;
  const dds::Reader& raw() const;

 private:
  struct Endpoint;
  std::unique_ptr<Endpoint> endpoint_;
};

/// Serialised size estimate of the bulk records, for the bytes-per-second counters.
std::size_t wire_bytes(const RolloutSegment& segment);
std::size_t wire_bytes(const RolloutTask& task);
std::size_t wire_bytes(const PolicyWeights& weights);

}  // namespace omentum

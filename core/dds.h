#pragma once

#include <atomic>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/topics.h"

struct dds_topic_descriptor;

/// Ownership of Cyclone DDS 0.10.2 entities (docs/wire.md 8). core/dds.cpp alone includes the DDS
/// interface. Samples are untyped here; core/wire.h gives them types.
///
/// Creation errors throw Error with operation, topic and Cyclone's reason; write and take return
/// Result. One thread at a time per object, except where a function says otherwise. Create
/// participants after any fork.
namespace omentum::dds {

/// A DDS entity, deleted with this object. Declare participants before what is made from them.
class Entity {
 public:
  Entity() = default;
  /// Takes a handle or a negative return code; on the latter throws Error "<operation>: <reason>".
  Entity(std::int32_t handle, const std::string& operation);
  ~Entity() { close(); }
  Entity(Entity&& other) noexcept : handle_(other.handle_) { other.handle_ = 0; }
  Entity& operator=(Entity&& other) noexcept;
  Entity(const Entity&) = delete;
  Entity& operator=(const Entity&) = delete;

  std::int32_t handle() const { return handle_; }
  explicit operator bool() const { return handle_ > 0; }
  /// Deletes now. A writer waits up to 1 s for samples that readers have not acknowledged.
  void close() noexcept;

 private:
  std::int32_t handle_ = 0;
};

/// How one endpoint differs from others of its topic.
struct EndpointUse {
  std::vector<std::string> partitions;
  std::string entity_name;  ///< shown by tools
  /// Reader: samples it holds at most with KEEP_ALL, samples per instance with KEEP_LAST; 0 = no
  /// limit, or as the topic.
  std::int32_t max_samples = 0;
  /// Writer: KEEP_LAST of so many on a KEEP_ALL topic, so that it never waits; 0 = as the topic.
  std::int32_t keep_last = 0;
  /// Reader: takes what comes and asks for nothing again, so that no writer ever waits for it.
  bool best_effort = false;
};

/// Membership of this process in a domain. Participants of one process in the same domain use the
/// configuration of the first one. Throws Error for a domain outside 0 to 230, a
/// bad configuration, or when no participant index is free.
class Participant {
 public:
  Participant(const Participant&) = delete;
  Participant& operator=(const Participant&) = delete;
  /// `uri` as in CYCLONEDDS_URI: XML text or file:// addresses. Where its interface is lo, the UDP
  /// sockets of this process that are bound to every address are bound to lo: Cyclone would take
  /// packets from anywhere. Not while other threads open sockets.
  Participant(std::uint32_t domain, const std::string& uri, const std::string& name);

  std::int32_t handle() const { return entity_.handle(); }
  /// Whom its certificate names; empty without security.
  const std::string& certificate_name() const { return certificate_name_; }
  /// From one second before the certificate ends, and for good. Cyclone 0.10.2 deletes its half of
  /// the participant then, without a word: write and take go on to succeed and reach nobody, and to
  /// create a writer or reader would crash; here that throws Error from then on (docs/cluster.md
  /// 5). Destroy all that was made from it and join anew with renewed files, or end. Any thread.
  bool expired() const;
  /// Another participant of this name is in the domain, or one whose name is not told (DDS
  /// Security). Reads what discovery knows: not for a loop.
  bool sees(const std::string& name) const;

 private:
  std::string certificate_name_;
  std::int64_t certificate_end_s_ = 0;  ///< since 1970 UTC; 0 without security
  std::shared_ptr<void> domain_lease_;  // outlives entity_
  Entity entity_;
};

/// Registered type and name. The descriptor is static data made by idlc; `spec` must outlive the
/// topic, as those of topics() do.
class Topic {
 public:
  Topic(const Participant& participant, const TopicSpec& spec,
        const dds_topic_descriptor& descriptor);
  std::int32_t handle() const { return entity_.handle(); }
  const TopicSpec& spec() const { return *spec_; }

 private:
  Entity entity_;
  const TopicSpec* spec_;
};

enum class InstanceState {
  kAlive,
  kDisposed,   ///< the writer left on purpose
  kNoWriters,  ///< every writer crashed or became unreachable
};

/// What comes with a sample.
struct SampleInfo {
  bool valid = false;  ///< false: life-cycle only, the sample holds nothing but the key
  InstanceState state = InstanceState::kAlive;
  std::uint64_t writer = 0;  ///< identity of the writer within this process
  /// Identity of the participant it belongs to; 0 when it had left before its first sample was
  /// taken. All writers of one program have the same.
  std::uint64_t participant = 0;
};

/// Counters of one writer, since creation.
struct WriterCounters {
  std::uint64_t rexmit_bytes = 0;
  std::uint64_t throttle_count = 0;
  std::uint64_t time_throttle_ns = 0;
};

class Writer {
 public:
  Writer(const Participant& participant, const Topic& topic, const EndpointUse& use);
  /// Serialises before it returns: the sample's memory may be reused at once. Fails with
  /// timed_out() true when readers did not acknowledge in time; nothing was stored then, and the
  /// same sample may be written again.
  [[nodiscard]] Result<void> write(const void* sample);
  bool timed_out() const { return timed_out_; }
  /// Announces that the instance of the sample's key left on purpose.
  [[nodiscard]] Result<void> dispose(const void* sample);
  /// Leaves the instance of the sample's key: readers see it as if this writer had crashed.
  [[nodiscard]] Result<void> unregister(const void* sample);
  /// Readers matched now.
  int matched() const;
  WriterCounters counters() const;
  std::int32_t handle() const { return entity_.handle(); }
  /// Blocks until every matched reader acknowledged, at most `timeout_ns`. Shut-down only: costs a
  /// heartbeat period.
  bool wait_for_acknowledgments(std::int64_t timeout_ns) const;

 private:
  Entity publisher_;
  Entity entity_;
  std::string name_;
  bool timed_out_ = false;
};

class Reader {
 public:
  /// `topic` outlives it and has no other reader with a limit.
  Reader(const Participant& participant, const Topic& topic, const EndpointUse& use);
  Reader(const Reader&) = delete;
  Reader& operator=(const Reader&) = delete;
  /// One with a limit drops what still arrives: full when it goes, it would hold up the threads of
  /// the library for as long as a flood lasts, and with them everything that goes after it.
  ~Reader();
  /// Calls fn(sample, info) for up to `limit` samples and returns their number. Samples are on
  /// loan: they live until fn returns and go back even when it throws.
  [[nodiscard]] Result<int> take(
      int limit, const std::function<void(const void* sample, const SampleInfo& info)>& fn);
  int matched() const;
  /// Samples the middleware lost since creation.
  std::uint64_t lost() const;
  /// Times the cache was full: the sample is delivered again later, but until then this process
  /// receives nothing else.
  std::uint64_t rejected() const;
  std::int32_t handle() const { return entity_.handle(); }
  std::int32_t condition() const { return condition_.handle(); }

 private:
  Entity subscriber_;
  Entity entity_;
  Entity condition_;
  std::string name_;
  bool limited_ = false;                                 ///< can be full
  std::atomic<bool> closing_{false};                     ///< seen by the filter of its topic
  std::map<std::uint64_t, std::uint64_t> participants_;  ///< of the writers seen

  std::uint64_t participant_of(std::uint64_t writer);
};

/// Blocks a thread until one of some readers holds samples or another thread calls wake().
class Waitset {
 public:
  explicit Waitset(const Participant& participant);
  void attach(const Reader& reader);
  /// True when something is there, false after the timeout. Level-triggered for readers; a wake()
  /// is consumed.
  bool wait(std::int64_t timeout_ns);
  /// From any thread. Not from a signal handler.
  void wake();

 private:
  Entity guard_;
  Entity waitset_;
};

}  // namespace omentum::dds

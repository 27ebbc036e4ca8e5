#include "core/wire.h"

#include <algorithm>
#include <array>
#include <optional>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>

#include "core/limits.h"
#include "core/wire_fields.h"

namespace omentum {

static_assert(kMaxStateBytes == omentum_v1_MAX_STATE_BYTES &&
              kMaxParameters == omentum_v1_MAX_PARAMETERS &&
              segment_limit::kSteps == omentum_v1_MAX_STEPS &&
              segment_limit::kStepValues == omentum_v1_MAX_STEP_VALUES &&
              segment_limit::kObservation == omentum_v1_MAX_OBSERVATION &&
              segment_limit::kObservations == omentum_v1_MAX_OBSERVATIONS &&
              segment_limit::kEpisodes == omentum_v1_MAX_EPISODES &&
              kMaxFrameValues == omentum_v1_MAX_FRAME_VALUES &&
              kMaxTaskBytes == omentum_v1_MAX_TASK_BYTES &&
              kPartBytes == omentum_v1_MAX_PART_BYTES && kMaxParts == omentum_v1_MAX_PARTS);

namespace {

/// The first thing that is wrong with a record.
class FirstFailure {
 public:
  void fail(std::string_view name, std::string_view reason) {
    if (!text_) text_ = fmt::format("{}: {}", name, reason);
  }
  const std::optional<std::string>& failure() const { return text_; }

 private:
  std::optional<std::string> text_;
};

// Points generated sequences at memory of the core record. Nothing is owned: _release stays false,
// and the generated struct must not outlive the record.
class Borrow : public FirstFailure {
 public:
  void values(auto& wire, const auto& core, auto members) { members(wire) = members(core); }
  void delivery(auto& wire, const auto& core, auto members) { values(wire, core, members); }

  template <typename E, typename C>
  void enumerator(E& wire, const C& core, C last, std::string_view name) {
    if (core > last) fail(name, "enumerator out of range");
    wire = static_cast<E>(core);
  }

  template <typename S, typename T>
  void array(S& wire, const std::vector<T>& core, const ArrayField& field) {
    borrow(wire, core.data(), core.size(), field.bound, field.name);
  }

  template <typename S, typename T, std::size_t N>
  void fixed(S& wire, const std::array<T, N>& core, std::string_view name) {
    borrow(wire, core.data(), N, N, name);
  }

  void text(char*& wire, const std::string& core, std::string_view name) {
    if (core.find('\0') != std::string::npos) fail(name, "contains a zero byte");
    wire = const_cast<char*>(core.c_str());  // the C types have no const; never written through
  }

  template <typename S>
  void texts(S& wire, const std::vector<std::string>& core, std::size_t bound,
             std::string_view name) {
    std::vector<char*>& pointers = lists_.at(next_list_++);
    for (const std::string& entry : core) text(pointers.emplace_back(), entry, name);
    borrow(wire, pointers.data(), pointers.size(), bound, name);
  }

 private:
  template <typename S, typename T>
  void borrow(S& wire, const T* data, std::size_t size, std::size_t bound, std::string_view name) {
    using Element = std::remove_pointer_t<decltype(wire._buffer)>;
    static_assert(sizeof(Element) == sizeof(T));
    if (size > bound) fail(name, fmt::format("length {} exceeds {}", size, bound));
    wire._buffer = const_cast<Element*>(reinterpret_cast<const Element*>(data));
    wire._length = static_cast<std::uint32_t>(size);
    wire._maximum = wire._length;
    wire._release = false;
  }

  std::array<std::vector<char*>, 2> lists_;  // pointers of sequences of strings
  std::size_t next_list_ = 0;
};

// Copies a received sample; stops at the first field that does not pass.
class Copy : public FirstFailure {
 public:
  void values(const auto& wire, auto& core, auto members) { members(core) = members(wire); }
  void delivery(const auto& wire, auto& core, auto members) { values(wire, core, members); }

  template <typename E, typename C>
  void enumerator(const E& wire, C& core, C last, std::string_view name) {
    const auto number = static_cast<std::uint32_t>(wire);
    if (number > static_cast<std::uint32_t>(last)) {
      return fail(name, fmt::format("enumerator {} out of range", number));
    }
    core = static_cast<C>(number);
  }

  template <typename S, typename T>
  void array(const S& wire, std::vector<T>& core, const ArrayField& field) {
    static_assert(sizeof(*wire._buffer) == sizeof(T));
    if (!plausible(wire, field.bound, field.name)) return;
    const T* data = reinterpret_cast<const T*>(wire._buffer);
    core.assign(data, data + wire._length);
  }

  template <typename S, typename T, std::size_t N>
  void fixed(const S& wire, std::array<T, N>& core, std::string_view name) {
    if (wire._length != N || wire._buffer == nullptr) {
      return fail(name, fmt::format("length {} is not {}", wire._length, N));
    }
    std::copy_n(wire._buffer, N, core.begin());
  }

  void text(char* const& wire, std::string& core, std::string_view name) {
    if (wire == nullptr) return fail(name, "no string");
    core = wire;
  }

  template <typename S>
  void texts(const S& wire, std::vector<std::string>& core, std::size_t bound,
             std::string_view name) {
    if (!plausible(wire, bound, name)) return;
    core.resize(wire._length);
    for (std::uint32_t i = 0; i < wire._length; ++i) text(wire._buffer[i], core[i], name);
  }

 private:
  template <typename S>
  bool plausible(const S& wire, std::size_t bound, std::string_view name) {
    if (wire._length > bound) {
      fail(name, fmt::format("length {} exceeds {}", wire._length, bound));
      return false;
    }
    if (wire._length > 0 && wire._buffer == nullptr) {
      fail(name, "no buffer");
      return false;
    }
    return !failure();
  }
};

// Relations between the fields of a record that came from outside, beside bounds and enumerators.

template <typename Record>
void check_relations(const Record& /*record*/, FirstFailure& /*result*/) {}

void check_relations(const PolicyWeights& weights, FirstFailure& result) {
  if (weights.obs_inv_std.size() != weights.obs_mean.size())
    result.fail("obs_inv_std", "length is not that of obs_mean");
}

void check_relations(const RolloutTask& task, FirstFailure& result) {
  if (task.steps > omentum_v1_MAX_STEPS) result.fail("steps", "out of range");
  if (!task.reset && task.start_state.empty()) result.fail("start_state", "empty without reset");
  if (!(task.live_frames_hz >= 0 && task.live_frames_hz <= kMaxFramesHz))
    result.fail("live_frames_hz", "out of range");
}

void check_relations(const LearnerStatus& status, FirstFailure& result) {
  const std::size_t workers = status.worker_ids.size();
  if (status.worker_phases.size() != workers || status.worker_steps_per_s.size() != workers)
    result.fail("worker_ids", "length is not that of worker_phases and worker_steps_per_s");
  if (status.barred_reasons.size() != status.barred_worker_ids.size())
    result.fail("barred_reasons", "length is not that of barred_worker_ids");
}

void check_relations(const RobotStatus& status, FirstFailure& result) {
  if (status.refusal_names.size() != status.refusals.size())
    result.fail("refusal_names", "length is not that of refusals");
}

void check_relations(const ControlCommand& command, FirstFailure& result) {
  if (!(command.frames_hz >= 0 && command.frames_hz <= kMaxFramesHz))
    result.fail("frames_hz", "out of range");
}

void check_relations(const SimFrame& frame, FirstFailure& result) {
  if (frame.particle_positions_in_world_m.size() % 3 != 0)
    result.fail("particle_positions_in_world_m", "length is no multiple of 3");
}

void check_relations(const SimulationGrant& grant, FirstFailure& result) {
  if (grant.payload.empty()) result.fail("payload", "is empty");
  if (grant.steps < 1) result.fail("steps", "out of range");
}

void check_relations(const SimulationPart& part, FirstFailure& result) {
  if (!part.declined.empty()) {
    if (part.parts != 0 || !part.payload.empty()) result.fail("declined", "with a result");
    return;
  }
  if (part.parts < 1 || part.parts > kMaxParts || part.part >= part.parts)
    return result.fail("part", "out of range");
  if (part.parts != count_parts(part.result_bytes))
    return result.fail("parts", "do not fit result_bytes");
  if (part.payload.size() != size_of_part(part.result_bytes, part.part))
    result.fail("payload", "length is not that of its part");
}

}  // namespace

template <typename Record>
BusWriter<Record>::BusWriter(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name,
                             std::int32_t keep_last)
    : topic_(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::kDescriptor),
      writer_(participant, topic_,
              {.partitions = std::move(partitions),
               .entity_name = name,
               .max_samples = 0,
               .keep_last = keep_last,
               .best_effort = false}) {}

template <typename Record>
Result<void> BusWriter<Record>::write(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  if (borrow.failure()) {
    return Failure{
        fmt::format("write {}: {}", topic_spec(Wire<Record>::kTopic).name, *borrow.failure())};
  }
  return writer_.write(&generated);
}

template <typename Record>
Result<void> BusWriter<Record>::dispose(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  return writer_.dispose(&generated);
}

template <typename Record>
Result<void> BusWriter<Record>::unregister(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  return writer_.unregister(&generated);
}

template <typename Record>
BusReader<Record>::BusReader(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name,
                             std::int32_t max_samples, bool best_effort)
    : topic_(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::kDescriptor),
      reader_(participant, topic_,
              {.partitions = std::move(partitions),
               .entity_name = name,
               .max_samples = max_samples,
               .keep_last = 0,
               .best_effort = best_effort}) {}

template <typename Record>
std::optional<std::string> read_sample(const void* sample, Record& record) {
  const auto& generated = *static_cast<const typename Wire<Record>::Generated*>(sample);
  Copy copy;
  fields(generated, record, copy);
  if (!copy.failure()) check_relations(record, copy);
  return copy.failure();
}

template <typename Record>
Result<int> BusReader<Record>::take(int limit, const std::function<void(Arrival<Record>&&)>& fn) {
  return reader_.take(limit, [&](const void* sample, const dds::SampleInfo& info) {
    Arrival<Record> arrival{{}, info};
    if (!info.valid) {
      const auto& generated = *static_cast<const typename Wire<Record>::Generated*>(sample);
      Wire<Record>::key(arrival.record) = Wire<Record>::key(generated);
      return fn(std::move(arrival));
    }
    std::optional<std::string> refusal = read_sample(sample, arrival.record);
    if (!refusal) return fn(std::move(arrival));
    ++refused_;
    last_refusal_ = *std::move(refusal);
  });
}

namespace {
constexpr std::size_t kFixedBytes = 256;  // headers and scalars of a bulk record, rounded up

template <typename... Vectors>
std::size_t payload_bytes(const Vectors&... vectors) {
  return kFixedBytes + ((vectors.size() * sizeof(typename Vectors::value_type)) + ... + 0);
}
}  // namespace

std::size_t wire_bytes(const RolloutSegment& segment) {
  std::size_t bytes = kFixedBytes;
  for_each_array(segment, [&bytes](const auto& array, const ArrayField& /*about*/) {
    bytes += std::as_bytes(std::span(array)).size();
  });
  return bytes;
}

std::size_t wire_bytes(const RolloutTask& task) { return payload_bytes(task.start_state); }

std::size_t wire_bytes(const PolicyWeights& weights) {
  return payload_bytes(weights.parameters, weights.obs_mean, weights.obs_inv_std);
}

template class BusWriter<PolicyWeights>;
template class BusReader<PolicyWeights>;
template std::optional<std::string> read_sample(const void*, PolicyWeights&);
template class BusWriter<RolloutTask>;
template class BusReader<RolloutTask>;
template std::optional<std::string> read_sample(const void*, RolloutTask&);
template class BusWriter<RolloutSegment>;
template class BusReader<RolloutSegment>;
template std::optional<std::string> read_sample(const void*, RolloutSegment&);
template class BusWriter<WorkerStatus>;
template class BusReader<WorkerStatus>;
template std::optional<std::string> read_sample(const void*, WorkerStatus&);
template class BusWriter<LearnerStatus>;
template class BusReader<LearnerStatus>;
template std::optional<std::string> read_sample(const void*, LearnerStatus&);
template class BusWriter<EpisodeSummary>;
template class BusReader<EpisodeSummary>;
template std::optional<std::string> read_sample(const void*, EpisodeSummary&);
template class BusWriter<RunManifest>;
template class BusReader<RunManifest>;
template std::optional<std::string> read_sample(const void*, RunManifest&);
template class BusWriter<ControlCommand>;
template class BusReader<ControlCommand>;
template std::optional<std::string> read_sample(const void*, ControlCommand&);
template class BusWriter<ControlReply>;
template class BusReader<ControlReply>;
template std::optional<std::string> read_sample(const void*, ControlReply&);
template class BusWriter<SimFrame>;
template class BusReader<SimFrame>;
template std::optional<std::string> read_sample(const void*, SimFrame&);
template class BusWriter<RobotStatus>;
template class BusReader<RobotStatus>;
template std::optional<std::string> read_sample(const void*, RobotStatus&);
template class BusWriter<SimulationGrant>;
template class BusReader<SimulationGrant>;
template std::optional<std::string> read_sample(const void*, SimulationGrant&);
template class BusWriter<SimulationPart>;
template class BusReader<SimulationPart>;
template std::optional<std::string> read_sample(const void*, SimulationPart&);

}  // namespace omentum

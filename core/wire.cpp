#include "core/wire.h"

#include <algorithm>
#include <array>
#include <span>
#include <string_view>
#include <type_traits>
#include <utility>

#include "core/wire_fields.h"

namespace omentum {

static_assert(kMaxStateBytes == omentum_v1_MAX_STATE_BYTES &&
              segment_limit::kSteps == omentum_v1_MAX_STEPS &&
              segment_limit::kStepValues == omentum_v1_MAX_STEP_VALUES &&
              segment_limit::kObservation == omentum_v1_MAX_OBSERVATION &&
              segment_limit::kObservations == omentum_v1_MAX_OBSERVATIONS &&
              segment_limit::kEpisodes == omentum_v1_MAX_EPISODES);

namespace {

// -------------------------------------------------------------------------------------------- out

// Points generated sequences at memory of the core record. Nothing is owned: _release stays false,
// and the generated struct must not outlive the record.
class Borrow {
 public:
  template <typename T>
  void value(T& wire, const T& core, std::string_view /*name*/) {
    wire = core;
  }

  template <typename T>
  void delivery(T& wire, const T& core, std::string_view /*name*/) {
    wire = core;
  }

  template <typename E, typename C>
  void enumerator(E& wire, const C& core, C last, std::string_view name) {
    if (core > last) fail(name, "enumerator out of range");
    wire = static_cast<E>(core);
  }

  template <typename S, typename T>
  void sequence(S& wire, const std::vector<T>& core, std::size_t bound, std::string_view name) {
    borrow(wire, core.data(), core.size(), bound, name);
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

  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
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

  void fail(std::string_view name, std::string_view reason) {
    if (failure_.empty()) failure_ = fmt::format("{}: {}", name, reason);
  }

  std::array<std::vector<char*>, 2> lists_;  // pointers of sequences of strings
  std::size_t next_list_ = 0;
  std::string failure_;
};

// --------------------------------------------------------------------------------------------- in

// Copies a received sample; stops at the first field that does not pass.
class Copy {
 public:
  template <typename T>
  void value(const T& wire, T& core, std::string_view /*name*/) {
    core = wire;
  }

  template <typename T>
  void delivery(const T& wire, T& core, std::string_view /*name*/) {
    core = wire;
  }

  template <typename E, typename C>
  void enumerator(const E& wire, C& core, C last, std::string_view name) {
    const auto number = static_cast<std::uint32_t>(wire);
    if (number > static_cast<std::uint32_t>(last)) {
      return fail(name, fmt::format("enumerator {} out of range", number));
    }
    core = static_cast<C>(number);
  }

  template <typename S, typename T>
  void sequence(const S& wire, std::vector<T>& core, std::size_t bound, std::string_view name) {
    static_assert(sizeof(*wire._buffer) == sizeof(T));
    if (!plausible(wire, bound, name)) return;
    const T* data = reinterpret_cast<const T*>(wire._buffer);
    core.assign(data, data + wire._length);
  }

  template <typename S, typename T>
  void array(const S& wire, std::vector<T>& core, const ArrayField& field) {
    sequence(wire, core, field.bound, field.name);
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

  Result<void> result() const {
    return failure_.empty() ? Result<void>() : Result<void>(Failure{failure_});
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
    return failure_.empty();
  }

  void fail(std::string_view name, std::string_view reason) {
    if (failure_.empty()) failure_ = fmt::format("{}: {}", name, reason);
  }

  std::string failure_;
};

}  // namespace

template <typename Record>
TopicId topic_of() {
  return Wire<Record>::kTopic;
}

// ---------------------------------------------------------------------------------------- writers

template <typename Record>
struct BusWriter<Record>::Endpoint {
  Endpoint(const dds::Participant& participant, std::vector<std::string> partitions,
           const std::string& name)
      : topic(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::descriptor()),
        writer(participant, topic, {.partitions = std::move(partitions), .entity_name = name}) {}
  dds::Topic topic;
  dds::Writer writer;
};

template <typename Record>
BusWriter<Record>::BusWriter(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name)
    : endpoint_(std::make_unique<Endpoint>(participant, std::move(partitions), name)) {}
template <typename Record>
BusWriter<Record>::~BusWriter() = default;
template <typename Record>
BusWriter<Record>::BusWriter(BusWriter&&) noexcept = default;
template <typename Record>
BusWriter<Record>& BusWriter<Record>::operator=(BusWriter&&) noexcept = default;

template <typename Record>
Result<void> BusWriter<Record>::write(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  if (const Result<void> ok = borrow.result(); !ok) {
    return Failure{fmt::format("write {}: {}", topic_spec(Wire<Record>::kTopic).name, ok.error())};
  }
  return endpoint_->writer.write(&generated);
}

template <typename Record>
Result<void> BusWriter<Record>::dispose(const Record& record) {
  typename Wire<Record>::Generated generated{};
  Borrow borrow;
  fields(generated, record, borrow);
  return endpoint_->writer.dispose(&generated);
}

template <typename Record>
bool BusWriter<Record>::timed_out() const {
  return endpoint_->writer.timed_out();
}
template <typename Record>
int BusWriter<Record>::matched() const {
  return endpoint_->writer.matched();
}
template <typename Record>
dds::WriterCounters BusWriter<Record>::counters() const {
  return endpoint_->writer.counters();
}
template <typename Record>
bool BusWriter<Record>::wait_for_acknowledgments(std::int64_t timeout_ns) const {
  return endpoint_->writer.wait_for_acknowledgments(timeout_ns);
}
template <typename Record>
std::int32_t BusWriter<Record>::handle() const {
  return endpoint_->writer.handle();
}

// ---------------------------------------------------------------------------------------- readers

template <typename Record>
struct BusReader<Record>::Endpoint {
  Endpoint(const dds::Participant& participant, std::vector<std::string> partitions,
           const std::string& name, const Options& options)
      : topic(participant, topic_spec(Wire<Record>::kTopic), Wire<Record>::descriptor()),
        reader(participant, topic,
               {.partitions = std::move(partitions),
                .entity_name = name,
                .max_samples = options.max_samples,
                .best_effort = options.best_effort}) {}
  dds::Topic topic;
  dds::Reader reader;
  std::uint64_t refused = 0;
  std::string last_refusal;
};

template <typename Record>
BusReader<Record>::BusReader(const dds::Participant& participant,
                             std::vector<std::string> partitions, const std::string& name,
                             Options options)
    : endpoint_(std::make_unique<Endpoint>(participant, std::move(partitions), name, options)) {}
template <typename Record>
BusReader<Record>::~BusReader() = default;
template <typename Record>
BusReader<Record>::BusReader(BusReader&&) noexcept = default;
template <typename Record>
BusReader<Record>& BusReader<Record>::operator=(BusReader&&) noexcept = default;

template <typename Record>
Result<int> BusReader<Record>::take(int limit, const std::function<void(Arrival<Record>&&)>& fn) {
  Endpoint& endpoint = *endpoint_;
  return endpoint.reader.take(limit, [&](const void* sample, const dds::SampleInfo& info) {
    const auto& generated = *static_cast<const typename Wire<Record>::Generated*>(sample);
    Arrival<Record> arrival{{}, info};
    if (!info.valid) {
      read_key(generated, arrival.record);
      return fn(std::move(arrival));
    }
    Copy copy;
    fields(generated, arrival.record, copy);
    Result<void> ok = copy.result();
    if (ok) ok = check_record(arrival.record);
    if (!ok) {
      ++endpoint.refused;
      endpoint.last_refusal = ok.error();
      return;
    }
    fn(std::move(arrival));
  });
}

template <typename Record>
std::uint64_t BusReader<Record>::refused() const {
  return endpoint_->refused;
}
template <typename Record>
const std::string& BusReader<Record>::last_refusal() const {
  return endpoint_->last_refusal;
}
template <typename Record>
std::uint64_t BusReader<Record>::lost() const {
  return endpoint_->reader.lost();
}
template <typename Record>
std::uint64_t BusReader<Record>::rejected() const {
  return endpoint_->reader.rejected();
}
template <typename Record>
int BusReader<Record>::matched() const {
  return endpoint_->reader.matched();
}
template <typename Record>
const dds::Reader& BusReader<Record>::raw() const {
  return endpoint_->reader;
}

// ------------------------------------------------------------------------------------------ sizes

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

template TopicId topic_of<PolicyWeights>();
template TopicId topic_of<RolloutTask>();
template TopicId topic_of<RolloutSegment>();
template TopicId topic_of<WorkerStatus>();
template TopicId topic_of<LearnerStatus>();
template TopicId topic_of<EpisodeSummary>();
template TopicId topic_of<RunManifest>();
template class BusWriter<PolicyWeights>;
template class BusReader<PolicyWeights>;
template class BusWriter<RolloutTask>;
template class BusReader<RolloutTask>;
template class BusWriter<RolloutSegment>;
template class BusReader<RolloutSegment>;
template class BusWriter<WorkerStatus>;
template class BusReader<WorkerStatus>;
template class BusWriter<LearnerStatus>;
template class BusReader<LearnerStatus>;
template class BusWriter<EpisodeSummary>;
template class BusReader<EpisodeSummary>;
template class BusWriter<RunManifest>;
template class BusReader<RunManifest>;

}  // namespace omentum

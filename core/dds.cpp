#include "core/dds.h"

#include <dds/dds.h>
#include <dds/ddsc/dds_statistics.h>
#include <dds/ddsrt/log.h>
#include <fmt/ranges.h>

#include <array>
#include <cstring>
#include <filesystem>
#include <map>
#include <mutex>
#include <utility>

#include "core/certificate.h"
#include "core/check.h"
#include "core/clock.h"
#include "core/dds_discovery.h"
#include "core/log.h"
#include "core/loopback_sockets.h"
#include "core/scheduling.h"

namespace omentum::dds {
namespace {

constexpr std::uint32_t kMaxDomain = 230;  // 7400 + 250 x domain must stay a port number

// Cyclone reports the reason of a failed creation only through its log: keep the last error for our
// message, and pass the rest on to our log.
struct LastError {
  std::mutex mutex;
  std::string text;  // guarded by mutex
};

LastError& last_error() {
  static LastError error;
  return error;
}

void receive_log(void* /*unused*/, const dds_log_data_t* data) {
  std::string text(data->message, data->size);
  while (!text.empty() && text.back() == '\n') text.pop_back();
  if ((data->priority & (DDS_LC_FATAL | DDS_LC_ERROR)) != 0) {
    const std::lock_guard lock(last_error().mutex);
    last_error().text = text;
  } else {
    log().warn("event=dds_message text=\"{}\"", text);
  }
}

std::string take_last_error() {
  const std::lock_guard lock(last_error().mutex);
  return std::exchange(last_error().text, {});
}

[[noreturn]] void throw_join_error(std::uint32_t domain, dds_return_t code) {
  const std::string reason = take_last_error();
  const std::uint32_t port = 7410 + 250 * domain;
  std::string advice;
  if (reason.find("free participant index") != std::string::npos)
    advice = fmt::format("every port {} + 2 x index is taken", port);
  if (reason.find("participant index 0 ") != std::string::npos)  // the learner of a hub
    advice = fmt::format("port {} is taken: ss -ulpn shows by whom", port);
  if (!advice.empty())
    advice =
        fmt::format(": {}; another domain: learner --set run.domain=N, others --domain N", advice);
  throw_error("DDS domain {}: {} ({}){}", domain, dds_strretcode(code),
              reason.empty() ? "check CYCLONEDDS_URI" : reason, advice);
}

// Domains of this process. A domain entity carries the configuration and is deleted with its last
// participant.
struct DomainRow {
  Entity entity;
  int users = 0;
};
struct DomainTable {
  std::mutex mutex;
  std::map<std::uint32_t, DomainRow> rows;  // guarded by mutex
};
DomainTable& domain_table() {
  static DomainTable table;
  return table;
}

std::shared_ptr<void> lease_domain(std::uint32_t domain, const std::string& uri) {
  DomainTable& table = domain_table();
  const std::lock_guard lock(table.mutex);
  DomainRow& row = table.rows[domain];
  if (row.users == 0) {
    const dds_entity_t handle = dds_create_domain(domain, uri.c_str());
    if (handle < 0) {
      table.rows.erase(domain);
      throw_join_error(domain, handle);
    }
    row.entity = Entity(handle, "create domain");
  }
  ++row.users;
  return {nullptr, [domain](void*) {
            DomainTable& rows = domain_table();
            const std::lock_guard release_lock(rows.mutex);
            const auto at = rows.rows.find(domain);
            if (--at->second.users == 0) rows.rows.erase(at);
          }};
}

struct DeleteQos {
  void operator()(dds_qos_t* qos) const { dds_delete_qos(qos); }
};
using Qos = std::unique_ptr<dds_qos_t, DeleteQos>;

Qos make_qos() {
  Qos qos(dds_create_qos());
  OMENTUM_CHECK(qos != nullptr);
  return qos;
}

Qos topic_qos(const TopicSpec& spec) {
  Qos qos = make_qos();
  dds_qos_t* q = qos.get();
  dds_qset_reliability(q, spec.reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT,
                       spec.max_blocking_ns);
  const bool all = spec.history == History::kKeepAll;
  dds_qset_history(q, all ? DDS_HISTORY_KEEP_ALL : DDS_HISTORY_KEEP_LAST, all ? 0 : spec.depth);
  const bool late = spec.durability == Durability::kTransientLocal;
  dds_qset_durability(q, late ? DDS_DURABILITY_TRANSIENT_LOCAL : DDS_DURABILITY_VOLATILE);
  if (late) {
    dds_qset_durability_service(q, 0, DDS_HISTORY_KEEP_LAST, spec.service_depth,
                                DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED, DDS_LENGTH_UNLIMITED);
  }
  dds_qset_ownership(q, DDS_OWNERSHIP_SHARED);
  dds_qset_liveliness(q, DDS_LIVELINESS_AUTOMATIC, DDS_INFINITY);
  return qos;
}

Qos writer_qos(const TopicSpec& spec, const EndpointUse& use) {
  Qos qos = topic_qos(spec);
  if (spec.deadline_ns > 0) dds_qset_deadline(qos.get(), spec.deadline_ns);
  if (use.keep_last > 0) dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, use.keep_last);
  // A crash must look different from leaving: only an explicit dispose() disposes.
  dds_qset_writer_data_lifecycle(qos.get(), false);
  dds_qset_entity_name(qos.get(), use.entity_name.c_str());
  return qos;
}

Qos reader_qos(const TopicSpec& spec, const EndpointUse& use) {
  Qos qos = topic_qos(spec);
  if (use.max_samples > 0 && spec.history == History::kKeepLast) {
    dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, use.max_samples);
  } else if (use.max_samples > 0) {
    // Never max_instances: exceeding it blocks the receive thread for ever.
    dds_qset_resource_limits(qos.get(), use.max_samples, DDS_LENGTH_UNLIMITED, use.max_samples);
  }
  if (use.best_effort) dds_qset_reliability(qos.get(), DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_entity_name(qos.get(), use.entity_name.c_str());
  return qos;
}

// Partitions are a policy of publisher and subscriber, so each endpoint has its own.
Entity make_group(const Participant& participant, const EndpointUse& use, bool publisher) {
  if (participant.expired())
    throw_error("the certificate of {} has ended: {} cannot be made",
                participant.certificate_name(), use.entity_name);
  const Qos qos = make_qos();
  std::vector<const char*> names;
  for (const std::string& partition : use.partitions) names.push_back(partition.c_str());
  dds_qset_partition(qos.get(), static_cast<std::uint32_t>(names.size()), names.data());
  const auto create = publisher ? &dds_create_publisher : &dds_create_subscriber;
  return Entity(
      create(participant.handle(), qos.get(), nullptr),
      fmt::format("create {} of {}", publisher ? "publisher" : "subscriber", use.entity_name));
}

/// Handle of a new writer or reader; where permissions forbid it the line says whom and what.
Entity permitted(const Participant& participant, dds_entity_t handle, bool writer,
                 const std::string& topic, const EndpointUse& use) {
  if (handle == DDS_RETCODE_NOT_ALLOWED_BY_SECURITY) {
    throw_error(
        "the certificate of {} may not {} {} in partition \"{}\": Not Allowed By Security; "
        "give --security-dir the folder of this program's role and run",
        participant.certificate_name(), writer ? "write" : "read", topic,
        fmt::join(use.partitions, "\", \""));
  }
  return Entity(handle, fmt::format("create {} of {} as {}", writer ? "writer" : "reader", topic,
                                    use.entity_name));
}

/// Path of the certificate that a configuration names; Cyclone has no function for it. Empty
/// without security.
std::string certificate_path(const std::string& uri) {
  constexpr std::string_view kTag = "<IdentityCertificate>file:";
  const std::size_t at = uri.find(kTag);
  if (at == std::string::npos) return "";
  const std::size_t begin = at + kTag.size();
  std::string path = uri.substr(begin, uri.find('<', begin) - begin);
  // As dds_config_xml() writes it.
  constexpr std::pair<std::string_view, char> kEntities[] = {
      {"&lt;", '<'}, {"&gt;", '>'}, {"&quot;", '"'}, {"&amp;", '&'}};
  for (const auto& [entity, character] : kEntities) {
    for (std::size_t found = 0; (found = path.find(entity, found)) != std::string::npos; ++found)
      path.replace(found, entity.size(), 1, character);
  }
  return path;
}

Failure failure_of(const std::string& operation, const std::string& topic, dds_return_t code) {
  return Failure{fmt::format("{} {}: {}", operation, topic, dds_strretcode(code))};
}

}  // namespace

Entity::Entity(std::int32_t handle, const std::string& operation) : handle_(handle) {
  if (handle >= 0) return;
  handle_ = 0;
  throw_error("{}: {} {}", operation, dds_strretcode(handle), take_last_error());
}

Entity& Entity::operator=(Entity&& other) noexcept {
  if (this != &other) {
    close();
    handle_ = std::exchange(other.handle_, 0);
  }
  return *this;
}

void Entity::close() noexcept {
  if (handle_ > 0) dds_delete(handle_);  // already gone with its parent: nothing to do
  handle_ = 0;
}

Participant::Participant(std::uint32_t domain, const std::string& uri, const std::string& name) {
  if (domain > kMaxDomain) {
    throw_error("DDS domain {} is not in [0, {}]: port 7400 + 250 x domain would not exist", domain,
                kMaxDomain);
  }
  static std::once_flag once;
  std::call_once(once, [] { dds_set_log_sink(&receive_log, nullptr); });
  const bool loopback = uri.find("<NetworkInterface name=\"lo\"") != std::string::npos;
  const std::set<int> others = loopback ? open_udp_sockets() : std::set<int>{};
  if (const std::string path = certificate_path(uri); !path.empty()) {
    certificate_name_ = omentum::certificate_name(path);
    // Before Cyclone reads the files: where they are exchanged in between, this is the earlier end.
    const Result<std::int64_t> end = certificate_end(std::filesystem::path(path).parent_path());
    if (end) certificate_end_s_ = end.value();
  }
  const ShortSlices of_the_middleware;  // its threads are made here
  domain_lease_ = lease_domain(domain, uri);
  const Qos qos = make_qos();
  dds_qset_entity_name(qos.get(), name.c_str());
  const dds_entity_t handle = dds_create_participant(domain, qos.get(), nullptr);
  if (handle < 0) throw_join_error(domain, handle);
  entity_ = Entity(handle, "create participant");
  if (!loopback) return;
  for (const int socket : open_udp_sockets()) {
    if (others.contains(socket)) continue;
    if (const Result<void> bound = bind_to_loopback(socket); !bound)
      log().warn("event=not_loopback_only reason=\"{}\"", bound.error());
  }
}

bool Participant::expired() const {
  constexpr std::int64_t kNsPerS = 1'000'000'000;
  return certificate_end_s_ > 0 && wall_now_ns() / kNsPerS >= certificate_end_s_ - 1;
}

bool Participant::sees(const std::string& name) const {
  if (expired()) return false;
  const Entity reader(
      dds_create_reader(handle(), DDS_BUILTIN_TOPIC_DCPSPARTICIPANT, nullptr, nullptr),
      "create reader of participants");
  dds_guid_t own{};
  dds_get_guid(handle(), &own);
  constexpr std::uint32_t kMost = 512;  // of a flood
  std::vector<void*> samples(kMost, nullptr);
  std::vector<dds_sample_info_t> infos(kMost);
  const dds_return_t count = dds_take(reader.handle(), samples.data(), infos.data(), kMost, kMost);
  bool found = false;
  for (dds_return_t i = 0; i < count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto& other = *static_cast<const dds_builtintopic_participant_t*>(samples[k]);
    if (!infos[k].valid_data || infos[k].instance_state != DDS_IST_ALIVE) continue;
    if (std::memcmp(own.v, other.key.v, sizeof own.v) == 0) continue;
    char* told = nullptr;
    const bool named = dds_qget_entity_name(other.qos, &told) && told != nullptr;
    found = found || !named || name == told;
    dds_free(told);
  }
  if (count > 0) dds_return_loan(reader.handle(), samples.data(), count);
  return found;
}

std::size_t other_writers(const Participant& participant, const std::string& topic) {
  if (participant.expired()) return 0;
  const Entity reader(
      dds_create_reader(participant.handle(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr),
      "create reader of writers");
  dds_guid_t own{};
  dds_get_guid(participant.handle(), &own);
  std::size_t others = 0;
  std::array<void*, 1> sample{};
  dds_sample_info_t info{};
  while (dds_take(reader.handle(), sample.data(), &info, 1, 1) == 1) {
    const auto& writer = *static_cast<const dds_builtintopic_endpoint_t*>(sample[0]);
    others += info.valid_data && info.instance_state == DDS_IST_ALIVE &&
                      std::memcmp(own.v, writer.participant_key.v, sizeof own.v) != 0 &&
                      topic == writer.topic_name
                  ? 1
                  : 0;
    dds_return_loan(reader.handle(), sample.data(), 1);
  }
  return others;
}

Discovery::Discovery(const Participant& participant) {
  constexpr std::array<dds_entity_t, 3> kTopics = {DDS_BUILTIN_TOPIC_DCPSPARTICIPANT,
                                                   DDS_BUILTIN_TOPIC_DCPSPUBLICATION,
                                                   DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION};
  for (std::size_t i = 0; i < kTopics.size(); ++i) {
    readers_[i] = Entity(dds_create_reader(participant.handle(), kTopics[i], nullptr, nullptr),
                         "create reader of discovery");
  }
}

Discovery::Count Discovery::count() {
  constexpr std::uint32_t kBatch = 64;
  constexpr int kBatches = 64;  // of a flood the rest comes next time
  for (const Entity& reader : readers_) {
    for (int batch = 0; batch < kBatches; ++batch) {
      std::array<void*, kBatch> samples{};
      std::array<dds_sample_info_t, kBatch> infos{};
      const dds_return_t count =
          dds_take(reader.handle(), samples.data(), infos.data(), kBatch, kBatch);
      if (count <= 0) break;
      for (dds_return_t i = 0; i < count; ++i) {
        const dds_sample_info_t& info = infos[static_cast<std::size_t>(i)];
        const bool alive = info.instance_state == DDS_IST_ALIVE;
        const bool is_new = info.view_state == DDS_VST_NEW;
        if (alive && is_new) {
          ++count_.found;
          ++count_.known;
        }
        if (!alive && !is_new) --count_.known;
      }
      dds_return_loan(reader.handle(), samples.data(), count);
    }
  }
  return count_;
}

Topic::Topic(const Participant& participant, const TopicSpec& spec,
             const dds_topic_descriptor& descriptor)
    : spec_(&spec) {
  entity_ = Entity(dds_create_topic(participant.handle(), &descriptor, spec.name,
                                    topic_qos(spec).get(), nullptr),
                   fmt::format("create topic {}", spec.name));
}

Writer::Writer(const Participant& participant, const Topic& topic, const EndpointUse& use)
    : publisher_(make_group(participant, use, true)), name_(topic.spec().name) {
  const Qos qos = writer_qos(topic.spec(), use);
  entity_ = permitted(participant,
                      dds_create_writer(publisher_.handle(), topic.handle(), qos.get(), nullptr),
                      true, name_, use);
}

Result<void> Writer::write(const void* sample) {
  const dds_return_t code = dds_write(entity_.handle(), sample);
  timed_out_ = code == DDS_RETCODE_TIMEOUT;
  if (code < 0) return failure_of("write", name_, code);
  return {};
}

Result<void> Writer::dispose(const void* sample) {
  const dds_return_t code = dds_dispose(entity_.handle(), sample);
  if (code < 0) return failure_of("dispose", name_, code);
  return {};
}

Result<void> Writer::unregister(const void* sample) {
  const dds_return_t code = dds_unregister_instance(entity_.handle(), sample);
  if (code < 0) return failure_of("unregister", name_, code);
  return {};
}

int Writer::matched() const {
  dds_publication_matched_status_t status{};
  if (dds_get_publication_matched_status(entity_.handle(), &status) < 0) return 0;
  return static_cast<int>(status.current_count);
}

WriterCounters Writer::counters() const {
  WriterCounters counters;
  const std::unique_ptr<dds_statistics, decltype(&dds_delete_statistics)> table(
      dds_create_statistics(entity_.handle()), &dds_delete_statistics);
  const auto value = [&table](const char* name) -> std::uint64_t {
    const dds_stat_keyvalue* entry = dds_lookup_statistic(table.get(), name);
    if (entry == nullptr) return 0;
    return entry->kind == DDS_STAT_KIND_UINT32 ? entry->u.u32 : entry->u.u64;
  };
  counters.rexmit_bytes = value("rexmit_bytes");
  counters.throttle_count = value("throttle_count");
  counters.time_throttle_ns = value("time_throttle");
  return counters;
}

bool Writer::wait_for_acknowledgments(std::int64_t timeout_ns) const {
  return dds_wait_for_acks(entity_.handle(), timeout_ns) == DDS_RETCODE_OK;
}

Reader::Reader(const Participant& participant, const Topic& topic, const EndpointUse& use)
    : subscriber_(make_group(participant, use, false)),
      name_(topic.spec().name),
      limited_(use.max_samples > 0 && topic.spec().history == History::kKeepAll) {
  const Qos qos = reader_qos(topic.spec(), use);
  if (limited_) {
    dds_topic_filter open_until_closing{};
    open_until_closing.mode = DDS_TOPIC_FILTER_SAMPLEINFO_ARG;
    open_until_closing.f.sampleinfo_arg = [](const dds_sample_info_t*, void* closing) {
      return !static_cast<std::atomic<bool>*>(closing)->load();
    };
    open_until_closing.arg = &closing_;
    const dds_return_t code = dds_set_topic_filter_extended(topic.handle(), &open_until_closing);
    if (code < 0) throw_error("filter {}: {}", name_, dds_strretcode(code));
  }
  entity_ = permitted(participant,
                      dds_create_reader(subscriber_.handle(), topic.handle(), qos.get(), nullptr),
                      false, name_, use);
  // Level-triggered, unlike the data-available status, which a partial take resets.
  condition_ = Entity(dds_create_readcondition(entity_.handle(), DDS_ANY_STATE),
                      fmt::format("create read condition of {}", name_));
}

Reader::~Reader() {
  if (!limited_) return;
  closing_ = true;
  // What waits for room in a full cache is dropped as soon as there is some.
  while (true) {
    const Result<int> taken = take(64, [](const void*, const SampleInfo&) {});
    if (!taken || taken.value() == 0) break;
  }
}

std::uint64_t Reader::participant_of(std::uint64_t writer) {
  // Asked again while unknown: a writer is for a moment where its lease ran out on a busy machine.
  const auto found = participants_.try_emplace(writer, 0).first;
  if (found->second == 0) {
    dds_builtintopic_endpoint_t* endpoint =
        dds_get_matched_publication_data(entity_.handle(), writer);
    if (endpoint != nullptr) {
      found->second = endpoint->participant_instance_handle;
      dds_builtintopic_free_endpoint(endpoint);
    }
  }
  return found->second;
}

Result<int> Reader::take(int limit, const std::function<void(const void*, const SampleInfo&)>& fn) {
  constexpr int kBatch = 64;
  int total = 0;
  while (total < limit) {
    std::array<void*, kBatch> samples{};  // null: Cyclone lends its own memory
    std::array<dds_sample_info_t, kBatch> infos{};
    const int wanted = std::min(kBatch, limit - total);
    const dds_return_t count =
        dds_take(entity_.handle(), samples.data(), infos.data(), static_cast<std::size_t>(wanted),
                 static_cast<std::uint32_t>(wanted));
    if (count < 0) return failure_of("take", name_, count);
    if (count == 0) break;
    struct Loan {
      std::int32_t reader;
      void** samples;
      int count;
      ~Loan() { dds_return_loan(reader, samples, count); }
    } const loan{entity_.handle(), samples.data(), count};
    for (int i = 0; i < count; ++i) {
      const dds_sample_info_t& from = infos[static_cast<std::size_t>(i)];
      SampleInfo info;
      info.valid = from.valid_data;
      info.state = from.instance_state == DDS_IST_ALIVE                ? InstanceState::kAlive
                   : from.instance_state == DDS_IST_NOT_ALIVE_DISPOSED ? InstanceState::kDisposed
                                                                       : InstanceState::kNoWriters;
      info.writer = from.publication_handle;
      info.participant = participant_of(from.publication_handle);
      fn(samples[static_cast<std::size_t>(i)], info);
    }
    total += count;
    if (count < wanted) break;
  }
  return total;
}

int Reader::matched() const {
  dds_subscription_matched_status_t status{};
  if (dds_get_subscription_matched_status(entity_.handle(), &status) < 0) return 0;
  return static_cast<int>(status.current_count);
}

std::uint64_t Reader::lost() const {
  dds_sample_lost_status_t lost{};
  dds_get_sample_lost_status(entity_.handle(), &lost);
  return lost.total_count;
}

std::uint64_t Reader::rejected() const {
  dds_sample_rejected_status_t rejected{};
  dds_get_sample_rejected_status(entity_.handle(), &rejected);
  return rejected.total_count;
}

Waitset::Waitset(const Participant& participant)
    : guard_(dds_create_guardcondition(participant.handle()), "create guard condition"),
      waitset_(dds_create_waitset(participant.handle()), "create wait set") {
  const dds_return_t code = dds_waitset_attach(waitset_.handle(), guard_.handle(), 0);
  if (code < 0) throw_error("attach guard condition: {}", dds_strretcode(code));
}

void Waitset::attach(const Reader& reader) {
  const dds_return_t code = dds_waitset_attach(waitset_.handle(), reader.condition(), 0);
  if (code < 0) throw_error("attach reader: {}", dds_strretcode(code));
}

bool Waitset::wait(std::int64_t timeout_ns) {
  const dds_return_t count = dds_waitset_wait(waitset_.handle(), nullptr, 0, timeout_ns);
  bool woken = false;
  dds_take_guardcondition(guard_.handle(), &woken);
  return count > 0;
}

void Waitset::wake() { dds_set_guardcondition(guard_.handle(), true); }

}  // namespace omentum::dds

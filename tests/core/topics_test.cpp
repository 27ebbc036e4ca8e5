#include "core/topics.h"

#include <dds/dds.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <set>
#include <sstream>
#include <string>

#include "core/check.h"
#include "core/dds.h"
#include "core/simulation_records.h"
#include "core/wire.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

// What the middleware must report for an endpoint of this row.
std::string wanted_qos(const TopicSpec& spec, bool writer, std::int32_t max_samples) {
  const std::int32_t limit = max_samples > 0 ? max_samples : -1;
  const bool late = spec.durability == Durability::kTransientLocal;
  return fmt::format(
      "reliability={} blocking_ns={} history={} depth={} durability={} service_depth={} "
      "ownership=shared deadline_ns={} autodispose={} max_samples={} max_instances=-1 "
      "max_samples_per_instance={}",
      spec.reliable ? "reliable" : "best_effort", spec.max_blocking_ns,
      spec.history == History::kKeepAll ? "keep_all" : "keep_last",
      spec.history == History::kKeepAll ? 0 : spec.depth, late ? "transient_local" : "volatile",
      late ? spec.service_depth : 0, writer ? spec.deadline_ns : 0, writer ? "false" : "true",
      limit, limit);
}

// Effective policies of an endpoint as the middleware reports them, in the words of wanted_qos().
std::string describe_qos(dds_entity_t handle) {
  dds_qos_t* q = dds_create_qos();
  EXPECT_EQ(dds_get_qos(handle, q), DDS_RETCODE_OK);
  dds_reliability_kind_t reliability{};
  dds_duration_t blocking = 0;
  dds_history_kind_t history{}, service_history{};
  std::int32_t depth = 0, service_depth = 0;
  dds_durability_kind_t durability{};
  dds_ownership_kind_t ownership{};
  dds_duration_t deadline = DDS_INFINITY, cleanup = 0;
  bool autodispose = true;
  std::int32_t max_samples = 0, max_instances = 0, max_per_instance = 0;
  dds_qget_reliability(q, &reliability, &blocking);
  dds_qget_history(q, &history, &depth);
  dds_qget_durability(q, &durability);
  dds_qget_ownership(q, &ownership);
  dds_qget_deadline(q, &deadline);
  dds_qget_writer_data_lifecycle(q, &autodispose);
  dds_qget_resource_limits(q, &max_samples, &max_instances, &max_per_instance);
  dds_qget_durability_service(q, &cleanup, &service_history, &service_depth, nullptr, nullptr,
                              nullptr);
  dds_delete_qos(q);
  return fmt::format(
      "reliability={} blocking_ns={} history={} depth={} durability={} service_depth={} "
      "ownership={} deadline_ns={} autodispose={} max_samples={} max_instances={} "
      "max_samples_per_instance={}",
      reliability == DDS_RELIABILITY_RELIABLE ? "reliable" : "best_effort", blocking,
      history == DDS_HISTORY_KEEP_ALL ? "keep_all" : "keep_last", depth,
      durability == DDS_DURABILITY_TRANSIENT_LOCAL ? "transient_local" : "volatile", service_depth,
      ownership == DDS_OWNERSHIP_SHARED ? "shared" : "exclusive",
      deadline == DDS_INFINITY ? 0 : deadline, autodispose, max_samples, max_instances,
      max_per_instance);
}

// Depths that mean nothing differ between endpoint kinds; blank them.
std::string comparable(std::string text, const TopicSpec& spec, bool writer) {
  const auto blank = [&text](const std::string& name) {
    const std::size_t at = text.find(name + "=");
    if (at == std::string::npos) return;
    const std::size_t end = text.find(' ', at);
    text.replace(at, end == std::string::npos ? end : end - at, name + "=*");
  };
  if (spec.history == History::kKeepAll) blank(" depth");
  if (!writer || spec.durability == Durability::kVolatile) blank("service_depth");
  if (!writer) blank("autodispose");
  return text;
}

template <typename Record>
void check_endpoints(TopicId id) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "test");
  const TopicSpec& spec = topic_spec(id);
  const std::int32_t fuse = spec.history == History::kKeepAll ? 256 : 0;
  const BusWriter<Record> writer(participant, public_partitions("r"), "w");
  const BusReader<Record> reader(participant, run_partition("r"), "r", fuse);
  EXPECT_EQ(comparable(describe_qos(writer.handle()), spec, true),
            comparable(wanted_qos(spec, true, 0), spec, true))
      << spec.name;
  EXPECT_EQ(comparable(describe_qos(reader.raw().handle()), spec, false),
            comparable(wanted_qos(spec, false, fuse), spec, false))
      << spec.name;
}

TEST(Topics, EffectiveQosIsTheTable) {
  check_endpoints<PolicyWeights>(TopicId::kPolicyWeights);
  check_endpoints<RolloutTask>(TopicId::kRolloutTask);
  check_endpoints<RolloutSegment>(TopicId::kRolloutSegment);
  check_endpoints<WorkerStatus>(TopicId::kWorkerStatus);
  check_endpoints<LearnerStatus>(TopicId::kLearnerStatus);
  check_endpoints<EpisodeSummary>(TopicId::kEpisodeSummary);
  check_endpoints<RunManifest>(TopicId::kRunManifest);
  check_endpoints<ControlCommand>(TopicId::kControlCommand);
  check_endpoints<ControlReply>(TopicId::kControlReply);
  check_endpoints<SimFrame>(TopicId::kSimFrame);
  check_endpoints<RobotStatus>(TopicId::kRobotState);
  check_endpoints<SimulationGrant>(TopicId::kSimulationTask);
  check_endpoints<SimulationPart>(TopicId::kSimulationResult);
}

TEST(Topics, TheTableKeepsItsRules) {
  std::set<std::string> names;
  for (const TopicSpec& spec : topics()) {
    EXPECT_TRUE(names.insert(spec.name).second) << spec.name;
    EXPECT_EQ(std::string(spec.name).find_first_not_of(
                  "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_/"),
              std::string::npos)
        << spec.name;
    EXPECT_EQ(&topic_spec(spec.id), &spec);
    // The learner and who asks for simulations write KEEP_LAST only: a frozen worker cannot freeze
    // them. What workers give back alone is KEEP_ALL.
    EXPECT_EQ(spec.history == History::kKeepAll,
              spec.id == TopicId::kRolloutSegment || spec.id == TopicId::kSimulationResult);
    EXPECT_EQ(spec.service_depth >= 1, spec.durability == Durability::kTransientLocal);
  }
}

// docs/wire.md 7: constructs that generic tools cannot decode, or that end compatible change.
TEST(Idl, KeepsTheRulesThatGenericToolsNeed) {
  std::ifstream file(std::string(OMENTUM_SOURCE_DIR) + "/idl/omentum.idl");
  std::string before;
  std::size_t structs = 0;
  std::map<std::string, unsigned long> bounds;
  for (std::string line; std::getline(file, line);) {
    const std::string code = line.substr(0, line.find("//"));
    for (const std::string bad : {"bitmask", "@nested", "@final", "@value", "@external", "wstring",
                                  "map<", "typedef", "union", "int8"}) {
      EXPECT_EQ(code.find(bad), std::string::npos) << line;
    }
    // The Python package names no type with a larger bound.
    std::istringstream constant(code.substr(0, code.find(';')));
    std::string word, name;
    unsigned long value = 0;
    if (constant >> word >> word >> word >> name >> word >> value && code.rfind("const ", 0) == 0)
      bounds[name] = value;
    if (const std::size_t comma = code.find(", MAX_"); comma != std::string::npos) {
      const std::string bound = code.substr(comma + 2, code.find('>') - comma - 2);
      EXPECT_LE(bounds.at(bound), 65535u) << line;
      EXPECT_GE(bounds.at(bound), 1u) << line;
    }
    if (code.rfind("struct ", 0) == 0) {
      ++structs;
      const bool status = code.find("Status") != std::string::npos;
      EXPECT_EQ(before, status ? "@topic @mutable" : "@topic @appendable") << line;
    }
    before = code;
  }
  EXPECT_EQ(structs, topics().size());
}

TEST(Topics, PartitionsSeparateRunsAndWorkers) {
  EXPECT_EQ(public_partitions("r"), (std::vector<std::string>{"", "r"}));
  EXPECT_EQ(run_partition("r"), (std::vector<std::string>{"r"}));
  EXPECT_EQ(worker_partition("r", 7), (std::vector<std::string>{"r/w7"}));
  EXPECT_EQ(asker_partition("r", 7), (std::vector<std::string>{"r/a7"}));
}

TEST(Topics, ARunNameThatIsAPatternAPathOrAnOptionIsRefused) {
  for (const std::string bad :
       {"", "a/b", "a*", "a?", "[a]", "a b", "\xc3\xa4", "-a", ".", "..", ".a", "a=b", "a+b"}) {
    EXPECT_THROW(check_run_name(bad), Error) << bad;
  }
  EXPECT_THROW(check_run_name(std::string(101, 'a')), Error);
  for (const std::string good : {"lift-01_b.2", "7", "_a", "a-"}) {
    EXPECT_NO_THROW(check_run_name(good)) << good;
  }
}

}  // namespace
}  // namespace omentum

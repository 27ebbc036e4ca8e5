#include "core/topics.h"

#include <gtest/gtest.h>

#include <fstream>
#include <set>
#include <string>

#include "core/check.h"
#include "core/dds.h"
#include "core/wire.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

// What the middleware must report for an endpoint of this row.
std::string wanted_qos(const TopicSpec& spec, bool writer, std::int32_t max_samples) {
  const std::int32_t limit = max_samples > 0 ? max_samples : -1;
  const bool late = spec.durability == Durability::kTransientLocal;
  return fmt::format(
      "reliability=reliable blocking_ns={} history={} depth={} durability={} service_depth={} "
      "ownership=shared deadline_ns={} autodispose={} max_samples={} max_instances=-1 "
      "max_samples_per_instance={}",
      spec.max_blocking_ns, spec.history == History::kKeepAll ? "keep_all" : "keep_last",
      spec.history == History::kKeepAll ? 0 : spec.depth, late ? "transient_local" : "volatile",
      late ? spec.service_depth : 0, writer ? spec.deadline_ns : 0, writer ? "false" : "true",
      limit, limit);
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
void check_endpoints() {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::mesh_profile().uri, "test");
  const TopicSpec& spec = topic_spec(topic_of<Record>());
  const std::int32_t fuse = spec.history == History::kKeepAll ? 256 : 0;
  const BusWriter<Record> writer(participant, public_partitions("r"), "w");
  const BusReader<Record> reader(participant, run_partition("r"), "r", {.max_samples = fuse});
  EXPECT_EQ(comparable(dds::describe_qos(writer.handle()), spec, true),
            comparable(wanted_qos(spec, true, 0), spec, true))
      << spec.name;
  EXPECT_EQ(comparable(dds::describe_qos(reader.raw().handle()), spec, false),
            comparable(wanted_qos(spec, false, fuse), spec, false))
      << spec.name;
}

TEST(Topics, EffectiveQosIsTheTable) {
  check_endpoints<PolicyWeights>();
  check_endpoints<RolloutTask>();
  check_endpoints<RolloutSegment>();
  check_endpoints<WorkerStatus>();
  check_endpoints<LearnerStatus>();
  check_endpoints<EpisodeSummary>();
  check_endpoints<RunManifest>();
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
    EXPECT_STRNE(spec.reason, "");
    // The learner writes KEEP_LAST only: a frozen worker cannot freeze it. Segments alone are
    // KEEP_ALL.
    EXPECT_EQ(spec.history == History::kKeepAll, spec.id == TopicId::kRolloutSegment);
    EXPECT_EQ(spec.is_public, spec.id != TopicId::kRolloutTask);
    EXPECT_EQ(spec.service_depth >= 1, spec.durability == Durability::kTransientLocal);
  }
}

// docs/wire.md 7: constructs that generic tools cannot decode, or that end compatible change.
TEST(Idl, KeepsTheRulesThatGenericToolsNeed) {
  std::ifstream file(std::string(OMENTUM_SOURCE_DIR) + "/idl/omentum.idl");
  std::string before;
  std::size_t structs = 0;
  for (std::string line; std::getline(file, line);) {
    const std::string code = line.substr(0, line.find("//"));
    for (const std::string bad : {"bitmask", "@nested", "@final", "@value", "@external", "wstring",
                                  "map<", "typedef", "union", "sequence<float>", "int8"}) {
      EXPECT_EQ(code.find(bad), std::string::npos) << line;
    }
    if (code.find("sequence<") != std::string::npos) {
      EXPECT_NE(code.find(','), std::string::npos) << "unbounded: " << line;
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

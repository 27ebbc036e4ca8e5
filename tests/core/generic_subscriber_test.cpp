// A subscriber that has none of our types compiled in (docs/wire.md 7): it learns topic, type
// and layout from the wire, as `cyclonedds subscribe` does, and decodes a sample of every public
// topic. The other process, this program run with `--publish <domain>`, is the only one that
// registers types. The generated header serves the comparison.
#include <dds/dds.h>
#include <gtest/gtest.h>

#include <cstring>
#include <functional>
#include <map>
#include <thread>

#include "core/wire.h"
#include "omentum.h"
#include "tests/support/domain.h"
#include "tests/support/process.h"

namespace omentum {
namespace {

constexpr dds_duration_t kTimeout = DDS_SECS(10);
constexpr std::uint32_t kMark = 0x5eed;

template <typename Record>
void publish_until_killed(const dds::Participant& participant, const Record& record) {
  static std::vector<std::jthread> threads;
  threads.emplace_back([&participant, record] {
    BusWriter<Record> writer(participant, public_partitions("generic"), "publisher");
    while (true) {
      if (!writer.write(record)) return;
      std::this_thread::sleep_for(std::chrono::milliseconds(50));  // a rate, not a wait
    }
  });
}

int publish(std::uint32_t domain) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "publisher");
  PolicyWeights weights;
  weights.policy_version = kMark;
  weights.parameters = {1, 2, 3};
  publish_until_killed(participant, weights);
  RolloutSegment segment;
  segment.policy_version = kMark;
  segment.steps = 1;
  segment.observations = {4, 5};
  segment.bootstrap_observation = {6, 7};
  segment.actions = {0, 1, 2, 1};
  segment.log_probs = segment.rewards = segment.values = {0.5f};
  segment.flags = {4};
  publish_until_killed(participant, segment);
  WorkerStatus worker;
  worker.policy_version = kMark;
  worker.host = "here";
  worker.warnings = {"a", "b"};
  publish_until_killed(participant, worker);
  LearnerStatus learner;
  learner.policy_version = kMark;
  learner.run_id = "generic";
  publish_until_killed(participant, learner);
  EpisodeSummary summary;
  summary.first_version = kMark;
  summary.start_position_in_world_m = {1, 2, 3};
  publish_until_killed(participant, summary);
  RunManifest manifest;
  manifest.config_hash = kMark;
  manifest.config_text = "text";
  manifest.observation_names = {"x", "y"};
  publish_until_killed(participant, manifest);
  ControlCommand command;
  command.request = kMark;
  command.run_id = "generic";
  publish_until_killed(participant, command);
  ControlReply reply;
  reply.request = kMark;
  reply.text = "done";
  publish_until_killed(participant, reply);
  SimFrame frame;
  frame.policy_version = kMark;
  frame.particle_positions_in_world_m = {1, 2, 3};
  publish_until_killed(participant, frame);
  RobotStatus robot;
  robot.policy_version = kMark;
  robot.robot = "PSM1";
  robot.refusals = {0, 2};
  robot.refusal_names = {"NONE", "STEP"};
  publish_until_killed(participant, robot);
  pause();
  return 0;
}

// What a decoded sample must look like, and the size the generated code gives the type.
struct Expectation {
  TopicId id;
  const dds_topic_descriptor_t* compiled;
  std::function<bool(const void*)> looks_right;
};

const std::vector<Expectation>& expectations() {
  static const std::vector<Expectation> all{
      {TopicId::kPolicyWeights, &omentum_v1_PolicyWeights_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_PolicyWeights*>(p);
         return s.policy_version == kMark && s.parameters._length == 3 &&
                s.parameters._buffer[2] == 3;
       }},
      {TopicId::kRolloutSegment, &omentum_v1_RolloutSegment_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_RolloutSegment*>(p);
         return s.policy_version == kMark && s.actions._length == 4 && s.flags._buffer[0] == 4;
       }},
      {TopicId::kWorkerStatus, &omentum_v1_WorkerStatus_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_WorkerStatus*>(p);
         return s.policy_version == kMark && std::strcmp(s.host, "here") == 0 &&
                s.warnings._length == 2;
       }},
      {TopicId::kLearnerStatus, &omentum_v1_LearnerStatus_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_LearnerStatus*>(p);
         return s.policy_version == kMark && std::strcmp(s.run_id, "generic") == 0 &&
                s.weights_hash._length == 32;
       }},
      {TopicId::kEpisodeSummary, &omentum_v1_EpisodeSummary_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_EpisodeSummary*>(p);
         return s.first_version == kMark && s.start_position_in_world_m._length == 3;
       }},
      {TopicId::kRunManifest, &omentum_v1_RunManifest_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_RunManifest*>(p);
         return s.config_hash == kMark && std::strcmp(s.config_text, "text") == 0 &&
                s.observation_names._length == 2;
       }},
      {TopicId::kControlCommand, &omentum_v1_ControlCommand_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_ControlCommand*>(p);
         return s.request == kMark && std::strcmp(s.run_id, "generic") == 0;
       }},
      {TopicId::kControlReply, &omentum_v1_ControlReply_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_ControlReply*>(p);
         return s.request == kMark && std::strcmp(s.text, "done") == 0;
       }},
      {TopicId::kSimFrame, &omentum_v1_SimFrame_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_SimFrame*>(p);
         return s.policy_version == kMark && s.particle_positions_in_world_m._length == 3 &&
                s.tool_position_in_world_m._length == 3;
       }},
      {TopicId::kRobotState, &omentum_v1_RobotStatus_desc,
       [](const void* p) {
         const auto& s = *static_cast<const omentum_v1_RobotStatus*>(p);
         return s.policy_version == kMark && std::strcmp(s.robot, "PSM1") == 0 &&
                s.refusals._length == 2 && s.refusals._buffer[1] == 2;
       }},
  };
  return all;
}

// Type information by topic name, from the announcements of the publisher's writers. Valid while
// the loan is held.
using Discovered = std::map<std::string, const dds_typeinfo_t*>;

// Learns the type of one topic and takes one sample of it with everything at its default: no
// partition, best effort.
void subscribe(dds_entity_t participant, const Expectation& expected,
               const Discovered& discovered) {
  const TopicSpec& spec = topic_spec(expected.id);
  SCOPED_TRACE(spec.name);
  const dds_typeinfo_t* type_info = discovered.at(spec.name);
  ASSERT_NE(type_info, nullptr);
  const dds_entity_t found =
      dds_find_topic(DDS_FIND_SCOPE_GLOBAL, participant, spec.name, type_info, kTimeout);
  EXPECT_GT(found, 0) << dds_strretcode(found);
  dds_delete(found);  // it carries the writer's policies; a tool makes its own
  dds_topic_descriptor_t* descriptor = nullptr;
  ASSERT_EQ(dds_create_topic_descriptor(DDS_FIND_SCOPE_GLOBAL, participant, type_info, kTimeout,
                                        &descriptor),
            DDS_RETCODE_OK);
  EXPECT_STREQ(descriptor->m_typename, expected.compiled->m_typename);
  EXPECT_EQ(descriptor->m_size, expected.compiled->m_size);
  EXPECT_EQ(descriptor->m_nkeys, expected.compiled->m_nkeys);
  const dds_entity_t topic = dds_create_topic(participant, descriptor, spec.name, nullptr, nullptr);
  ASSERT_GT(topic, 0) << dds_strretcode(topic);
  const dds_entity_t reader = dds_create_reader(participant, topic, nullptr, nullptr);
  ASSERT_GT(reader, 0) << dds_strretcode(reader);
  const dds_entity_t waitset = dds_create_waitset(participant);
  const dds_entity_t condition = dds_create_readcondition(reader, DDS_ANY_STATE);
  ASSERT_EQ(dds_waitset_attach(waitset, condition, 0), DDS_RETCODE_OK);
  EXPECT_GT(dds_waitset_wait(waitset, nullptr, 0, kTimeout), 0) << "no sample";
  void* samples[1] = {nullptr};
  dds_sample_info_t infos[1];
  const dds_return_t count = dds_take(reader, samples, infos, 1, 1);
  ASSERT_EQ(count, 1);
  EXPECT_TRUE(infos[0].valid_data && expected.looks_right(samples[0]));
  dds_return_loan(reader, samples, count);
  dds_delete(waitset);
  dds_delete(reader);
  dds_delete_topic_descriptor(descriptor);
}

TEST(GenericSubscriber, DecodesEveryPublicTopicWithoutCompiledTypes) {
  const test::PrivateDomain domain;
  const test::Process publisher(
      {test::this_executable(), "--publish", std::to_string(domain.id())});
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "generic");
  const std::size_t public_topics =
      topics().size() - 3;  // all but tasks and results of simulations
  EXPECT_EQ(expectations().size(), public_topics);

  const dds_entity_t builtin =
      dds_create_reader(participant.handle(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
  ASSERT_GT(builtin, 0);
  const dds_entity_t waitset = dds_create_waitset(participant.handle());
  const dds_entity_t condition = dds_create_readcondition(builtin, DDS_NOT_READ_SAMPLE_STATE);
  ASSERT_EQ(dds_waitset_attach(waitset, condition, 0), DDS_RETCODE_OK);
  Discovered discovered;
  std::vector<std::pair<void*, int>> loans;
  const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(10);
  while (discovered.size() < public_topics && std::chrono::steady_clock::now() < end) {
    dds_waitset_wait(waitset, nullptr, 0, DDS_MSECS(200));
    void* samples[1] = {nullptr};
    dds_sample_info_t infos[1];
    while (dds_take(builtin, samples, infos, 1, 1) == 1) {
      const auto* endpoint = static_cast<const dds_builtintopic_endpoint_t*>(samples[0]);
      const dds_typeinfo_t* type_info = nullptr;
      if (infos[0].valid_data &&
          dds_builtintopic_get_endpoint_type_info(
              const_cast<dds_builtintopic_endpoint_t*>(endpoint), &type_info) == DDS_RETCODE_OK &&
          type_info != nullptr) {
        discovered[endpoint->topic_name] = type_info;
      }
      loans.emplace_back(samples[0], 1);
      samples[0] = nullptr;
    }
  }
  ASSERT_EQ(discovered.size(), public_topics);
  for (const Expectation& expected : expectations()) {
    subscribe(participant.handle(), expected, discovered);
  }
  for (auto& [sample, count] : loans) dds_return_loan(builtin, &sample, count);
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  if (argc == 3 && std::strcmp(argv[1], "--publish") == 0) {
    return omentum::publish(static_cast<std::uint32_t>(std::stoul(argv[2])));
  }
  testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}

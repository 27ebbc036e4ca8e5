// Writes the seeds of tests/fuzz/corpus/records/: one record of every topic as it crosses the wire,
// and all of them in one file. Usage: make_records_corpus <folder>
#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <fmt/format.h>

#include <cstdint>
#include <fstream>
#include <string>

#include "core/wire.h"
#include "tests/support/domain.h"
#include "tests/support/some_records.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

constexpr std::size_t kHeaderBytes = 4;  // encoding and padding, before the data

/// The data of a record, as a reader in this process gets it.
template <typename Record>
std::string bytes_of(const dds::Participant& participant, const Record& record) {
  BusReader<Record> reader(participant, run_partition("seeds"), "seeds");
  BusWriter<Record> writer(participant, run_partition("seeds"), "seeds");
  ddsi_serdata* data = nullptr;
  dds_sample_info_t info;
  while (!writer.write(record) || dds_takecdr(reader.raw().handle(), &data, 1, &info, 0) != 1) {
  }
  std::string bytes(ddsi_serdata_size(data) - kHeaderBytes, '\0');
  ddsi_serdata_to_ser(data, kHeaderBytes, bytes.size(), bytes.data());
  ddsi_serdata_unref(data);
  return bytes;
}

/// A record as tests/fuzz/fuzz_records.cpp reads it.
template <typename Record>
std::string seed_of(const dds::Participant& participant, std::uint8_t number,
                    const Record& record) {
  const std::string bytes = bytes_of(participant, record);
  return std::string{static_cast<char>(number), 0, static_cast<char>(bytes.size() % 256),
                     static_cast<char>(bytes.size() / 256)} +
         bytes;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc != 2) {
    fmt::print(stderr, "usage: make_records_corpus <folder>\n");
    return 2;
  }
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), dds_config_xml({}), "seeds");
  std::uint8_t number = 0;
  std::string all;
  const auto write = [&](const std::string& name, const std::string& seed) {
    std::ofstream(std::string(argv[1]) + "/" + name, std::ios::binary) << seed;
  };
  const auto add = [&](const std::string& name, const auto& record) {
    const std::string seed = seed_of(participant, number++, record);
    write(name, seed);
    all += seed;
  };
  PolicyWeights weights = test::some(PolicyWeights());
  weights.parameters.resize(5);
  add("policy_weights", weights);
  RolloutTask task = test::some(RolloutTask());
  task.start_state.resize(7);
  add("rollout_task", task);
  RolloutSegment segment = test::some(RolloutSegment());
  segment.end_state.resize(7);
  add("rollout_segment", segment);
  add("worker_status", test::some(WorkerStatus()));
  LearnerStatus learner = test::some(LearnerStatus());
  learner.run_id = "fuzz";
  add("learner_status", learner);
  add("episode_summary", test::some(EpisodeSummary()));
  RunManifest manifest = test::some(RunManifest());
  manifest.run_id = "fuzz";
  add("run_manifest", manifest);
  add("control_command", test::some(ControlCommand()));
  add("control_reply", test::some(ControlReply()));
  add("sim_frame", test::some(SimFrame()));
  add("robot_status", test::some(RobotStatus()));
  add("simulation_grant", test::some(SimulationGrant()));
  add("simulation_part", test::some(SimulationPart()));
  write("all", all);
  return 0;
}

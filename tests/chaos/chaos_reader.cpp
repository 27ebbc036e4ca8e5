// A tool that reads the segments of a run reliably, for the row tool_stop: usage chaos_reader
// DOMAIN RUN
#include <cstdio>
#include <cstdlib>

#include "core/dds_options.h"
#include "core/wire.h"

int main(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  if (argc != 3) return 2;
  const dds::Participant participant(static_cast<std::uint32_t>(std::atoi(argv[1])),
                                     dds_config_xml({}), "chaos-reader");
  BusReader<RolloutSegment> reader(participant, run_partition(argv[2]), "reliable-tool", 64);
  dds::Waitset waitset(participant);
  waitset.attach(reader.raw());
  for (bool told = false; true;) {
    waitset.wait(100'000'000);
    const Result<int> taken = reader.take(64, [](Arrival<RolloutSegment>&&) {});
    if (taken && taken.value() > 0 && !told) {
      std::puts("reads");
      std::fflush(stdout);
      told = true;
    }
  }
}

// A foreign writer on the domain of a run until it is killed: dds_stranger RUN DOMAIN forges what
// learner and worker send; dds_stranger RUN DOMAIN workers [PER_S=2000] announces made-up workers,
// one more each time.
#include <unistd.h>

#include <cstdlib>
#include <cstring>

#include "tests/support/stranger.h"

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace): a program of this very namespace

[[noreturn]] void announce_workers(const std::string& run, std::uint32_t domain, int per_s) {
  const dds::Participant participant(domain, test::loopback_profile().uri, "stranger");
  BusWriter<WorkerStatus> writer(participant, run_partition(run), "stranger-workers");
  WorkerStatus status;
  status.lanes = 4;
  status.phase = WorkerPhase::kIdle;
  constexpr int kBurst = 50;
  while (true) {
    for (int i = 0; i < kBurst; ++i) {
      ++status.worker_id;
      (void)writer.write(status);
    }
    usleep(static_cast<useconds_t>(1'000'000 * kBurst / per_s));
  }
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 3) return 2;
  const auto domain = static_cast<std::uint32_t>(std::atoi(argv[2]));
  if (argc > 3 && std::strcmp(argv[3], "workers") == 0)
    announce_workers(argv[1], domain, argc > 4 ? std::max(1, std::atoi(argv[4])) : 2000);
  const test::Stranger stranger(domain, argv[1]);
  while (true) pause();
}

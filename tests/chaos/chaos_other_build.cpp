// A worker of another build of the same commit, for the row other_build: usage chaos_other_build
// DOMAIN RUN
#include <cstdlib>

#include "core/build_id.h"
#include "sim_worker/bus/bus_worker.h"

int main(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  if (argc != 3) return 2;
  BusWorkerOptions options;
  options.run = argv[2];
  options.domain = static_cast<std::uint32_t>(std::atoi(argv[1]));
  options.profile.uri = dds_config_xml({});
  options.build_id = build_id() ^ 1;  // what changed physics would make it
  options.make_setup = [](const RunManifest&) { return WorkerSetup{}; };
  options.rollout = [](Backend&, Policy&, std::span<const RolloutTask>, const auto&) {
    return std::vector<RolloutSegment>{};
  };
  return BusWorker(std::move(options)).run([] { return false; });
}

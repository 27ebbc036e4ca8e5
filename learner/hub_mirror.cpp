#include "learner/hub_mirror.h"

#include "core/log.h"

namespace omentum {
namespace {

// A reader that stops must not hold up the learner's drain thread.
constexpr std::int32_t kSegmentsKept = 16;
constexpr const char* kForwarded = "hub:";  // before the issuer: the learner hears itself as well

/// Nothing is serialised while nobody reads.
template <typename Record>
void write(BusWriter<Record>& writer, const Record& record) {
  if (writer.matched() == 0) return;
  if (const Result<void> sent = writer.write(record); !sent)
    log().debug("mirror: {}", sent.error());
}

}  // namespace

HubMirror::HubMirror(const dds::Participant& participant, const std::string& run)
    : workers_(participant, mirror_partitions(run), "learner-mirror-workers"),
      segments_(participant, mirror_partitions(run), "learner-mirror-segments", kSegmentsKept),
      frames_(participant, mirror_partitions(run), "learner-mirror-frames"),
      replies_(participant, mirror_partitions(run), "learner-mirror-replies"),
      robots_(participant, mirror_partitions(run), "learner-mirror-robots"),
      commands_(participant, run_partition(run), "learner-forwarded-commands") {}

void HubMirror::worker(const WorkerStatus& status) {
  // Also without readers: who comes later gets the last one of every worker.
  if (const Result<void> sent = workers_.write(status); !sent)
    log().debug("mirror: {}", sent.error());
}

void HubMirror::gone(const WorkerStatus& status) {
  if (const Result<void> sent = workers_.dispose(status); !sent)
    log().debug("mirror: {}", sent.error());
}

void HubMirror::segment(const RolloutSegment& segment) { write(segments_, segment); }
void HubMirror::frame(const SimFrame& frame) { write(frames_, frame); }
void HubMirror::reply(const ControlReply& reply) { write(replies_, reply); }
void HubMirror::robot(const RobotStatus& status) { write(robots_, status); }

void HubMirror::forward(ControlCommand command) {
  command.issuer = kForwarded + command.issuer;
  write(commands_, command);
}

bool HubMirror::is_forwarded(const ControlCommand& command) {
  return command.issuer.starts_with(kForwarded);
}

}  // namespace omentum

#include "dvrk_gateway/backend/twin_backend.h"

#include "core/check.h"

namespace omentum {

TwinBackend::TwinBackend(SimBackend& scene, ArmGuide& guide) : scene_(scene), guide_(guide) {
  OMENTUM_CHECK(scene.lanes() == 1, "a robot is one lane, the scene has {}", scene.lanes());
}

void TwinBackend::reset(int lane, const EpisodeStart& start) {
  scene_.reset(lane, start);
  const Result<void> there = guide_.go_to(scene_.commanded_tip(lane));
  stop_ = there ? "" : there.error();
}

void TwinBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  if (!stop_.empty()) {
    outcomes[0] = {};
    outcomes[0].stopped = true;
    return;
  }
  const Eigen::Vector3d before = scene_.commanded_tip(0);
  scene_.step(actions, outcomes);
  const Eigen::Vector3d way = scene_.commanded_tip(0) - before;
  // A decision that lasts several periods moves the tool by as much in each of them.
  const auto periods = static_cast<int>(scene_.setup().config.task().action_repeat());
  for (int k = 1; k <= periods && stop_.empty(); ++k) {
    const Eigen::Vector3d goal = before + way * k / periods;
    if (const Result<void> went = guide_.follow(goal, scene_.jaw_closed(0)); !went)
      stop_ = went.error();
  }
  outcomes[0].stopped = !stop_.empty();
}

}  // namespace omentum

#include "dvrk_gateway/backend/dvrk_backend.h"

#include <algorithm>
#include <utility>

#include "core/check.h"

namespace omentum {

using Eigen::Vector3d;

DvrkBackend::DvrkBackend(SimBackend& scene) : scene_(scene) {
  OMENTUM_CHECK(scene.lanes() == 1, "a robot is one lane, the scene has {}", scene.lanes());
}

bool DvrkBackend::went(const Result<void>& result) {
  if (!result && stop_.empty()) stop_ = result.error();
  return result.has_value();
}

void DvrkBackend::refuse_step(std::span<StepOutcome> outcomes) {
  outcomes[0] = {};
  outcomes[0].stopped = true;
}

// ------------------------------------------------------------------------------------------- twin

void TwinBackend::reset(int lane, const EpisodeStart& start) {
  scene_.reset(lane, start);
  stop_.clear();
  went(guide_.go_to(scene_.commanded_tip(lane)));
}

void TwinBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  if (stopped()) return refuse_step(outcomes);
  const Vector3d before = scene_.commanded_tip(0);
  scene_.step(actions, outcomes);
  const Vector3d way = scene_.commanded_tip(0) - before;
  // A decision that lasts several periods moves the tool by as much in each of them.
  const auto periods = static_cast<int>(scene_.setup().config.task().action_repeat());
  for (int k = 1; k <= periods; ++k) {
    if (!went(guide_.follow(before + way * k / periods))) break;
  }
  if (!stopped()) went(guide_.turn_jaw(scene_.clock(0).held));
  outcomes[0].stopped = stopped();
}

// --------------------------------------------------------------------------------------- measured

MeasuredBackend::MeasuredBackend(SimBackend& scene, ArmGuide& guide)
    : DvrkBackend(scene), guide_(guide) {
  scene_.follow_robot([this](const Vector3d& goal) {
    if (!stopped()) went(guide_.follow(goal));
    return guide_.measured_tip();
  });
}

void MeasuredBackend::reset(int lane, const EpisodeStart& start) {
  scene_.reset(lane, start);
  stop_.clear();
  const Vector3d begin = scene_.commanded_tip(lane);
  if (went(guide_.go_to(begin))) scene_.place_tip(lane, begin, guide_.measured_tip());
}

void MeasuredBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  if (stopped()) return refuse_step(outcomes);
  scene_.step(actions, outcomes);
  if (!stopped()) went(guide_.turn_jaw(scene_.clock(0).held));
  outcomes[0].stopped = stopped();
}

// ------------------------------------------------------------------------------------------ teach

TaughtBackend::TaughtBackend(SimBackend& scene, ArmGuide& guide, std::function<bool()> asks_begin,
                             std::function<bool()> asks_end, double jaw_closed_below_rad)
    : DvrkBackend(scene),
      guide_(guide),
      asks_begin_(std::move(asks_begin)),
      asks_end_(std::move(asks_end)),
      jaw_closed_below_rad_(jaw_closed_below_rad) {
  scene_.follow_robot([this](const Vector3d&) { return tips_[tip_++]; });
}

void TaughtBackend::reset(int lane, const EpisodeStart& start) {
  scene_.reset(lane, start);
  stop_.clear();
  lag_m_ = 0;
  ended_ = false;
  (void)asks_begin_();  // what was asked before counts for nothing
  (void)asks_end_();
  while (went(guide_.watch())) {
    if (guide_.measures() && asks_begin_()) break;
  }
  if (!stopped()) scene_.place_tip(lane, guide_.measured_tip(), guide_.measured_tip());
}

Action TaughtBackend::next_action() {
  const Vector3d from = scene_.commanded_tip(0);
  const std::uint32_t periods = scene_.setup().config.task().action_repeat();
  tips_.clear();
  tip_ = 0;
  while (tips_.size() < periods) {
    if (!stopped()) went(guide_.watch());
    tips_.push_back(guide_.measured_tip());
  }
  if (!stopped() && !guide_.measures()) stop_ = "the robot tells no valid pose";
  ended_ = asks_end_();
  const bool closed = guide_.measured_jaw_rad() < jaw_closed_below_rad_;
  return scene_.task().action_towards(tips_.back() - from, closed);
}

void TaughtBackend::step(std::span<const Action> actions, std::span<StepOutcome> outcomes) {
  if (stopped()) return refuse_step(outcomes);
  scene_.step(actions, outcomes);
  lag_m_ = std::max(lag_m_, (tips_.back() - scene_.commanded_tip(0)).norm());
  outcomes[0].ended = ended_ || outcomes[0].terminated;
}

}  // namespace omentum

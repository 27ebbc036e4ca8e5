#include "dvrk_gateway/dvrk_double/attached_tissue.h"

#include <array>

#include "core/constants.h"
#include "sim_worker/backend/pinch_contact.h"
#include "sim_worker/instrument/jaw.h"
#include "sim_worker/models.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// The sheet has come to rest on what lies under it after this time (decision 0020).
constexpr double kSettleTime_s = 3;
const Vector3d kFarAway_W(0, 0, 1);

}  // namespace

AttachedTissue::AttachedTissue(std::shared_ptr<const SimSetup> setup) : setup_(std::move(setup)) {
  lay();
}

void AttachedTissue::lay() {
  tissue_ = setup_->tissue->make_tissue(choose_kernel(1));
  const std::array<ToolMotion, 1> away = {{{kFarAway_W, kFarAway_W}}};
  const int steps = static_cast<int>(kSettleTime_s / control_period_s());
  for (int k = 0; k < steps; ++k) tissue_->step(away);
}

void AttachedTissue::pinch(double jaw_deg) {
  ++pinches_;
  const pb::Grasp& grasp = setup_->config.grasp();
  std::array<Nearest, 1> nearest{};
  tissue_->find_nearest(std::array{tip_}, nearest);
  const Jaw jaw{tip_, setup_->mount.jaw_direction(), jaw_deg};
  const PinchContact contact = pinch_contact(*setup_, *tissue_, 0, jaw, nearest[0]);
  if (judge_pinch(grasp, contact) != PinchResult::kHeld) return;
  tissue_->hold(0, tip_, grasp.patch_radius_m(), false);
  slip_ = 0;
  if (holds()) ++grasps_;
}

void AttachedTissue::slip() {
  const pb::Grasp& grasp = setup_->config.grasp();
  const Vector3d force = tissue_->held_force(0);
  const double load = force.norm();
  const double way = slip_speed(grasp, load) * control_period_s();
  if (!(way > 0)) return;
  tissue_->shift_held(0, way / load * force);
  slip_ += way;
  if (!slipped_out(grasp, slip_)) return;
  tissue_->release(0);
  ++losses_;
}

double AttachedTissue::jaw_stop_rad() const {
  if (!holds()) return -10;
  return 0.8 * kDegree * jaw_contact_deg(setup_->config.grasp(), setup_->scene.tissue.thickness);
}

Vector3d AttachedTissue::step(const Vector3d& p_WT, double jaw_rad) {
  const double jaw_deg = jaw_rad / kDegree;
  const double contact_deg =
      jaw_contact_deg(setup_->config.grasp(), setup_->scene.tissue.thickness);
  if (!placed_) tip_ = p_WT;
  // A pinch is the moment at which the closing jaw comes onto the tissue.
  if (jaw_deg >= contact_deg && holds()) tissue_->release(0);
  if (placed_ && jaw_deg < contact_deg && jaw_deg_ >= contact_deg && !holds()) pinch(jaw_deg_);
  placed_ = true;
  jaw_deg_ = jaw_deg;
  tissue_->step(std::array<ToolMotion, 1>{{{tip_, p_WT}}});
  tip_ = p_WT;
  if (!holds()) return Vector3d::Zero();
  slip();
  return holds() ? tissue_->held_force(0) : Vector3d::Zero();
}

}  // namespace omentum

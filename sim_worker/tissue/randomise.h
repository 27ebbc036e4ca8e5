#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "core/scene_draws.h"
#include "proto/config.pb.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Domain randomisation: parameters of tissue and arm that are drawn per slot and episode from the
/// ranges of config.randomise.

/// Throws Error for an unknown parameter and for a range of which some value is not possible in the
/// scene, alone or together with the others.
void check_randomise(const pb::Config& config, const Scene& scene);

struct DrawnParameters {
  LaneParameters parameters;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< of the tissue at the start, in W [m]
  pb::ArmEffects arm;
};

/// What the configuration says without a draw.
DrawnParameters not_drawn(const Scene& scene);

/// A pure function of its arguments: every worker draws the same. Precondition: check_randomise()
/// did not throw.
DrawnParameters draw_randomised(const pb::Config& config, const Scene& scene, const DrawKey& key);

/// Whether effects of the arm are among what is drawn.
bool draws_arm(const pb::Config& config);

}  // namespace omentum

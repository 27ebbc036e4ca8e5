#pragma once

#include <Eigen/Core>
#include <cstdint>

#include "proto/config.pb.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Domain randomisation: parameters of the scene that are drawn per slot and episode from the
/// ranges of config.randomise.

/// Throws Error for an unknown parameter and for a range of which some value is not possible in the
/// scene, alone or together with the others.
void check_randomise(const pb::Config& config, const Scene& scene);

struct DrawnParameters {
  LaneParameters parameters;
  Eigen::Vector3d offset = Eigen::Vector3d::Zero();  ///< of the tissue at the start, in W [m]
};

/// A pure function of its arguments: every worker draws the same.
DrawnParameters draw_randomised(const pb::Config& config, const Scene& scene,
                                std::uint64_t run_seed, std::uint32_t slot, std::uint64_t episode);

}  // namespace omentum

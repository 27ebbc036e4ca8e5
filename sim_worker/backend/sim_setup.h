#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/psm.h"
#include "core/task.h"
#include "proto/config.pb.h"
#include "sim_worker/backend/exposure.h"
#include "sim_worker/instrument/arm.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/tissue.h"

namespace omentum {

/// Everything about the scene and task that environments share; made once per process.
struct SimSetup {
  pb::Config config;
  Scene scene;
  std::shared_ptr<const TissueModel> tissue;
  ToolMount mount;
  std::shared_ptr<const Arm> arm;
  std::shared_ptr<const ExposureEstimator> exposure;
  std::vector<std::string> warnings;
};

/// Resolves a configuration; relative mesh paths start beside its scene file. Throws Error with the
/// place in that file, as warnings have it.
std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config);

/// The same, but relative mesh paths start at `directory`.
std::shared_ptr<const SimSetup> make_sim_setup(const pb::Config& config,
                                               const std::string& directory);

/// The task of the configuration in its scene.
Task make_task(const SimSetup& setup);

}  // namespace omentum

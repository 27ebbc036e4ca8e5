#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// How the grasp that can fail answers to one value of one of its parameters.
struct GraspStudyRow {
  std::string parameter;  ///< field of pb::Grasp
  std::string unit;
  double value = 0;
  bool shipped = false;  ///< the value of the configuration itself
  int starts = 0;
  int held = 0;       ///< tissue still held at p_T
  int lost = 0;       ///< taken hold of, slipped out on the way
  int not_taken = 0;  ///< the jaw closed without taking hold, or never met tissue
  std::array<int, 5>
      causes{};  ///< starts by the result of their pinch (PinchResult); kTooFar = never met tissue
};

/// Varies each parameter alone around the configuration and runs a scripted grasp from every start
/// of the robot grid: straight down with the jaw open, close at 1.4 mm from the nearest particle,
/// straight to p_T. The script stands in for the operator, so the figures are of the grasp, not of
/// a policy. Empty without a robot grid. About 0.4 s per value on one core.
std::vector<GraspStudyRow> study_grasps(const SimSetup& setup);

/// What a study depends on, of this build: equal ids mean equal tables.
std::uint64_t grasp_study_id(const pb::Config& config, std::uint64_t build_id);

/// parameter,unit,value,shipped,starts,held,lost,not_taken,too_far,jaw_not_open,bad_approach,
/// too_thin,study_id
std::string grasp_study_csv(const std::vector<GraspStudyRow>& rows, std::uint64_t id);

/// The file is a whole table of this id.
bool is_grasp_study(const std::string& path, std::uint64_t id);

}  // namespace omentum

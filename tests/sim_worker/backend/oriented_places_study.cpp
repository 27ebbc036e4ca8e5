// Where the resting sheet of preset omentum_oriented is inclined by 30 - 60 degrees, can be taken
// along its normal and shows the tumour when it is lifted from there: the tumour_place entries of
// deploy/scenes/omentum_oriented.txtpb, as text. Run by hand: oriented_places_study > places.txtpb

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <vector>

#include "core/config.h"
#include "core/constants.h"
#include "core/evaluation_table.h"
#include "sim_worker/backend/sim_backend.h"
#include "sim_worker/models.h"
#include "tests/support/resting_sheet.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kLeastIncline = 30, kMostIncline = 60;  // [deg]
constexpr double kMargin = 1.05;  // over the share of the best exposure that counts as exposed
constexpr int kSteps = 200;       // decisions of the lift and the hold behind it

/// Exposure after a lift from every particle, taken as the grasp lattice of an evaluation does; 0
/// where p_T was not reached with the tissue in the jaws.
std::vector<double> exposures_of_lifts(const std::shared_ptr<const SimSetup>& setup) {
  const int lanes = choose_kernel(0).lanes;
  SimBackend backend(setup, lanes);
  std::vector<double> exposures;
  const auto particles = static_cast<int>(setup->scene.tissue.particles.size());
  for (int first = 0; first < particles; first += lanes) {
    for (int lane = 0; lane < lanes; ++lane) {
      EpisodeStart start;
      start.start_set = StartSet::kGraspLattice;
      start.start_index = static_cast<std::uint32_t>(std::min(first + lane, particles - 1));
      backend.reset(lane, start);
    }
    std::vector<Action> actions(static_cast<std::size_t>(lanes));
    std::vector<StepOutcome> outcomes(actions.size());
    for (int step = 0; step < kSteps; ++step) {
      for (int lane = 0; lane < lanes; ++lane)
        actions[static_cast<std::size_t>(lane)] = backend.hold_action(lane);
      backend.step(actions, outcomes);
    }
    for (int lane = 0; lane < lanes && first + lane < particles; ++lane) {
      const EpisodeFacts facts = backend.facts(lane);
      exposures.push_back(facts.held && facts.reached ? static_cast<double>(facts.exposure) : 0);
    }
  }
  return exposures;
}

/// Roll and pitch that lay a jaw which points along -z_W against the normal.
RollPitchYaw angles_along(const Vector3d& normal) {
  const Vector3d into = -normal;
  return {std::asin(into.y()), std::atan2(-into.x(), -into.z()), 0};
}

int run() {
  const std::vector<std::string> sets = {"task.observation=OBSERVATION_OMENTUM",
                                         "task.action=ACTION_XYZ_GRIPPER"};
  const auto setup = make_sim_setup(load_config("omentum_oriented", sets));
  const test::RestingSheet sheet = test::resting_sheet(*setup);
  const std::vector<double> exposures = exposures_of_lifts(setup);
  const double best = *std::max_element(exposures.begin(), exposures.end());
  const double limit = setup->config.task().turn_limit_deg() * kDegree;
  int count = 0, inclined = 0, exposing = 0;
  for (std::size_t i = 0; i < sheet.position.size(); ++i) {
    if (setup->scene.tissue.fixed[i] != 0) continue;
    const Vector3d& p = sheet.position[i];
    const Vector3d& n = sheet.normal[i];
    const double incline = std::acos(n.z()) / kDegree;
    if (!(incline >= kLeastIncline && incline <= kMostIncline)) continue;
    ++inclined;
    if (!(exposures[i] >= kMargin * kExposedShare * best)) continue;
    ++exposing;
    const RollPitchYaw angles = angles_along(n);
    if (!(angles.cwiseAbs().maxCoeff() < limit)) continue;
    if (!joints_for_tip(turned(setup->mount, angles), p)) continue;
    ++count;
    fmt::print(
        "tumour_place {{ position_m {{ x: {:.5f} y: {:.5f} z: {:.5f} }} normal {{ x: {:.4f} y: "
        "{:.4f} "
        "z: {:.4f} }} }}  # {:.0f} deg\n",
        p.x(), p.y(), p.z(), n.x(), n.y(), n.z(), incline);
  }
  fmt::print(stderr, "{} inclined, {} of them expose ({:.3f} best), {} of these in reach\n",
             inclined, exposing, best, count);
  return count > 0 ? 0 : 1;
}

}  // namespace
}  // namespace omentum

int main() { return omentum::run(); }

#include <gtest/gtest.h>

#include <map>

#include "core/config.h"
#include "sim_worker/backend/grasp_study.h"
#include "sim_worker/instrument/jaw.h"

namespace omentum {
namespace {

pb::Grasp shipped() { return load_config("omentum", {}).grasp(); }

struct Row {
  const char* what;
  PinchContact contact;
  PinchResult expected;
};

TEST(Grasp, TableOfCauses) {
  const pb::Grasp grasp = shipped();
  const double open = grasp.jaw_open_deg();
  const Row rows[] = {
      {"good pinch", {0.0010, open, 20, 0.003}, PinchResult::kHeld},
      {"no tissue in reach", {0.0021, open, 20, 0.003}, PinchResult::kTooFar},
      {"jaw too far closed to take 3 mm between its faces",
       {0.0010, 10, 20, 0.003},
       PinchResult::kJawNotOpen},
      {"along the sheet instead of onto it", {0.0010, open, 75, 0.003}, PinchResult::kBadApproach},
      {"only grazed", {0.0019, open, 20, 0.003}, PinchResult::kTooThin},
      {"thin tissue needs less opening", {0.0010, 10, 20, 0.001}, PinchResult::kHeld},
  };
  for (const Row& row : rows) EXPECT_EQ(judge_pinch(grasp, row.contact), row.expected) << row.what;
}

TEST(Grasp, ZeroParametersAreThePlainProximityGrasp) {
  const pb::Grasp plain = load_config("paper_literal", {}).grasp();
  EXPECT_EQ(judge_pinch(plain, {0.00199, 0, 90, 0.003}), PinchResult::kHeld);
  EXPECT_EQ(judge_pinch(plain, {0.002, 0, 0, 0.003}),
            PinchResult::kTooFar);  // strictly nearer than the radius
  EXPECT_EQ(slip_speed(plain, 1e6), 0);
  EXPECT_FALSE(slipped_out(plain, 1.0));
}

TEST(Grasp, SlipBeginsAtItsForceAndGrowsWithLoad) {
  const pb::Grasp grasp = shipped();
  EXPECT_EQ(slip_speed(grasp, grasp.slip_force_n()), 0);
  EXPECT_NEAR(slip_speed(grasp, grasp.slip_force_n() + 2), 2 * grasp.slip_rate_m_per_s_n(), 1e-12);
  EXPECT_FALSE(slipped_out(grasp, 0.99 * grasp.loss_slip_m()));
  EXPECT_TRUE(slipped_out(grasp, grasp.loss_slip_m()));
}

TEST(Grasp, JawMovesAtItsRateAndStopsAtItsEnds) {
  const pb::Grasp grasp = shipped();
  EXPECT_NEAR(move_jaw(grasp, 24, true, 0.02), 24 - 0.02 * grasp.jaw_rate_deg_per_s(), 1e-12);
  EXPECT_EQ(move_jaw(grasp, 1, true, 0.02), 0);
  EXPECT_EQ(move_jaw(grasp, grasp.jaw_open_deg() - 1, false, 0.02), grasp.jaw_open_deg());
}

TEST(GraspStudy, EveryCauseOfFailureHappensAndEveryParameterMatters) {
  const auto setup = make_sim_setup(load_config("omentum", {}), deploy_dir() + "/scenes");
  const std::vector<GraspStudyRow> rows = study_grasps(*setup);
  ASSERT_FALSE(rows.empty());
  std::map<std::string, std::pair<int, int>> held;  // least and most held by parameter
  std::array<int, 5> causes{};
  int lost = 0;
  for (const GraspStudyRow& row : rows) {
    EXPECT_EQ(row.starts, 25);
    EXPECT_EQ(row.held + row.lost + row.not_taken, row.starts) << row.parameter << " " << row.value;
    for (std::size_t i = 0; i < causes.size(); ++i) causes[i] += row.causes[i];
    lost += row.lost;
    const auto [entry, is_new] = held.try_emplace(row.parameter, row.held, row.held);
    entry->second.first = std::min(entry->second.first, row.held);
    entry->second.second = std::max(entry->second.second, row.held);
  }
  for (const PinchResult cause : {PinchResult::kHeld, PinchResult::kJawNotOpen,
                                  PinchResult::kBadApproach, PinchResult::kTooThin}) {
    EXPECT_GT(causes[static_cast<std::size_t>(cause)], 0) << static_cast<int>(cause);
  }
  EXPECT_GT(lost, 0);
  EXPECT_EQ(held.size(), 6U);
  for (const auto& [parameter, range] : held) EXPECT_LT(range.first, range.second) << parameter;
}

}  // namespace
}  // namespace omentum

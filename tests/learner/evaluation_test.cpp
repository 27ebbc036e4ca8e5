// What an evaluation consists of, and what its tables say of drawn scenes.

#include "learner/evaluation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/config.h"
#include "core/scene_draws.h"

namespace omentum {
namespace {

using testing::ElementsAre;

std::vector<std::string> names_of(const pb::Config& config) {
  std::vector<std::string> names;
  for (const EvaluationSet& set : evaluation_sets(config)) names.push_back(set.name);
  return names;
}

pb::Config drawing_config() {
  pb::Config config = load_config("omentum", {});
  for (const char* parameter : {"tissue.stiffness_scale", "arm.transport_delay_s"}) {
    pb::Randomise& range = *config.add_randomise();
    range.set_parameter(parameter);
    range.set_min(0.02);
    range.set_max(0.08);
  }
  return config;
}

TEST(EvaluationSets, ScenesAreDrawnWhereTrainingDraws) {
  EXPECT_THAT(names_of(load_config("omentum", {})),
              ElementsAre("grid100_greedy", "grasp_lattice", "grid100_sampled", "robot25_greedy",
                          "robot25_sampled"));
  EXPECT_THAT(names_of(drawing_config()),
              ElementsAre("grid100_greedy", "grasp_lattice", "grid100_sampled", "robot25_greedy",
                          "robot25_sampled", "drawn100_greedy", "drawn100_sampled",
                          "drawn100_tissue.stiffness_scale_sampled",
                          "drawn100_arm.transport_delay_s_sampled"));
}

// Every scene is that of the draw which the table names, from the start which the table names.
// A frame of preset omentum_soft holds 961 particles of the sheet and the organ's nodes behind
// them.
TEST(EvaluationSets, LatticeGraspsTheSheetAndNotTheBodyUnderIt) {
  const pb::Config config = load_config("omentum_soft", {});
  EvaluationSet set;
  fill_lattice(config, 1100, set);
  ASSERT_FALSE(set.start_indices.empty());
  EXPECT_LT(set.start_indices.back(), 961U);
}

TEST(EvaluationSets, TablesNameTheValueThatWasDrawnAlone) {
  const pb::Config config = drawing_config();
  for (const EvaluationSet& set : evaluation_sets(config)) {
    const std::vector<EvaluationTask> tasks = evaluation_tasks(config, set, 1);
    const std::vector<RolloutSegment> segments(tasks.size());
    const std::vector<EvaluationRow> rows = judge(config, set, segments, 1);
    ASSERT_EQ(rows.size(), tasks.size());
    const bool alone = set.name.find("_scale_") != std::string::npos ||
                       set.name.find("_delay_s_") != std::string::npos;
    for (std::size_t k = 0; k < rows.size(); ++k) {
      EXPECT_EQ(std::isfinite(rows[k].drawn), alone) << set.name;
      if (set.start_set == StartSet::kGraspLattice) continue;
      EXPECT_EQ((rows[k].row - 1) * set.columns + rows[k].column - 1, k) << set.name;
      if (!alone) continue;
      EpisodeStart start;
      start.run_seed = config.rollout().run_seed();
      start.start_set = tasks[k].start_set;
      start.start_index = static_cast<std::uint32_t>(k);
      const DrawKey among_all = draw_key(start, set.starts).value();
      const int parameter = set.name.find("delay") != std::string::npos ? 1 : 0;
      EXPECT_EQ(rows[k].drawn, drawn_value(config, parameter, among_all));
    }
  }
}

}  // namespace
}  // namespace omentum

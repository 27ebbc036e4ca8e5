#include "core/evaluation_table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace omentum {
namespace {

std::vector<EvaluationRow> some_rows() {
  std::vector<EvaluationRow> rows(4);
  for (std::uint32_t k = 0; k < 4; ++k) {
    rows[k].index = k;
    rows[k].row = k / 2 + 1;
    rows[k].column = k % 2 + 1;
    rows[k].exposure = 0.25 * k;
    rows[k].best_exposure = 0.75;
    rows[k].episode_return = -10.0 * k;
    rows[k].grasp[0] = k == 0 ? std::numeric_limits<double>::quiet_NaN() : 0.0107;
  }
  rows[1].reached = rows[1].held = rows[1].grasp_held = true;
  rows[2].reached = rows[2].lost = true;  // reached, and lost while it held
  rows[3].reached = rows[3].held = rows[3].grasp_held = rows[3].exposed = true;
  rows[0].failed = true;
  rows[1].drawn = 0.045;
  return rows;
}

void expect_equal(const EvaluationFigures& a, const EvaluationFigures& b) {
  EXPECT_EQ(a.starts, b.starts);
  EXPECT_EQ(a.target_reached, b.target_reached);
  EXPECT_EQ(a.held, b.held);
  EXPECT_EQ(a.grasp_held, b.grasp_held);
  EXPECT_EQ(a.exposed, b.exposed);
  EXPECT_EQ(a.lost, b.lost);
  EXPECT_EQ(a.failed, b.failed);
  EXPECT_EQ(a.mean_exposure, b.mean_exposure);
}

TEST(EvaluationTable, FiguresOfItsTextAreThoseOfItsRows) {
  const std::vector<EvaluationRow> rows = some_rows();
  const EvaluationFigures figures = figures_of(rows);
  EXPECT_EQ(figures.starts, 4U);
  EXPECT_EQ(figures.target_reached, 3U) << "reached means reached, whether it was held or not";
  EXPECT_EQ(figures.held, 2U);
  EXPECT_EQ(figures.exposed, 1U);
  EXPECT_EQ(figures.failed, 1U);
  EXPECT_DOUBLE_EQ(figures.mean_exposure, 0.375);
  EXPECT_DOUBLE_EQ(figures.mean_return, -15);
  for (const bool lattice : {false, true}) {
    const std::string text = lattice ? lattice_table(rows) : grid_table(rows);
    const auto table = parse_csv("t", text);
    ASSERT_TRUE(table) << table.error();
    const auto read = read_evaluation(table.value());
    ASSERT_TRUE(read) << read.error();
    expect_equal(figures_of(read.value()), figures);
    if (!lattice) {
      EXPECT_EQ(figures_of(read.value()).mean_return, figures.mean_return);
      EXPECT_TRUE(std::isnan(read.value()[0].drawn));
      EXPECT_EQ(read.value()[1].drawn, 0.045);
    }
  }
}

TEST(EvaluationTable, TheBestGraspReachedAndHeld) {
  std::vector<EvaluationRow> rows = some_rows();
  rows[2].exposure = 1;
  EXPECT_EQ(best_grasp(rows), std::optional<std::size_t>(3));
  rows[1].held = rows[3].held = false;
  EXPECT_EQ(best_grasp(rows), std::nullopt);
}

TEST(EvaluationTable, OlderLatticesAreReadAsTheyWereMeant) {
  const auto table =
      parse_csv("t",
                "particle,x_m,y_m,z_m,exposure,reached\n0,0,0,0,1,1\n1,0,0,0,0.95,1\n"
                "2,0,0,0,0.5,1\n3,0,0,0,1,0\n");
  const auto rows = read_evaluation(table.value());
  ASSERT_TRUE(rows);
  const EvaluationFigures figures = figures_of(rows.value());
  EXPECT_EQ(figures.target_reached, 3U);
  EXPECT_EQ(figures.held, 3U);
  EXPECT_EQ(figures.exposed, 2U);
}

TEST(EvaluationTable, WhatIsMissingOrNoNumberIsNamed) {
  const auto refusal = [](const char* text) {
    return read_evaluation(parse_csv("t", text).value()).error();
  };
  EXPECT_EQ(refusal("index,exposure\n1,2\n"), "t:1: no column reached");
  EXPECT_EQ(refusal("index,exposure,reached\n1,x,0\n"),
            "t:2:3: \"x\" in column exposure is no number");
}

}  // namespace
}  // namespace omentum

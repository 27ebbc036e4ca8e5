// Which law of elasticity a calibration takes.
#include "mismatch/calibrate/law_choice.h"

#include <gtest/gtest.h>

#include <cmath>

namespace omentum {
namespace {

using Eigen::VectorXd;

constexpr double kNumerics = 1e-4;  // [m]

/// Its surface is as much higher as it is stiffer, 1 mm for 1.
LawFit fit_of(pb::ElasticLaw law, double cost, double stiffness) {
  LawFit fit;
  PredictedFrame& frame = fit.d.linear.predictions.emplace_back().frames.emplace_back();
  frame.valid = true;
  frame.vertices.emplace_back(0, 0, 1e-3 * stiffness);
  fit.law = law;
  fit.cost = cost;
  fit.d.found.state.shared = VectorXd::Zero(8);
  fit.d.found.state.shared[0] = stiffness;
  fit.d.found.state.own.assign(1, VectorXd::Zero(3));
  fit.d.found.state.own[0][1] = 0.5 * stiffness;
  return fit;
}

TEST(ChooseLaw, TakesTheBestOnlyWhereItIsTold) {
  std::vector<LawFit> fits = {fit_of(pb::LAW_COROTATED, 100, 0),
                              fit_of(pb::LAW_NEO_HOOKE, 97.5, 0.2),
                              fit_of(pb::LAW_ST_VENANT_KIRCHHOFF, 108, -0.3)};
  EXPECT_EQ(choose_law(fits, pb::LAW_COROTATED).law, pb::LAW_COROTATED) << "2.5 tell nothing";
  fits[1].cost = 90;
  EXPECT_EQ(choose_law(fits, pb::LAW_COROTATED).law, pb::LAW_NEO_HOOKE);
  // The believed law could not be simulated.
  EXPECT_EQ(choose_law({fits[1], fits[2]}, pb::LAW_COROTATED).law, pb::LAW_NEO_HOOKE);
}

TEST(WidenOverLaws, IntervalsHoldForTheLawsThatAreAlike) {
  std::vector<LawFit> fits = {fit_of(pb::LAW_COROTATED, 100, 0), fit_of(pb::LAW_NEO_HOOKE, 98, 0.2),
                              fit_of(pb::LAW_ST_VENANT_KIRCHHOFF, 104, -0.3)};
  const auto alike = laws_alike(fits, fits[0], kNumerics);
  ASSERT_EQ(alike.size(), 1U);
  EXPECT_EQ(alike[0]->law, pb::LAW_NEO_HOOKE);
  FitPosterior posterior;
  posterior.shared_covariance = 0.0025 * Eigen::MatrixXd::Identity(8, 8);
  posterior.own_sd.assign(1, VectorXd::Constant(3, 0.01));
  widen_over_laws(fits[0], alike, {0}, posterior);
  // Two laws as likely, 0.2 apart: the interval of the one reaches over the other.
  EXPECT_NEAR(posterior.shared_covariance(0, 0), 0.0025 + 0.02, 1e-12);
  EXPECT_GT(1.645 * std::sqrt(posterior.shared_covariance(0, 0)), 0.2);
  EXPECT_EQ(posterior.shared_covariance(1, 1), 0.0025);
  EXPECT_NEAR(posterior.own_sd[0][1], std::sqrt(1e-4 + 0.005), 1e-12);
  EXPECT_EQ(posterior.own_sd[0][0], 0.01);
  EXPECT_EQ(laws_alike(fits, fits[0], 5e-4).size(), 2U) << "apart by less than the mesh is off";
  // Told: nothing widens.
  fits[1].cost = 103.5;
  EXPECT_TRUE(laws_alike(fits, fits[0], kNumerics).empty());
}

}  // namespace
}  // namespace omentum

// What a finished fit is said to have found, in words.
#include "mismatch/calibrate/findings.h"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "report/section_parts.h"
#include "support/fitted_sheet.h"

namespace omentum {
namespace {

using test::FittedSheet;
using testing::AllOf;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

const std::string kBending = "scene.tissue.effects.bending_change";

struct FoundSheet : FittedSheet {
  SearchState found = improved();
  FitPosterior posterior = posterior_at(*data, linear, which, {}, found);
  Calibration result;

  Eigen::Index place_of(const std::string& path) const {
    return std::ranges::find(data->unknowns, path, &Unknown::path) - data->unknowns.begin();
  }
  const Unknown& unknown(const std::string& path) const {
    return data->unknowns[static_cast<std::size_t>(place_of(path))];
  }
  const std::vector<std::string>& warnings() {
    result = {};
    result.scene = shared_scene(*data, found.state);
    const Findings findings{*data, found, posterior, which, {}, 0, 0, 0};
    add_numbers(findings, result);
    add_warnings(findings, result);
    return result.warnings;
  }
};

TEST(Findings, AThicknessAtItsBoundIsWarnedOfByName) {
  FoundSheet c;
  const Unknown& thickness = c.unknown(kThicknessPath);
  c.found.state.shared[c.place_of(kThicknessPath)] = range_of(thickness).high;
  EXPECT_THAT(c.warnings(), Contains(AllOf(HasSubstr(kThicknessPath), HasSubstr("bound"))));
  EXPECT_NEAR(c.result.scene.tissue().thickness_m(), thickness.value(range_of(thickness).high),
              1e-9)
      << "and stands in the scene";
}

TEST(Findings, AWeakWordAgainstAFirmBeliefIsToldWhereItSpeaksClearly) {
  FoundSheet c;
  const auto k = c.place_of(kThicknessPath);
  const double sd = c.unknown(kThicknessPath).sd;
  // The recordings leave 0.8 of the belief's standard deviation: alone they say x / 0.36 with 4/3.
  c.posterior.shared_covariance(k, k) = 0.64 * sd * sd;
  c.found.state.shared[k] = -1.2 * sd;
  EXPECT_THAT(c.warnings(), Not(Contains(StartsWith(kThicknessPath))));
  c.found.state.shared[k] = -1.6 * sd;
  EXPECT_THAT(c.warnings(), Contains(StartsWith(kThicknessPath)));
}

TEST(Findings, AStiffnessIsToldInKilopascalWithTheDigitsOfItsInterval) {
  FoundSheet c;
  const std::string path = "scene.tissue.material.young_modulus_pa";
  const auto k = c.place_of(path);
  const Unknown& stiffness = c.unknown(path);
  constexpr double kSeenTo = 0.03;  // in the logarithm
  c.posterior.shared_covariance(k, k) = kSeenTo * kSeenTo;
  c.found.state.shared[k] = 2.6 * stiffness.sd;
  const double pascal = stiffness.value(c.found.state.shared[k]);
  const double spread = std::exp(1.6448536 * kSeenTo);
  const auto told =
      AllOf(StartsWith(path + " (stiffness): "),
            HasSubstr(number_in_line(pascal, pascal / spread, pascal * spread, "Pa")),
            HasSubstr(" kPa ("), HasSubstr("against the belief of"), Not(HasSubstr(" Pa")));
  EXPECT_THAT(c.warnings(), Contains(told));
}

TEST(Findings, ASurpriseNamesWhatItMayBeInstead) {
  FoundSheet c;
  const auto b = c.place_of(kBending), t = c.place_of(kThicknessPath);
  const double sd_b = c.unknown(kBending).sd, sd_t = c.unknown(kThicknessPath).sd;
  c.found.state.shared[b] = -2 * sd_b;
  c.posterior.shared_covariance(b, b) = 0.5 * sd_b * sd_b;
  c.posterior.shared_covariance(b, t) = c.posterior.shared_covariance(t, b) = -0.4 * sd_b * sd_t;
  EXPECT_THAT(c.warnings(),
              Contains(AllOf(StartsWith(kBending),
                             testing::EndsWith(std::string("measure it or ") + kThicknessPath))));
}

TEST(Findings, AThinnerBodyIsToldThoughTheBeliefInItsBendingHidesIt) {
  FoundSheet c;
  const auto b = c.place_of(kBending), t = c.place_of(kThicknessPath);
  // Recordings that see 2 thickness + bending, in logarithms, to 4 %, and nothing else of the two.
  constexpr double kSeenTo = 0.04;
  const Eigen::Vector2d seen(2, 1);
  const Eigen::Vector2d sd(c.unknown(kThicknessPath).sd, c.unknown(kBending).sd);
  Eigen::Matrix2d precision = sd.cwiseAbs2().cwiseInverse().asDiagonal();
  precision += seen * seen.transpose() / (kSeenTo * kSeenTo);
  c.posterior.shared_covariance.setIdentity() *= 1e-4;
  c.posterior.shared_covariance({t, b}, {t, b}) = precision.inverse();
  for (const double thinner : {0.8, 0.95}) {
    const Eigen::Vector2d x =
        precision.inverse() * seen * (2 * std::log(thinner) / (kSeenTo * kSeenTo));
    c.found.state.shared[t] = x[0];
    c.found.state.shared[b] = x[1];
    EXPECT_LT(std::fabs(x[0]), sd[0] * 2.5) << "not by what is believed of the thickness alone";
    const std::string told =
        fmt::format("make it {:.1f}", 1e3 * thinner * c.unknown(kThicknessPath).believed);
    const auto is_told =
        Contains(AllOf(StartsWith(kThicknessPath), HasSubstr(told), HasSubstr(") thick, ")));
    if (thinner == 0.8) {
      EXPECT_THAT(c.warnings(), is_told);
    } else {
      EXPECT_THAT(c.warnings(), Not(Contains(StartsWith(kThicknessPath))));
    }
  }
}

TEST(FinishScene, KeepsTheFittedLawUnlessNoPolicyCanBeTrainedInIt) {
  FoundSheet c;
  for (const auto& [fitted, written] : {std::pair{pb::LAW_COROTATED, pb::LAW_COROTATED},
                                        {pb::LAW_NEO_HOOKE, pb::LAW_NEO_HOOKE},
                                        {pb::LAW_ST_VENANT_KIRCHHOFF, pb::LAW_COROTATED}}) {
    Calibration result;
    result.scene = shared_scene(*c.data, c.found.state);
    result.scene.mutable_tissue()->mutable_material()->set_law(fitted);
    finish_scene({*c.data, c.found, c.posterior, c.which, {}, 0, 0, 0}, result);
    EXPECT_EQ(result.scene.tissue().material().law(), written);
    EXPECT_EQ(result.warnings.empty(), fitted == written);
  }
}

}  // namespace
}  // namespace omentum

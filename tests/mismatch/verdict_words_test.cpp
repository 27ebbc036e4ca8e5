// What a verdict says of nuisances and numerics: words, and one line for what is alike.
#include "mismatch/explain/verdict_words.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "mismatch/calibrate/number_words.h"
#include "mismatch/fit/fit_numbers.h"
#include "support/fitted_sheet.h"

namespace omentum {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

Pull pull_of(const std::string& owner, const std::string& key, double size) {
  return {key, owner, NumberRole::kNuisance, 0, size};
}

TEST(VerdictWords, EveryNuisanceOfAFitHasWords) {
  const test::FittedSheet sheet;
  for (const FitNumber& number : numbers_of(*sheet.data)) {
    if (number.role == NumberRole::kNuisance && !number.name.starts_with("scene.")) {
      EXPECT_THAT(nuisance_words(number.name), Not(HasSubstr("."))) << number.name;
    }
  }
  EXPECT_EQ(nuisance_words("scene.tissue.thickness_m"), "scene.tissue.thickness_m");
}

TEST(VerdictWords, PullsOfOneKindInARecordingAreOneLineWithTheLargest) {
  const std::vector<Pull> pulls = {pull_of("r08", "discrepancy.with_lift[25]", 7.62),
                                   pull_of("r00", "discrepancy.with_lift[25]", 6.7),
                                   pull_of("r08", "discrepancy.with_lift[24]", -5.9),
                                   pull_of("r08", "discrepancy.with_lift[1]", -5.1),
                                   pull_of("", "registration.turn_x", -4.5),
                                   pull_of("r08", "discrepancy.with_lift_squared[1]", 4.4),
                                   pull_of("r08", "discrepancy.with_lift[2]", 3.9)};
  EXPECT_THAT(
      pull_lines(pulls, 4),
      ElementsAre(
          "r08: the smooth difference that grows with the lift is 7.6 standard deviations "
          "from what was believed, and 2 more like it",
          "r00: the smooth difference that grows with the lift is 6.7 standard deviations "
          "from what was believed",
          "the turn of the camera about x is 4.5 standard deviations from what was believed",
          HasSubstr("with the square of the lift")));
  EXPECT_THAT(pull_lines(pulls, 8), IsEmpty());
}

TEST(VerdictWords, AGainIsToldFromTheThresholdThatItMisses) {
  EXPECT_EQ(nats(5.3), "5.3");
  EXPECT_EQ(nats(6), "6.0");
  EXPECT_EQ(nats(6.3), "6.3");
  EXPECT_EQ(nats(9.97), "10");
  EXPECT_EQ(nats(131.5), "132");
  EXPECT_EQ(nats(-0.3), "-0.3");
}

TEST(VerdictWords, AHeldOutRecordingThatIsFartherOffSpeaksAgainstAClaim) {
  pb::Verdict verdict;
  const auto add = [&](const char* recording, const char* role, double r) {
    pb::VerdictFit& row = *verdict.add_fit();
    row.set_recording(recording);
    row.set_role(role);
    row.set_rmse_base(0.0004);
    row.set_rmse_model(0.0005);
    row.set_r(r);
  };
  add("r00", "fit", 2);                     // was fitted
  add("r01", "held_out", 1.05);             // within a tenth
  verdict.add_fit()->set_role("held_out");  // as near as is known before: nothing to explain
  EXPECT_THAT(contradiction_text(verdict), IsEmpty());
  add("r02", "held_out", 1.6);
  EXPECT_EQ(contradiction_text(verdict),
            "r02, which was held out, is farther off with it, by 0.50 mm instead of 0.40");
}

TEST(VerdictWords, AClaimThatForetellsHeldOutRecordingsWorseTogetherIsNone) {
  pb::Verdict verdict;
  const auto add = [&](const char* role, double before, double after) {
    pb::VerdictFit& row = *verdict.add_fit();
    row.set_role(role);
    row.set_rmse_base(before);
    row.set_rmse_model(after);
    row.set_floor(1e-4);
    row.set_r((after * after - 1e-8) / (before * before - 1e-8));
  };
  EXPECT_FALSE(foretells_worse(verdict));  // nothing was held out
  add("fit", 2e-4, 9e-4);
  add("held_out", 3e-4, 4e-4);
  EXPECT_TRUE(foretells_worse(verdict));
  add("held_out", 6e-4, 3e-4);  // explains more than the other loses
  EXPECT_FALSE(foretells_worse(verdict));
}

TEST(VerdictWords, AKeyInATableStandsBesideItsWords) {
  EXPECT_EQ(named_nuisance("r08: discrepancy.with_lift[25]"),
            "r08: discrepancy.with_lift[25], the smooth difference that grows with the lift");
  EXPECT_EQ(named_nuisance("scene.tissue.material.young_modulus_pa"),
            "scene.tissue.material.young_modulus_pa (stiffness)");
  EXPECT_EQ(named_nuisance("r1: nobodys"), "r1: nobodys");
}

}  // namespace
}  // namespace omentum

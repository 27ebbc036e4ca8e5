#include "core/psm_instrument.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/LU>
#include <set>
#include <string>

#include "core/check.h"
#include "core/psm.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using testing::Not;

TEST(PsmInstruments, EachIsFoundByItsNameAndByItsNumber) {
  std::set<std::string> names;
  for (const PsmInstrument& instrument : psm_instruments()) {
    EXPECT_EQ(&find_instrument(instrument.name), &instrument);
    EXPECT_EQ(&find_instrument(instrument.number), &instrument);
    names.insert(instrument.name);
    names.insert(instrument.number);
  }
  EXPECT_EQ(names.size(), 2 * psm_instruments().size());
  EXPECT_EQ(psm_instruments().size(), 12U);
  EXPECT_STREQ(large_needle_driver().number, "400006");
}

TEST(PsmInstruments, AnUnknownNameIsOneLineWithAllNames) {
  try {
    find_instrument("scissors");
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("instrument: scissors, allowed: "));
    EXPECT_THAT(error.what(), Not(HasSubstr("\n")));
    for (const PsmInstrument& instrument : psm_instruments())
      EXPECT_THAT(error.what(), HasSubstr(instrument.name));
  }
}

TEST(PsmInstruments, AnSiInstrumentDiffersFromItsClassicOneInTheShaft) {
  for (const PsmInstrument& classic : psm_instruments()) {
    if (classic.number[1] == '2') continue;
    const PsmInstrument& si = find_instrument(std::string(classic.name) + "_si");
    EXPECT_EQ(std::string(classic.number).substr(2), std::string(si.number).substr(2));
    EXPECT_EQ(classic.tool_length, 0.4162);
    EXPECT_EQ(si.tool_length, 0.4670);
    EXPECT_EQ(classic.pitch_to_yaw, si.pitch_to_yaw);
    EXPECT_EQ(classic.joints_of_discs, si.joints_of_discs);
    EXPECT_EQ(classic.effort_limits, si.effort_limits);
  }
}

TEST(PsmInstruments, LimitsAreThoseOfTheInstrument) {
  const PsmJoints bent = {0, 0, 0.12, 0, 1.3, 0};
  EXPECT_EQ(psm_limit_violation(bent, find_instrument("cadiere")), "");
  EXPECT_THAT(psm_limit_violation(bent, find_instrument("maryland_bipolar")),
              HasSubstr("wrist_pitch at 1.3, allowed -1.2217 ... 1.2217"));
  const PsmJoints aside = {0, 0, 0.12, 0, 0, 1.5};
  EXPECT_EQ(psm_limit_violation(aside, find_instrument("fenestrated_bipolar_si")), "");
  EXPECT_NE(psm_limit_violation(aside, find_instrument("prograsp")), "");
  // The wrist of an Si instrument is deeper at the same insertion.
  const PsmJoints shallow = {0, 0, 0.02, 0, 0, 0};
  EXPECT_NE(psm_limit_violation(shallow, find_instrument("debakey")), "");
  EXPECT_EQ(psm_limit_violation(shallow, find_instrument("debakey_si")), "");
  for (const PsmInstrument& instrument : psm_instruments()) {
    EXPECT_LT(instrument.jaw.min, 0);  // a jaw grips by going below 0
    EXPECT_EQ(instrument.jaw.max, 1.396);
  }
}

TEST(PsmInstruments, CouplingRowsGiveTheRecordedWristEfforts) {
  // docs/dvrk.md 1.1: joints moving at one velocity against D = 0.09 of each disc.
  const Eigen::Matrix4d joints_of_discs = large_needle_driver().disc_coupling();
  const Eigen::Vector4d velocity(0.0271951, 0.0271951, 0.0271951, 0);
  const Eigen::Vector4d discs = joints_of_discs.inverse() * velocity;
  const Eigen::Vector4d efforts = joints_of_discs.inverse().transpose() * (-0.09 * discs);
  EXPECT_NEAR(efforts[0], -0.001002, 1e-6);  // the record has six digits
  EXPECT_NEAR(efforts[1], -0.007245, 1e-6);
  EXPECT_NEAR(efforts[2], -0.005992, 1e-6);
}

TEST(PsmInstruments, EveryCouplingIsSolvableAndMovesTheJawByTwoDiscsAgainstEachOther) {
  for (const PsmInstrument& instrument : psm_instruments()) {
    const Eigen::Matrix4d coupling = instrument.disc_coupling();
    EXPECT_GT(std::abs(coupling.determinant()), 0.1) << instrument.name;
    const Eigen::Vector4d opened = coupling * Eigen::Vector4d(0, 0, -1, 1);
    EXPECT_EQ(opened.head<3>(), Eigen::Vector3d::Zero()) << instrument.name;
    EXPECT_GT(opened[3], 0);
  }
}

TEST(CheckInstrument, AcceptsEveryInstrumentThatMovesAlike) {
  const PsmJoints q = {0.5, -0.3, 0.15, 1.2, -0.7, 0.4};
  for (const PsmInstrument& held : psm_instruments()) {
    const PsmPose pose = psm_forward(q, held);
    for (const PsmInstrument& named : psm_instruments()) {
      const bool alike =
          held.tool_length == named.tool_length && held.pitch_to_yaw == named.pitch_to_yaw;
      EXPECT_EQ(check_instrument(q, pose, named).has_value(), alike)
          << held.name << " " << named.name;
    }
  }
}

TEST(CheckInstrument, NamesBothToolLengthsAndWhatItLooksLike) {
  // Straight and bent wrist: with the straight one shaft and wrist lengths only add up.
  for (const PsmJoints& q : {PsmJoints{0, 0, 0.12, 0, 0, 0}, {0.5, -0.3, 0.15, 1.2, -0.7, 0.4}}) {
    const PsmPose pose = psm_forward(q, find_instrument("prograsp_si"));
    const Result<void> checked = check_instrument(q, pose, large_needle_driver());
    ASSERT_FALSE(checked.has_value());
    EXPECT_THAT(checked.error(), HasSubstr("large_needle_driver has tool length 0.4162 m"));
    EXPECT_THAT(checked.error(), HasSubstr("computes with tool length 0.4670 m"));
    EXPECT_THAT(checked.error(),
                HasSubstr("prograsp_si or fenestrated_bipolar_si or maryland_bipolar_si"));
  }
}

TEST(CheckInstrument, MeasuresALengthThatNoInstrumentHas) {
  PsmInstrument longer = large_needle_driver();
  longer.tool_length = 0.4300;
  const PsmJoints q = {0.5, -0.3, 0.15, 1.2, -0.7, 0.4};
  const Result<void> checked = check_instrument(q, psm_forward(q, longer), large_needle_driver());
  ASSERT_FALSE(checked.has_value());
  EXPECT_THAT(checked.error(), HasSubstr("tool length 0.4300 m or another wrist"));
  EXPECT_THAT(checked.error(), HasSubstr("no instrument known"));
}

TEST(CheckInstrument, TellsATurnedPoseFromAWrongInstrument) {
  const PsmJoints q = {0.5, -0.3, 0.15, 1.2, -0.7, 0.4};
  const PsmPose other = psm_forward({0.5, -0.3, 0.15, 1.2, -0.7, 0.5});
  const Result<void> checked = check_instrument(q, other, large_needle_driver());
  ASSERT_FALSE(checked.has_value());
  EXPECT_THAT(checked.error(), HasSubstr("turned"));
}

TEST(CheckInstrument, AcceptsTheTextbookThetaOffsets) {
  const PsmJoints q = {0.5, -0.3, 0.15, 1.2, -0.7, 0.4};
  const PsmPose pose = psm_forward(q, large_needle_driver(), 1.5707963267948966);
  EXPECT_TRUE(check_instrument(q, pose, large_needle_driver()).has_value());
}

TEST(PsmSolve, RefusesWhatIsNotFinite) {
  PsmPose pose = psm_forward({0, 0, 0.12, 0, 0, 0});
  pose.p.x() = std::nan("");
  EXPECT_NE(psm_solve(pose).fault, InverseFault::kNone);
  pose = psm_forward({0, 0, 0.12, 0, 0, 0});
  pose.R(1, 1) = std::nan("");
  EXPECT_EQ(psm_solve(pose).fault, InverseFault::kNotOrthonormal);
}

}  // namespace
}  // namespace omentum

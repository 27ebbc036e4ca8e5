// What goes into a fit: recordings that are held out by name, numbers that are not looked for.
#include "mismatch/calibrate/case_input.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>

#include "core/check.h"
#include "core/config.h"
#include "mismatch/fit/unknowns.h"

namespace omentum {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

TEST(HoldOut, NamesAndBeginsOfNamesAreHeldOutAndOthersAreRefused) {
  CaseInput input;
  for (const char* name : {"lift1", "lift2", "push"})
    input.recordings.emplace_back(name, Recording());
  hold_out({"push"}, input);
  EXPECT_TRUE(input.recordings[2].second.info.held_out());
  EXPECT_FALSE(input.recordings[0].second.info.held_out());
  hold_out({"lift*"}, input);
  EXPECT_TRUE(input.recordings[0].second.info.held_out());
  EXPECT_TRUE(input.recordings[1].second.info.held_out());
  try {
    hold_out({"pull"}, input);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(),
                HasSubstr("--held-out: no recording is called pull, there are lift1"));
  }
}

TEST(Unknowns, WhatIsBelievedToBeZeroIsToldOrLookedForByItsStandardDeviation) {
  constexpr const char* kPath = "scene.tissue.material.damping_per_s";
  pb::Scene scene;
  scene.mutable_tissue()->mutable_material()->set_damping_per_s(0);
  scene.mutable_tissue()->set_dynamic_friction(0);
  scene.add_rigid_body();
  EXPECT_THAT(told_not_looked_for(scene, {}),
              ElementsAre(HasSubstr("damping is not looked for"), HasSubstr("friction")));
  const auto has_damping = [&](const pb::Priors& priors) {
    const std::vector<Unknown> list = unknowns_of(scene, priors, false);
    return std::ranges::find(list, kPath, &Unknown::path) != list.end();
  };
  EXPECT_FALSE(has_damping({}));
  pb::Priors priors;
  pb::Prior& prior = *priors.add_prior();
  prior.set_path(kPath);
  prior.set_sd(0.5);
  scene.mutable_tissue()->set_dynamic_friction(0.3);
  EXPECT_THAT(told_not_looked_for(scene, priors), IsEmpty());
  EXPECT_TRUE(has_damping(priors));
  for (const Unknown& unknown : unknowns_of(scene, priors, false)) {
    if (unknown.path != kPath) continue;
    EXPECT_EQ(unknown.sd, 0.5);
    EXPECT_EQ(unknown.value(0.2), 0.2) << "no factor of zero";
    EXPECT_GE(unknown.value(range_of(unknown).low), 0);
  }
}

}  // namespace
}  // namespace omentum

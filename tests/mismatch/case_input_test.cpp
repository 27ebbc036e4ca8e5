// What goes into a fit: recordings of which some cannot be read, that are held out by name, numbers
// that are not looked for.
#include "mismatch/calibrate/case_input.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/config.h"
#include "core/ply.h"
#include "mismatch/fit/unknowns.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

namespace fs = std::filesystem;

/// A folder of recordings a, b and c that look at a sheet at rest.
class ThreeRecordings : public testing::Test {
 protected:
  ThreeRecordings() {
    Cloud cloud;
    for (const Eigen::Vector3d& p : made_.tissue.particles)
      cloud.push_back((made_.tissue.X_WB * p).cast<float>());
    for (const char* name : {"a", "b", "c"}) {
      fs::create_directories(folder_ / name + "/clouds");
      write(std::string(name) + "/tool.csv", kRows);
      write(std::string(name) + "/clouds/0.ply", encode_ply(cloud));
      write(std::string(name) + "/clouds.csv", "t_s,file\n0.5,clouds/0.ply\n");
    }
  }
  void write(const std::string& file, const std::string& bytes) const {
    std::ofstream(folder_ / file, std::ios::binary) << bytes;
  }
  void cut_cloud(const std::string& recording) const {
    const std::string file = folder_ / recording + "/clouds/0.ply";
    fs::resize_file(file, fs::file_size(file) - 5);
  }
  CaseInput read(const std::vector<std::string>& names) const {
    std::vector<std::string> paths;
    for (const std::string& name : names) paths.push_back(folder_ / name);
    return read_case(paths, kScene, {});
  }
  /// Names of the observations; their warnings are in `input`.
  std::vector<std::string> observe(CaseInput& input) const {
    MarkerNotes notes;
    std::vector<std::string> names;
    for (const Observation& seen : observe_case(input, made_, {}, notes, input.warnings))
      names.push_back(seen.name);
    return names;
  }
  template <typename Call>
  static std::string refusal(Call call) {
    try {
      call();
    } catch (const Error& error) {
      return error.what();
    }
    return "none";
  }

  static constexpr const char* kRows =
      "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n"
      "0,0,0,0.1,0.4\n1,0,0,0.1,0.4\n";
  static constexpr const char* kCut =
      "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n"
      "0,0,0,0.1,0.4\n1,0,0";
  const std::string kScene = deploy_dir() + "/scenes/omentum.txtpb";
  const Scene made_ = make_scene(load_scene(kScene, {}), "");
  test::TempDir folder_;
};

TEST_F(ThreeRecordings, OneOfAFolderThatCannotBeReadIsLeftOutWithItsFileAndLine) {
  write("b/tool.csv", kCut);
  CaseInput input = read({""});
  EXPECT_THAT(observe(input), ElementsAre("a", "c"));
  EXPECT_THAT(input.warnings,
              Contains(AllOf(HasSubstr("b/tool.csv:3"), HasSubstr("left out"))).Times(1));
  write("b/tool.csv", kRows);
  write("a/clouds.csv", "t_s,file\n0.5,clouds/1.ply\n");
  input = read({""});
  EXPECT_THAT(observe(input), ElementsAre("b", "c"));
  EXPECT_THAT(input.warnings, Contains(HasSubstr("a/clouds.csv:2")));
}

TEST_F(ThreeRecordings, OneOfAFolderWithACloudThatCannotBeReadIsLeftOutWithItsFile) {
  cut_cloud("b");
  CaseInput input = read({""});
  EXPECT_THAT(observe(input), ElementsAre("a", "c"));
  EXPECT_THAT(input.warnings,
              Contains(AllOf(HasSubstr("b/clouds/0.ply"), HasSubstr("left out"))).Times(1));
}

TEST_F(ThreeRecordings, WhereNoneCanBeReadTheFirstFaultIsTheRefusal) {
  for (const char* name : {"a", "b", "c"}) cut_cloud(name);
  EXPECT_THAT(refusal([&] {
                CaseInput input = read({""});
                observe(input);
              }),
              HasSubstr("a/clouds/0.ply"));
  for (const char* name : {"a", "b", "c"}) write(std::string(name) + "/tool.csv", kCut);
  EXPECT_THAT(refusal([&] { read({""}); }), HasSubstr("a/tool.csv:3"));
}

TEST_F(ThreeRecordings, OneThatWasNamedItselfIsRefusedBesideOthersToo) {
  cut_cloud("b");
  EXPECT_THAT(refusal([&] {
                CaseInput input = read({"a", "b"});
                observe(input);
              }),
              HasSubstr("b/clouds/0.ply"));
  write("b/tool.csv", kCut);
  for (const std::vector<std::string>& named : {std::vector<std::string>{"b"}, {"a", "b"}})
    EXPECT_THAT(refusal([&] { read(named); }), HasSubstr("b/tool.csv:3"));
}

TEST_F(ThreeRecordings, OneToBeHeldOutThatWasLeftOutIsRefusedWithTheReason) {
  write("b/tool.csv", kCut);
  CaseInput input = read({""});
  for (const char* name : {"b", "b*"}) {
    EXPECT_THAT(refusal([&] { hold_out({name}, input); }),
                AllOf(HasSubstr(std::string("--held-out ") + name + ": the recording b cannot be"),
                      HasSubstr("left out: "), HasSubstr("b/tool.csv:3")));
  }
  hold_out({"*"}, input);  // others of the kind are there
  EXPECT_TRUE(input.recordings[0].second.info.held_out());
}

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

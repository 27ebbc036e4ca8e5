// mismatch as a process: wrong input and a full disk end in one line and exit code 2, and leave
// nothing.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <sstream>

#include "core/config.h"
#include "support/process.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using Strings = std::vector<std::string>;

std::string text_of(const std::string& path) {
  std::ostringstream text;
  text << std::ifstream(path, std::ios::binary).rdbuf();
  return text.str();
}

class MismatchProgram : public testing::Test {
 protected:
  MismatchProgram() {
    std::filesystem::create_directory(folder_ / "commands");
    std::ofstream(folder_ / "commands/tool.csv")
        << "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n"
           "0,0.0154,0.0521,0.0236,0.4\n0.1,0.0154,0.0521,0.0236,0\n0.2,0.0154,0.0521,0.04,0\n";
  }

  Strings arguments(const Strings& more = {}, const std::string& scene = "") const {
    Strings all = {OMENTUM_MISMATCH,
                   "simulate",
                   "--scene",
                   scene.empty() ? deploy_dir() + "/scenes/omentum.txtpb" : scene,
                   "--commands",
                   folder_ / "commands",
                   "-o",
                   folder_ / "out"};
    all.insert(all.end(), more.begin(), more.end());
    return all;
  }
  int run(const Strings& program, const std::string& out = "") {
    test::Process process(program, out.empty() ? folder_ / "stdout" : out, folder_ / "stderr");
    return process.wait(std::chrono::seconds(100)).value_or(-1);
  }
  void expect_refused(const Strings& program, const Strings& parts) {
    EXPECT_EQ(run(program), 2);
    const std::string said = text_of(folder_ / "stderr");
    EXPECT_EQ(std::count(said.begin(), said.end(), '\n'), 1) << said;
    for (const std::string& part : parts) EXPECT_THAT(said, HasSubstr(part));
    for (const auto& entry : std::filesystem::directory_iterator(folder_.path()))
      EXPECT_NE(entry.path().filename().string().substr(0, 3), "out") << said;
  }
  /// Scene omentum with one piece of text in place of another.
  std::string scene_with(const std::string& old, const std::string& text) const {
    std::string scene = text_of(deploy_dir() + "/scenes/omentum.txtpb");
    const std::size_t at = scene.find(old);
    EXPECT_NE(at, std::string::npos) << old;
    std::ofstream(folder_ / "scene.txtpb") << scene.replace(at, old.size(), text);
    return folder_ / "scene.txtpb";
  }

  test::TempDir folder_;
};

TEST_F(MismatchProgram, NumbersOfOptionsAreRefusedOutsideTheirRange) {
  for (const std::string value : {"nan", "-nan", "inf", "1", "0.005x", ""}) {
    expect_refused(arguments({"--patch-radius", value}),
                   {"--patch-radius", value, "allowed 0.0001 ... 0.05"});
  }
  expect_refused(arguments({"--closed", "nan"}), {"--closed", "nan", "allowed 0 ... 3.2"});
  expect_refused(arguments({"--cloud-rate", "nan"}), {"--cloud-rate", "nan", "allowed 0 ... 1000"});
  expect_refused(arguments({"--cloud-rate", "60"}), {"--cloud-rate: 60 Hz, allowed 0 ... 50"});
  for (const std::string value : {"-1", "1e3", "99999999999999999999", ""})
    expect_refused(arguments({"--seed", value}), {"--seed", value, "allowed 0 ..."});
}

TEST_F(MismatchProgram, ARunThatCannotBeJoinedIsRefusedBeforeAnythingIsMade) {
  expect_refused(arguments({"--run", "a b"}), {"run.name \"a b\""});
  expect_refused(arguments({"--run", "r", "--discovery", "mesh"}), {"--discovery mesh", "--peers"});
  expect_refused(arguments({"--run", "r", "--domain", "999"}), {"--domain", "999", "0 to 230"});
  expect_refused(arguments({"--run", "r", "--security-dir", "none"}), {"none"});
}

TEST_F(MismatchProgram, ScenesThatCannotBeMeantAreRefusedWithTheirPlace) {
  const std::string file = folder_ / "scene.txtpb";
  expect_refused(arguments({}, scene_with("format_version: 1", "format_version: 99")),
                 {file + ":2:1: scene.format_version: 99, allowed 1"});
  expect_refused(arguments({}, scene_with("x: 0.0109 y", "x: 36 y")),
                 {file + ":54:3: scene.rigid_body[1].pose: the tumour is 36 m from the tissue"});
  expect_refused(arguments({}, scene_with("x: 0.0109 y", "x: nan y")),
                 {file + ":54:10: scene.rigid_body[1].pose.translation_m: component nan"});
  expect_refused(arguments({}, scene_with("\ncamera {", "\nbody {")),
                 {file + ":34:", "position_m"});
  expect_refused(arguments({}, "/dev/zero"), {"/dev/zero: cannot be opened"});
  expect_refused(arguments({"--model", "reference", "--set",
                            "scene.tissue.reference={ elements_x: 200 elements_y: 200 elements_z: "
                            "20 }"}),
                 {"omentum.txtpb", "200 x 200 x 20 elements need", "GB of memory, allowed"});
}

TEST_F(MismatchProgram, MeshesLieBesideTheirSceneAndFaceOutside) {
  std::ofstream(folder_ / "box.obj") << "v 0 0 0\nv .01 0 0\nv .01 .01 0\nv 0 .01 0\n"
                                        "v 0 0 .01\nv .01 0 .01\nv .01 .01 .01\nv 0 .01 .01\n"
                                        "f 1 2 3 4\nf 5 8 7 6\nf 1 5 6 2\nf 2 6 7 3\n"
                                        "f 3 7 8 4\nf 4 8 5 1\n";
  const auto with_mesh = [&](const std::string& path) {
    return arguments(
        {}, scene_with("workspace_min_m", R"(rigid_body { name: "box" mesh { path: ")" + path +
                                              "\" }\n  pose { translation_m { x: -0.06 y: 0.1 "
                                              "z: 0.001 } } }\nworkspace_min_m"));
  };
  expect_refused(with_mesh("box.obj"),
                 {folder_ / "box.obj: the mesh is inside out, volume -1e-06"});
  expect_refused(with_mesh("."), {folder_ / "scene.txtpb:", "/.", "is no regular file"});
  expect_refused(with_mesh("/dev/zero"), {"/dev/zero", "is no regular file"});
  expect_refused(with_mesh("none.obj"), {folder_ / "none.obj: cannot be opened"});
}

TEST_F(MismatchProgram, RecordingsGoInAndOutUnchanged) {
  ASSERT_EQ(run(arguments({"--cloud-rate", "25"})), 0) << text_of(folder_ / "stderr");
  const Strings in = {OMENTUM_MISMATCH, "import", folder_ / "out", "-o", folder_ / "a.mcap"};
  ASSERT_EQ(run(in), 0) << text_of(folder_ / "stderr");
  EXPECT_THAT(text_of(folder_ / "stdout"), HasSubstr("clouds 6"));
  ASSERT_EQ(run({OMENTUM_MISMATCH, "export", folder_ / "a.mcap", "-o", folder_ / "back"}), 0);
  ASSERT_EQ(run({OMENTUM_MISMATCH, "info", folder_ / "a.mcap"}), 0);
  EXPECT_THAT(text_of(folder_ / "stdout"),
              HasSubstr("/tool_commanded: 11 samples, 0 ... 0.2 s, 50 Hz"));
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder_ / "out")) {
    if (!entry.is_regular_file()) continue;
    const auto name = std::filesystem::relative(entry.path(), folder_ / "out").string();
    EXPECT_EQ(text_of(entry.path()), text_of(folder_ / ("back/" + name))) << name;
    ++files;
  }
  EXPECT_EQ(files, 5 + 6);  // recording, tool, force, markers, clouds and each of them
  ASSERT_EQ(run({OMENTUM_MISMATCH, "import", folder_ / "back", "-o", folder_ / "b.mcap"}), 0);
  EXPECT_EQ(text_of(folder_ / "a.mcap"), text_of(folder_ / "b.mcap"));
}

TEST_F(MismatchProgram, NothingIsHalfImported) {
  std::ofstream(folder_ / "commands/force.csv") << "t_s,fx_N,fy_N,fz_N\n0,1,2,x\n";
  for (const std::string out : {"out.mcap", "out"}) {
    expect_refused({OMENTUM_MISMATCH, "import", folder_ / "commands", "-o", folder_ / out},
                   {"force.csv:2:7: \"x\" in column fz_N is no finite number"});
  }
  expect_refused({OMENTUM_MISMATCH, "import", folder_ / "none", "-o", folder_ / "out.mcap"},
                 {"none"});
  std::ofstream(folder_ / "map.txtpb") << "source { files: \"*.csv\" }\nsource { fils: \"a\" }";
  expect_refused({OMENTUM_MISMATCH, "import", folder_ / "commands", "--map", folder_ / "map.txtpb",
                  "-o", folder_ / "out.mcap"},
                 {"map.txtpb:2:", "fils"});
  std::ofstream(folder_ / "no.mcap") << "text";
  expect_refused({OMENTUM_MISMATCH, "export", folder_ / "no.mcap", "-o", folder_ / "out"},
                 {"no.mcap", "no MCAP magic"});
}

TEST_F(MismatchProgram, AFullDiskIsNoSuccess) {
  // No file may grow beyond so many blocks of 512 bytes; the signal of that is ignored, so that
  // writes fail like those on a full disk.
  for (const std::string blocks : {"1", "100"}) {
    Strings program = {"/bin/sh", "-c", "trap '' XFSZ; ulimit -f " + blocks + "; exec \"$@\"",
                       "sh"};
    const Strings more = arguments();
    program.insert(program.end(), more.begin(), more.end());
    expect_refused(program,
                   {blocks == "1" ? "tool.csv" : "markers.csv", "cannot be written: File"});
  }
  EXPECT_EQ(run(arguments(), "/dev/full"), 2);
  EXPECT_THAT(text_of(folder_ / "stderr"), HasSubstr("standard output: cannot be written"));
}

TEST_F(MismatchProgram, AFolderOfSomebodyElseStays) {
  std::filesystem::create_directory(folder_ / "out.unfinished");
  std::ofstream(folder_ / "out.unfinished/x") << "mine";
  EXPECT_EQ(run(arguments()), 0) << text_of(folder_ / "stderr");
  EXPECT_EQ(text_of(folder_ / "out.unfinished/x"), "mine");
  EXPECT_TRUE(std::filesystem::exists(folder_ / "out/markers.csv"));
}

}  // namespace
}  // namespace omentum

// Recordings that cannot be meant: refused in one line with file, line and character, or warned of.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/config.h"
#include "core/output_folder.h"
#include "core/table.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/simulate/tool_track.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

const std::string kHeader =
    "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n";

/// Three rows over the tumour of preset omentum; the last is `last`.
std::string commands(const std::string& last = "0.2,0.0154,0.0521,0.04,0\n") {
  return kHeader + "0,0.0154,0.0521,0.0236,0.4\n0.1,0.0154,0.0521,0.0236,0\n" + last;
}

const Scene& scene() {
  static const Scene made =
      make_scene(load_scene(deploy_dir() + "/scenes/omentum.txtpb", {}), deploy_dir());
  return made;
}

/// A recording folder; what is read from it, and what is said without the path of the folder.
class RecordingInput : public testing::Test {
 protected:
  void write(const std::string& file, const std::string& text) const {
    std::ofstream(folder_ / file, std::ios::binary) << text;
  }
  void read(const std::string& tool, const std::string& info) {
    write("tool.csv", tool);
    if (!info.empty()) write("recording.txtpb", info);
    const Recording recording = read_recording_folder(folder_.path());
    warnings_ = recording.warnings;
    track_ = tool_track_of(recording, folder_.path(), scene_tool_mount(scene()), warnings_);
    check_reach(track_, scene(), warnings_);
  }
  /// The line with which a recording is refused; empty = it was read.
  std::string refusal(const std::string& tool, const std::string& info = "") {
    try {
      read(tool, info);
    } catch (const Error& error) {
      return without_folder(error.what());
    }
    return "";
  }
  /// The one warning of a recording that is read; else what happened.
  std::string warning(const std::string& tool, const std::string& info = "") {
    if (const std::string refused = refusal(tool, info); !refused.empty()) return refused;
    if (warnings_.size() != 1) return std::to_string(warnings_.size()) + " warnings";
    return without_folder(warnings_.front());
  }
  std::string without_folder(const std::string& text) const {
    EXPECT_THAT(text, StartsWith(folder_.path() + "/"));
    EXPECT_EQ(text.find('\n'), std::string::npos) << text;
    return text.substr(folder_.path().size() + 1);
  }

  test::TempDir folder_;
  ToolTrack track_;
  std::vector<std::string> warnings_;
};

TEST_F(RecordingInput, GoodOnesAreReadWithoutAWord) {
  const std::string good = commands();
  EXPECT_EQ(warning(good), "0 warnings");
  std::string windows;
  for (const char c : good) windows += c == '\n' ? std::string("\r\n") : std::string(1, c);
  EXPECT_EQ(warning(windows), "0 warnings");
  EXPECT_EQ(warning("\xef\xbb\xbf" + good), "0 warnings");
  EXPECT_EQ(track_.time.back(), 0.2) << "t_s behind a byte order mark";
  EXPECT_EQ(warning(good, "units: \"m, s, N, rad\" frame: \"W\" tool_rate_hz: 10"), "0 warnings");
  // Seconds since 1970.
  EXPECT_EQ(warning(kHeader + "1700000000,0.0154,0.0521,0.0236,0\n"
                              "1700000000.1,0.0154,0.0521,0.0236,0\n"),
            "0 warnings");
}

TEST_F(RecordingInput, UnitsAndFrameAreThoseOfTheFormat) {
  EXPECT_THAT(refusal(commands(), "name: \"a\"\nunits: \"mm\"\n"),
              StartsWith("recording.txtpb:2:1: units: \"mm\", allowed m, s, N, rad"));
  EXPECT_THAT(refusal(commands(), "units: \"m, s, N, deg\"\n"), HasSubstr("\"deg\""));
  EXPECT_THAT(refusal(commands(), "units: \"\"\n"), StartsWith("recording.txtpb:1:1: units"));
  EXPECT_EQ(refusal(commands(), "frame: \"camera\"\n"),
            "recording.txtpb:1:1: frame: \"camera\", allowed \"W\", or a transform of tool.csv");
  EXPECT_THAT(refusal(commands(), "format_version: 99\n"), HasSubstr("format_version"));
}

TEST_F(RecordingInput, AStatedTransformIsObeyed) {
  // F is turned by 90 deg about z and 10 mm beside W.
  const std::string turned =
      "transform { file: \"tool.csv\" p_m: [0.01, 0, 0] "
      "q_wxyz: [0.70710678, 0, 0, 0.70710678] }";
  const std::string in_f = kHeader + "0,0.0521,-0.0054,0.0236,0\n0.1,0.0521,-0.0054,0.0236,0\n";
  EXPECT_EQ(warning(in_f, "frame: \"camera\" " + turned), "0 warnings");
  EXPECT_NEAR((track_.p_WT[0] - Eigen::Vector3d(0.0154, 0.0521, 0.0236)).norm(), 0, 1e-9);
  const auto with = [&](const std::string& fields) {
    return refusal(commands(), "transform {\n" + fields + " }\n");
  };
  const std::string place = "p_m: [0, 0, 0] ";
  const std::string turn = "q_wxyz: [1, 0, 0, 0]";
  EXPECT_THAT(with("file: \"tol.csv\" " + place + turn),
              StartsWith("recording.txtpb:2:1: transform[0].file: \"tol.csv\", allowed tool.csv"));
  EXPECT_THAT(with("file: \"tool.csv\" p_m: [0, 0] " + turn), HasSubstr("2 numbers, allowed 3"));
  EXPECT_THAT(with("file: \"tool.csv\" p_m: [0, nan, 0] " + turn), HasSubstr("nan m, allowed"));
  EXPECT_THAT(with("file: \"tool.csv\" " + place + "q_wxyz: [1, 0, 0]"),
              HasSubstr("3 numbers, allowed 4"));
  EXPECT_THAT(with("file: \"tool.csv\" " + place + "q_wxyz: [1, 1, 0, 0]"),
              HasSubstr("transform[0].q_wxyz: length 1.41421, allowed 1"));
  const std::string once = "transform { file: \"tool.csv\" " + place + turn + " }\n";
  EXPECT_THAT(refusal(commands(), once + once), StartsWith("recording.txtpb:2:13: transform[1]"));
}

TEST_F(RecordingInput, TimeInAnotherUnitIsTold) {
  EXPECT_EQ(refusal(commands("1e9,0.0154,0.0521,0.04,0\n")),
            "tool.csv:4: 1e+09 s after the row before, allowed up to 3600 s");
  EXPECT_THAT(warning(commands("200,0.0154,0.0521,0.04,0\n")),
              StartsWith("tool.csv:4: 199.9 s after the row before, usual up to 60 s"));
  const std::string milliseconds =
      kHeader + "0,0.0154,0.0521,0.0236,0\n20,0.0154,0.0521,0.0236,0\n";
  EXPECT_THAT(warning(milliseconds),
              StartsWith("tool.csv:3: rows are 20 s apart, usual up to 1 s"));
  EXPECT_THAT(refusal(milliseconds, "tool_rate_hz: 50"), HasSubstr("is t_s in seconds?"));
  EXPECT_THAT(warning(commands(), "tool_rate_hz: 50"),
              StartsWith("tool.csv:3: rows are 0.1 s apart, tool_rate_hz"));
  std::filesystem::remove(folder_ / "recording.txtpb");
  EXPECT_THAT(refusal("t_ms" + commands().substr(3)), HasSubstr("164 m/s"));
}

TEST_F(RecordingInput, ATableWithoutTimeHasTheStatedRateOrAWarning) {
  const std::string rows = kHeader.substr(4) + "0.0154,0.0521,0.0236,0\n0.0154,0.0521,0.0236,0\n";
  EXPECT_THAT(warning(rows), StartsWith("tool.csv:1: no column t_s and no tool_rate_hz"));
  EXPECT_EQ(warning(rows, "tool_rate_hz: 100"), "0 warnings");
  EXPECT_EQ(track_.time.back(), 0.01);
}

TEST_F(RecordingInput, PlacesAndAnglesInAnotherUnitAreTold) {
  const std::string far = kHeader + "0,0.0154,0.0521,87,0\n0.1,0.0154,0.0521,87,0\n";
  EXPECT_THAT(refusal(far), StartsWith("tool.csv:2: the tip at (0.0154, 0.0521, 87) m is 86.9 m"));
  EXPECT_THAT(refusal(commands("0.2,0.0154,0.0521,87,0\n")),
              StartsWith("tool.csv:4: the tip moves at 870 m/s"));
  EXPECT_THAT(refusal(commands("0.2,0.0154,0.0521,0.04,30\n")),
              StartsWith("tool.csv:4: jaw_commanded_rad 30 rad, allowed -1.571 ... 3.142 rad"));
}

TEST_F(RecordingInput, AStartOutOfReachIsRefusedALaterPlaceIsToldOnce) {
  EXPECT_THAT(refusal(kHeader + "0,0.0154,0.0521,0.6,0\n0.1,0.0154,0.0521,0.6,0\n"),
              StartsWith("tool.csv:2: the tip at (0.0154, 0.0521, 0.6) m is out of reach"));
  EXPECT_THAT(warning(commands("0.9,0.0154,0.0521,0.3,0\n1.2,0.0154,0.0521,0.31,0\n")),
              StartsWith("tool.csv:4: the tip at (0.0154, 0.0521, 0.3) m is out of reach"));
}

TEST_F(RecordingInput, ACutOffLineIsTold) {
  EXPECT_THAT(warning(commands("0.2,0.0154,0.0521,0.04,0")),
              StartsWith("tool.csv:4: the last line has no end"));
  EXPECT_EQ(refusal(commands("0.2,0.0154,0.0521,0.0")), "tool.csv:4: row of 4 cells, needed 5");
}

TEST_F(RecordingInput, WhatIsNoTableIsRefusedInOneShortLine) {
  EXPECT_EQ(refusal(""), "tool.csv:1: no header line");
  EXPECT_EQ(refusal(kHeader + "0,0.0154,0.0521,0.0236,0\n"), "tool.csv: 1 rows, needed 2 or more");
  EXPECT_THAT(refusal(std::string(3'000'000, 'x')), HasSubstr("xxx...\" ends in no known unit"));
  EXPECT_LT(refusal(std::string(3'000'000, 'x')).size(), 200u);
  EXPECT_THAT(refusal("t\x01_\x1b[2J\n0\n"), HasSubstr("t\\x01_\\x1b[2J"));
  std::string semicolons = commands();
  std::replace(semicolons.begin(), semicolons.end(), ',', ';');
  EXPECT_THAT(refusal(semicolons), HasSubstr("separated by semicolons or tabs, needed commas"));
  EXPECT_EQ(refusal(std::string("t_s\0x_m\n", 8)),
            "tool.csv: bytes of zero, needed plain text (UTF-8)");
  const std::string tool = folder_ / "tool.csv";
  const auto read_refusal = [&] {
    try {
      read_table(tool);
    } catch (const Error& error) {
      return without_folder(error.what());
    }
    return std::string();
  };
  std::filesystem::resize_file(tool, 5'000'000'000);
  EXPECT_EQ(read_refusal(), "tool.csv: 5000000000 bytes, allowed up to 1000000000");
  for (const char* target : {"/dev/zero", "/nowhere", "."}) {
    std::filesystem::remove(tool);
    std::filesystem::create_symlink(target, tool);
    EXPECT_THAT(read_refusal(), StartsWith("tool.csv: cannot be opened")) << target;
  }
}

TEST_F(RecordingInput, AnInfoFileThatCannotBeReadIsNoAbsentOne) {
  write("tool.csv", commands());
  const std::string info = folder_ / "recording.txtpb";
  std::filesystem::create_symlink("/nowhere", info);
  EXPECT_THAT(refusal(commands()), StartsWith("recording.txtpb: cannot be opened"));
  std::filesystem::remove(info);
  EXPECT_EQ(warning(commands(), "\xef\xbb\xbfname: \"a\"\n"), "0 warnings");
}

TEST(OutputFile, WhatDoesNotReachTheDiskIsAnError) {
  try {
    OutputFile file("/dev/full");
    file.add("text");
    file.close();
    FAIL();
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "/dev/full: cannot be written: No space left on device");
  }
}

TEST(OutputFolder, AppearsWholeAndLeavesTheFoldersOfOthers) {
  const test::TempDir place;
  const std::string mine = place / "out.unfinished";
  std::filesystem::create_directory(mine);
  std::ofstream(mine + "/x") << "mine";
  {
    OutputFolder lost(place / "out/");
    lost.begin();
    lost.write("a", "1");
    EXPECT_FALSE(std::filesystem::exists(place / "out"));
  }
  OutputFolder folder(place / "out");
  folder.begin();
  folder.write("a", "1");
  folder.finish();
  std::vector<std::string> left;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(place.path()))
    left.push_back(entry.path().lexically_relative(place.path()).string());
  EXPECT_THAT(left,
              testing::UnorderedElementsAre("out", "out/a", "out.unfinished", "out.unfinished/x"));
}

TEST(OutputFolder, OnlyANewOrEmptyFolderIsTaken) {
  const test::TempDir place;
  std::ofstream(place / "file") << "x";
  std::filesystem::create_symlink("/nowhere", place / "link");
  for (const std::string& name : {std::string(), std::string("/"), place.path(), place / "file",
                                  place / "link", place / ".."}) {
    EXPECT_THROW(OutputFolder folder(name), Error) << name;
  }
  std::filesystem::create_directory(place / "empty");
  OutputFolder folder(place / "empty");
  folder.begin();
  folder.finish();
  EXPECT_TRUE(std::filesystem::is_directory(place / "empty"));
}

}  // namespace
}  // namespace omentum

// Recordings: folder, file and memory hold the same; what is wrong is told with its place.
#include "mismatch/recording/recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>

#include "core/check.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/pcd.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/recording_mcap.h"
#include "mismatch/recording/table_columns.h"
#include "mismatch/recording/text_table.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr double kNone = std::numeric_limits<double>::quiet_NaN();

/// Rows with numbers that have no short decimal form.
Series make_series(const std::vector<std::string>& columns, std::int64_t start_ns,
                   std::int64_t period_ns, std::size_t rows = 7) {
  Series series;
  series.columns = columns;
  for (std::size_t row = 0; row < rows; ++row) {
    series.time_ns.push_back(start_ns + static_cast<std::int64_t>(row) * period_ns);
    for (std::size_t k = 0; k < columns.size(); ++k)
      series.values.push_back(std::sin(static_cast<double>(1 + row * 31 + k)) / 3);
  }
  return series;
}

Frames<Cloud> make_clouds() {
  Frames<Cloud> clouds;
  clouds.time_ns = {-5'000'000, 100'000'001};
  clouds.number = {3, 8};
  clouds.fetch = [](std::size_t k) {
    return Cloud(k + 2, Eigen::Vector3f(0.1F, -0.25F, 0.3F * static_cast<float>(k)));
  };
  return clouds;
}

Frames<std::string> make_depth() {
  Frames<std::string> depth;
  depth.time_ns = {0, 50'000'000};
  depth.number = {0, 1};
  depth.fetch = [](std::size_t k) {
    const auto z = static_cast<std::uint16_t>(1000 + k);
    return encode_depth_png({3, 2, {0, z, 2000, 65535, 1, z}});
  };
  return depth;
}

/// Every channel there is, on clocks of their own, one before zero.
Recording make_recording() {
  Recording r;
  r.info.set_name("all");
  r.info.set_frame("W");
  r.info.set_notes("line \"one\"\nline two");
  r.info.set_specimen("s1");
  r.info.set_held_out(true);
  r.info.mutable_start()->set_release_time_s(0.5);
  r.info.set_scene_believed_text("kind: sheet\nsheet_size_x_m: 0.09\n");
  for (const double p : {0.0, 0.0, 0.5}) r.info.mutable_camera()->add_p_m(p);
  for (const double v : {0.0, 0.0, -1.0}) r.info.mutable_camera()->add_view_direction(v);
  for (const double u : {0.0, 1.0, 0.0}) r.info.mutable_camera()->add_up(u);
  r.info.mutable_camera()->set_width(3);
  r.info.mutable_camera()->set_height(2);
  r.info.mutable_camera()->set_fx(2);
  r.info.mutable_camera()->set_fy(2);
  const auto tip = [](const std::string& source) {
    const std::string stem = "tip_" + source + "_";
    return std::vector<std::string>{stem + "x_m", stem + "y_m", stem + "z_m", stem + "qw",
                                    stem + "qx",  stem + "qy",  stem + "qz"};
  };
  r.series["tool"] = make_series(tip("measured"), 3, 10'000'000);
  r.series["tool_commanded"] = make_series(tip("commanded"), 0, 20'000'000);
  r.series["tool_setpoint"] = make_series(tip("setpoint"), 0, 20'000'000);
  r.series["jaw"] =
      make_series({"jaw_commanded_rad", "jaw_measured_rad", "jaw_effort_Nm"}, 0, 20'000'000);
  r.series["jaw"].values[1] = kNone;
  r.series["joints"] = make_series({"q1_measured_rad", "dq1_measured_rad_per_s", "effort1_Nm",
                                    "q3_measured_m", "dq3_measured_m_per_s", "effort3_N",
                                    "q_in_measured_rad", "torque_in_Nm", "q_out_measured_m"},
                                   1'700'000'000'123'456'789, 1'000);
  r.series["joints_commanded"] = make_series({"q1_commanded_rad", "effort3_commanded_N"}, 0, 7);
  r.series["tracker"] = make_series({"tip_optical_x_m", "tip_optical_y_m", "tip_optical_z_m"},
                                    -20'000'000, 10'000'000);
  r.series["force"] = make_series({"fx_N", "fy_N", "fz_N"}, 0, 1'000'000);
  r.series["markers"] = make_series(
      {"tip1_x_m", "tip1_y_m", "tip1_z_m", "base_x_m", "base_y_m", "base_z_m"}, 0, 10'000'000);
  r.series["markers"].values[8] = kNone;
  r.series["coupon"] = make_series({"elongation_m", "load_N"}, 0, 100'000'000);
  r.clouds = make_clouds();
  r.depth = make_depth();
  r.color = make_depth();
  return r;
}

std::string text_of(const fs::path& path) { return read_whole_file(path.string()); }

std::map<std::string, std::string> files_of(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) {
    if (entry.is_regular_file())
      files[fs::relative(entry.path(), folder).string()] = text_of(entry.path());
  }
  return files;
}

std::string refusal(const std::function<void()>& run) {
  try {
    run();
  } catch (const Error& error) {
    EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
    return error.what();
  }
  return "nothing refused";
}

class RecordingFiles : public testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) const {
    fs::create_directories(fs::path(folder_ / name).parent_path());
    std::ofstream(folder_ / name, std::ios::binary) << text;
  }
  std::string refused() const {
    return refusal([&] { read_recording_folder(folder_.path()); });
  }
  test::TempDir folder_;
};

TEST(RecordingTime, SecondsAreExactToTheNanosecond) {
  for (const std::int64_t t :
       {std::int64_t{0}, std::int64_t{1}, std::int64_t{-1}, std::int64_t{20'000'000},
        std::int64_t{1'700'000'000'123'456'789}, std::int64_t{-999'999'999},
        std::int64_t{9'000'000'000'000'000'001}}) {
    std::int64_t back = 5;
    EXPECT_TRUE(parse_seconds(print_seconds(t), back));
    EXPECT_EQ(back, t) << print_seconds(t);
  }
  EXPECT_EQ(print_seconds(-20'000'000), "-0.02");
  std::int64_t t = 0;
  for (const char* wrong : {"", "nan", "1e300", "-", "1 s", "0x10"})
    EXPECT_FALSE(parse_seconds(wrong, t)) << wrong;
}

TEST(RecordingColumns, EveryNameOfAJointComesBack) {
  for (const std::string name :
       {"q1_commanded_rad", "q3_measured_m", "dq3_measured_m_per_s", "dq7_measured_rad_per_s",
        "effort3_N", "effort1_Nm", "effort2_commanded_Nm", "q_in_measured_rad", "torque_out_Nm",
        "q_out_setpoint_m"}) {
    const auto column = parse_joint_column(name);
    ASSERT_TRUE(column.has_value()) << name;
    EXPECT_EQ(name_of(*column), name);
  }
  for (const char* wrong : {"q1_rad", "q_measured_rad", "effort1_rad", "q0_measured_rad",
                            "torque1_Nm", "effort_in_Nm", "q1_measured_Nm", ""})
    EXPECT_FALSE(parse_joint_column(wrong).has_value()) << wrong;
}

TEST_F(RecordingFiles, FolderAndFileHoldTheSame) {
  const Recording made = make_recording();
  write_recording_folder(made, folder_ / "a");
  const Recording from_folder = read_recording_folder(folder_ / "a");
  EXPECT_EQ(difference(made, from_folder), "");
  EXPECT_THAT(from_folder.warnings, IsEmpty());
  for (const McapCompression compression :
       {McapCompression::kNone, McapCompression::kLz4, McapCompression::kZstd}) {
    write_recording_mcap(from_folder, folder_ / "a.mcap", compression);
    const Recording from_file = read_recording_mcap(folder_ / "a.mcap");
    EXPECT_EQ(difference(made, from_file), "");
    EXPECT_THAT(from_file.warnings, IsEmpty());
  }
  const Recording from_file = read_recording_mcap(folder_ / "a.mcap");
  write_recording_folder(from_file, folder_ / "b");
  EXPECT_EQ(files_of(folder_ / "a"), files_of(folder_ / "b"));
  write_recording_mcap(read_recording_folder(folder_ / "b"), folder_ / "b.mcap");
  EXPECT_EQ(text_of(folder_ / "a.mcap"), text_of(folder_ / "b.mcap"));
}

TEST_F(RecordingFiles, ADifferenceOfOneBitIsSeen) {
  const Recording a = make_recording();
  Recording b = make_recording();
  double& value = b.series["force"].values[4];
  value = std::nextafter(value, 1);
  EXPECT_THAT(difference(a, b), HasSubstr("force: other values"));
  b = make_recording();
  b.clouds.fetch = [](std::size_t) { return Cloud(2, Eigen::Vector3f::Zero()); };
  EXPECT_THAT(difference(a, b), HasSubstr("clouds: frame 0"));
  b = make_recording();
  b.series.erase("jaw");
  EXPECT_THAT(difference(a, b), HasSubstr("jaw"));
}

TEST_F(RecordingFiles, ATruncatedFileGivesItsWholeChunksAndSaysSo) {
  Recording made;
  made.info.set_name("long");
  made.series["force"] = make_series({"fx_N", "fy_N", "fz_N"}, 0, 1'000'000, 20'000);
  write_recording_mcap(made, folder_ / "a.mcap", McapCompression::kLz4);
  const std::string bytes = text_of(folder_ / "a.mcap");
  write("cut.mcap", bytes.substr(0, bytes.size() / 2));
  const Recording cut = read_recording_mcap(folder_ / "cut.mcap");
  ASSERT_NE(cut.find("force"), nullptr);
  EXPECT_GT(cut.find("force")->rows(), 5000);
  EXPECT_LT(cut.find("force")->rows(), 15'000);
  EXPECT_THAT(cut.warnings, testing::Contains(HasSubstr("file ends inside a chunk")));
  write("no.mcap", "hello");
  EXPECT_THAT(refusal([&] { read_recording_mcap(folder_ / "no.mcap"); }),
              HasSubstr("no MCAP magic"));
}

TEST_F(RecordingFiles, UnitsTransformsAndRatesGiveSiInW) {
  write("recording.txtpb",
        "force_rate_hz: 4\n"
        "transform { file: \"tool.csv\" p_m: [1, 2, 3] q_wxyz: [0.70710678118654757, 0, 0, "
        "0.70710678118654757] }\n");
  write("tool.csv",
        "t_ms,tip_measured_x_mm,tip_measured_y_mm,tip_measured_z_mm,jaw_measured_deg\n"
        "0,1000,0,0,180\n20,0,500,0,\n");
  write("force.csv", "fx_N,fy_N,fz_N\n1,2,3\n1,2,4\n");
  write("clouds.csv", "t_s,file\n0.5,a.pcd\n");
  write("a.pcd",
        "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\n"
        "HEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 2\nDATA ascii\n1 2 3\n4 5 6\n");
  const Recording r = read_recording_folder(folder_.path());
  const Series& tool = *r.find("tool");
  EXPECT_EQ(tool.time_ns[1], 20'000'000);
  EXPECT_NEAR(tool.at(0, 0), 1, 1e-15);  // x of F is y of W
  EXPECT_NEAR(tool.at(0, 1), 3, 1e-15);
  EXPECT_NEAR(tool.at(1, 0), 0.5, 1e-15);
  EXPECT_EQ(r.find("jaw")->rows(), 1);
  EXPECT_NEAR(r.find("jaw")->at(0, 0), 3.14159265358979, 1e-13);
  EXPECT_EQ(r.find("force")->time_ns[1], 250'000'000);
  EXPECT_EQ(r.clouds.fetch(0)[1], Eigen::Vector3f(4, 5, 6));
  EXPECT_EQ(r.info.transform_size(), 0);
}

TEST_F(RecordingFiles, TheBelievedSceneOfTheCaseComesAlong) {
  write("scene_believed.txt", "kind: sheet\n");
  write("one/force.csv", "t_s,fx_N,fy_N,fz_N\n0,1,2,3\n");
  const Recording r = read_recording_folder(folder_ / "one");
  EXPECT_EQ(r.info.scene_believed_text(), "kind: sheet\n");
}

TEST_F(RecordingFiles, ANamedSceneIsLookedForBesideTheRecordingThenInTheCase) {
  write("one/force.csv", "t_s,fx_N,fy_N,fz_N\n0,1,2,3\n");
  write("one/recording.txtpb", "name: \"one\"\nscene: \"scene_believed.txt\"\n");
  const std::string said = refusal([&] { read_recording_folder(folder_ / "one"); });
  EXPECT_THAT(said, HasSubstr("one/recording.txtpb:2:1: scene: scene_believed.txt is neither in"));
  write("scene_believed.txt", "kind: sheet  # of the case\n");
  for (const std::string ending : {"", "/"}) {
    const Recording r = read_recording_folder(std::string(folder_ / "one") + ending);
    EXPECT_EQ(r.info.scene_believed_text(), "kind: sheet  # of the case\n");
    EXPECT_EQ(r.scene_path, std::string(folder_ / "scene_believed.txt"));
  }
  write("one/scene_believed.txt", "kind: solid\n");
  EXPECT_EQ(read_recording_folder(folder_ / "one").info.scene_believed_text(), "kind: solid\n");
}

TEST_F(RecordingFiles, ASceneIsAFileOfTheCaseAndNothingElse) {
  write("secret.txt", "root:x:0:0\n");
  write("case/one/force.csv", "t_s,fx_N,fy_N,fz_N\n0,1,2,3\n");
  for (const std::string& scene :
       std::vector<std::string>{"../../secret.txt", folder_ / "secret.txt", "link.txt"}) {
    if (scene == "link.txt")
      fs::create_symlink(folder_ / "secret.txt", folder_ / "case/one/link.txt");
    write("case/one/recording.txtpb", "scene: \"" + scene + "\"\n");
    EXPECT_THAT(refusal([&] { read_recording_folder(folder_ / "case/one"); }),
                HasSubstr("lies outside of the folder of the case"))
        << scene;
  }
  write("case/one/recording.txtpb", "scene: \"a.txtpb\"\n");
  write("case/one/a.txtpb", "root:x:0:0\n");
  EXPECT_THAT(refusal([&] { read_recording_folder(folder_ / "case/one"); }),
              HasSubstr("a.txtpb:1:"));
}

TEST_F(RecordingFiles, AnAxisThatIsEmptyInEveryRowTakesNoNeighboursNumber) {
  write("tool.csv",
        "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n"
        "0,0.01,0.02,,0.4\n1,0.01,0.02,,0.4\n");
  EXPECT_THAT(refused(), HasSubstr("tool.csv:1: column tip_commanded_z_m is empty in every row"));
  fs::remove(folder_ / "tool.csv");
  write("force.csv", "t_s,fx_N,fy_N,fz_N\n0,,,1\n1,,,2\n");
  const Recording r = read_recording_folder(folder_.path());
  EXPECT_THAT(r.warnings, testing::ElementsAre(HasSubstr("fx_N, fy_N known in no row")));
  EXPECT_EQ(r.find("force")->at(1, 2), 2);
  write_recording_mcap(r, folder_ / "r.mcap");
  const Recording again = read_recording_mcap(folder_ / "r.mcap");
  EXPECT_EQ(difference(r, again), "");
  write_recording_folder(again, folder_ / "r");
  EXPECT_EQ(difference(r, read_recording_folder(folder_ / "r")), "");
}

TEST_F(RecordingFiles, AFrameWithoutPointsGoesInAndOut) {
  const std::string head =
      "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
      "property float z\nend_header\n";
  write("clouds.csv", "t_s,file\n0,clouds/0.ply\n1,clouds/1.ply\n");
  write("clouds/0.ply", head + "nan nan nan\n");
  write("clouds/1.ply", head + "1 2 3\n");
  const Recording r = read_recording_folder(folder_.path());
  EXPECT_EQ(r.clouds.fetch(0).size(), 0U);
  write_recording_mcap(r, folder_ / "r.mcap");
  write_recording_folder(read_recording_mcap(folder_ / "r.mcap"), folder_ / "r");
  EXPECT_EQ(difference(r, read_recording_folder(folder_ / "r")), "");
}

TEST_F(RecordingFiles, WhatIsWrongIsToldWithItsPlace) {
  EXPECT_THAT(refused(), HasSubstr("nothing of a recording"));
  const std::string header = "t_s,fx_N,fy_N,fz_N\n";
  const auto expect = [&](const std::string& table, const std::string& said) {
    write("force.csv", table);
    EXPECT_THAT(refused(), HasSubstr(said)) << table;
  };
  expect(header + "0,1,2,3\n1,1,nan,3\n", "force.csv:3:5: \"nan\" in column fy_N");
  expect(header + "0,1,2,3\n1,1,x,3\n", "force.csv:3:5: \"x\"");
  expect(header + "1,1,2,3\n1,1,2,3\n", "force.csv:3:1: 1 s after 1 s, needed increasing");
  expect(header + "0,1,2\n", "force.csv:2: row of 3 cells, needed 4");
  expect("t_s,fx_lbf,fy_N,fz_N\n0,1,2,3\n", "force.csv:1:5: column \"fx_lbf\" ends in no known");
  expect("t_s,fx_N,fy_N\n0,1,2\n", "force.csv:1: column fx_N without fz_N");
  expect("", "force.csv:1: no header line");
  fs::remove(folder_ / "force.csv");
  write("clouds.csv", "t_s,file\n0,clouds/1.ply\n");
  EXPECT_THAT(refused(), HasSubstr("clouds.csv:2:3: "));
  write("clouds/1.ply", "ply\n");
  const Recording r = read_recording_folder(folder_.path());
  EXPECT_THAT(refusal([&] { write_recording_mcap(r, folder_ / "x.mcap"); }),
              HasSubstr("clouds/1.ply"));
  for (const auto& entry : fs::directory_iterator(folder_.path()))
    EXPECT_THAT(entry.path().filename().string(), testing::Not(HasSubstr("x.mcap")));
  fs::remove(folder_ / "clouds.csv");
  write("depth.csv", "t_s,file\n0,0.png\n");
  write("0.png", "no");
  EXPECT_THAT(refused(), HasSubstr("depth without intrinsics"));
}

TEST(DepthImages, BecomeCloudsByThePinhole) {
  const Recording r = make_recording();
  Recording only = r;
  only.clouds = {};
  const Frames<Cloud> clouds = seen_clouds(only);
  ASSERT_EQ(clouds.size(), 2);
  const Cloud cloud = clouds.fetch(0);
  ASSERT_EQ(cloud.size(), 5);  // one pixel sees nothing
  // Pixel (1, 0) at 0.1 m: the camera looks down from (0, 0, 0.5), its right is +x, its up +y.
  EXPECT_TRUE(cloud[0].isApprox(Eigen::Vector3f(0.05F, 0, 0.4F), 1e-6F)) << cloud[0];
  // Pixel (0, 1) at 6.5535 m is below the axis: -y.
  EXPECT_NEAR(static_cast<double>(cloud[2].y()), -6.5535 / 2, 1e-5);
  EXPECT_EQ(seen_clouds(r).fetch(0), r.clouds.fetch(0)) << "clouds that there are go first";
  only.info.mutable_camera()->set_width(4);
  EXPECT_THAT(refusal([&] { seen_clouds(only).fetch(0); }), HasSubstr("3 x 2 pixels"));
}

TEST(DepthImages, DamagedPngsAreRefused) {
  const DepthImage image{3, 2, {0, 1, 2, 3, 4, 65535}};
  const std::string png = encode_depth_png(image);
  const Result<DepthImage> back = parse_depth_png("a.png", png);
  ASSERT_TRUE(back.has_value());
  EXPECT_EQ(back.value().depth, image.depth);
  for (std::size_t size = 0; size < png.size() - 12; ++size)
    EXPECT_FALSE(parse_depth_png("a.png", png.substr(0, size)).has_value()) << size;
}

TEST(Pcd, BinaryAndFieldsOfAnyTypeAreRead) {
  std::string pcd =
      "VERSION .7\nFIELDS rgb x y z\nSIZE 4 8 2 4\nTYPE F F I U\nCOUNT 2 1 1 1\nPOINTS 1\n"
      "DATA binary\n";
  const double x = 0.25;
  const std::int16_t y = -3;
  const std::uint32_t z = 7;
  pcd += std::string(8, '\x7f');
  pcd.append(reinterpret_cast<const char*>(&x), 8);
  pcd.append(reinterpret_cast<const char*>(&y), 2);
  pcd.append(reinterpret_cast<const char*>(&z), 4);
  const auto points = parse_pcd("a.pcd", pcd);
  ASSERT_TRUE(points.has_value()) << points.error();
  EXPECT_EQ(points.value().at(0), Eigen::Vector3f(0.25F, -3, 7));
  pcd.pop_back();
  EXPECT_THAT(parse_pcd("a.pcd", pcd).error(), HasSubstr("a.pcd: ends in point 0 of 1"));
  EXPECT_FALSE(parse_pcd("a",
                         "VERSION .7\nFIELDS x y\nSIZE 4 4\nTYPE F F\nCOUNT 1 1\nPOINTS 1\n"
                         "DATA ascii\n1 2\n")
                   .has_value());
}

TEST(Pcd, PackedFieldsAreUnpacked) {
  const std::string head =
      "VERSION .7\nFIELDS x y z i\nSIZE 4 4 4 1\nTYPE F F F U\nCOUNT 1 1 1 1\nPOINTS 3\n"
      "VIEWPOINT 0 0 0 1 0 0 0\nDATA binary_compressed\n";
  const std::vector<float> fields = {1, 1, 1, 2, 2, NAN, 3, 3, 3};
  std::string body(reinterpret_cast<const char*>(fields.data()), 36);
  body += "abc";
  // 4 bytes as they are, 8 by a reference that repeats itself, then the rest as it is.
  std::string packed;
  packed += '\3';
  packed += body.substr(0, 4);
  packed += static_cast<char>((8 - 2) << 5);
  packed += '\3';
  packed += static_cast<char>(27 - 1);
  packed += body.substr(12);
  const auto file = [&](std::uint32_t unpacked) {
    const std::uint32_t sizes[2] = {static_cast<std::uint32_t>(packed.size()), unpacked};
    return head + std::string(reinterpret_cast<const char*>(sizes), 8) + packed;
  };
  const auto points = parse_pcd("a.pcd", file(39));
  ASSERT_TRUE(points.has_value()) << points.error();
  EXPECT_EQ(points.value(), (std::vector<Eigen::Vector3f>{{1, 2, 3}, {1, 2, 3}}));
  EXPECT_THAT(parse_pcd("a.pcd", file(40)).error(), HasSubstr("packed data are damaged"));
  const std::string whole = file(39);
  for (std::size_t size = head.size(); size < whole.size(); ++size)
    EXPECT_FALSE(parse_pcd("a.pcd", whole.substr(0, size)).has_value()) << size;
  EXPECT_FALSE(has_viewpoint(whole));
  std::string posed = whole;
  posed.replace(posed.find("VIEWPOINT 0"), 11, "VIEWPOINT 1");
  EXPECT_TRUE(has_viewpoint(posed));
}

}  // namespace
}  // namespace omentum

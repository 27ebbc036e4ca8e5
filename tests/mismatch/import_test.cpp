// Mapping files: data in any shape, without code.
#include <gmock/gmock.h>
#include <google/protobuf/text_format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "core/check.h"
#include "core/config.h"
#include "core/constants.h"
#include "mismatch/import/file_pattern.h"
#include "mismatch/import/import_map.h"
#include "mismatch/import/npy.h"
#include "mismatch/import/rigid.h"
#include "mismatch/import/units.h"
#include "mismatch/recording/text_table.h"
#include "sim_worker/playback/npz.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;

class Import : public testing::Test {
 protected:
  void write(const std::string& name, const std::string& text) const {
    const std::filesystem::path path = folder_ / name;
    std::filesystem::create_directories(path.parent_path());
    std::ofstream(path, std::ios::binary) << text;
  }
  std::map<std::string, Recording> run(const std::string& text) const {
    pb::ImportMap map;
    parse_text_proto("map", text, map);
    std::map<std::string, Recording> made;
    import_mapped(map, folder_.path(), [&](const std::string& name, const Recording& recording) {
      made[name] = recording;
    });
    return made;
  }
  std::string refused(const std::string& text) const {
    try {
      run(text);
    } catch (const Error& error) {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos) << error.what();
      return error.what();
    }
    return "nothing refused";
  }
  test::TempDir folder_;
};

TEST(FilePatterns, NameThePartsOfPaths) {
  const auto parts = [](const char* pattern, const char* path) {
    const auto made = FilePattern::parse(pattern);
    return made ? made.value().match(path) : std::nullopt;
  };
  EXPECT_EQ(parts("lift_{f:letters}{r:digits}.npy", "lift_navy2.npy"),
            (Values{{"f", "navy"}, {"r", "2"}}));
  EXPECT_EQ(parts("lift_{f:letters}{r:digits}.npy", "lift_navy.npy"),
            (Values{{"f", "navy"}, {"r", ""}}));
  EXPECT_EQ(parts("{m}/{m}_{s}.csv", "A/A_1.csv"), (Values{{"m", "A"}, {"s", "1"}}));
  EXPECT_EQ(parts("{m}/{m}_{s}.csv", "A/B_1.csv"), std::nullopt);
  EXPECT_EQ(parts("T_{a}_{b:1}{c:1}.csv", "T_x_y_23.csv"),
            (Values{{"a", "x_y"}, {"b", "2"}, {"c", "3"}}));
  EXPECT_EQ(parts("*.csv", "a/b.csv"), std::nullopt) << "no part holds a slash";
  EXPECT_EQ(parts("*/b.csv", "a/b.csv"), Values{});
  for (const char* wrong : {"{", "{}", "{a:b}", "a}", "{a:0}"})
    EXPECT_FALSE(FilePattern::parse(wrong).has_value()) << wrong;
}

TEST(ImportUnits, KindsDoNotMix) {
  EXPECT_NEAR(factor_to_column("deg", "q1_measured_rad").value(), kPi / 180, 1e-18);
  EXPECT_EQ(factor_to_column("MPa", "stress_engineering_Pa").value(), 1e6);
  EXPECT_THAT(factor_to_column("mm", "fx_N").error(), HasSubstr("unit mm of column fx_N"));
  EXPECT_THAT(factor_to_column("furlong", "fx_N").error(), HasSubstr("not known, allowed m cm"));
}

TEST(ImportRotations, EveryFormIsTheSameTurn) {
  // Rz(90 deg) Rx(30 deg).
  const Eigen::Quaterniond q(Eigen::AngleAxisd(kPi / 2, Eigen::Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(kPi / 6, Eigen::Vector3d::UnitX()));
  const Eigen::Matrix3d R = q.toRotationMatrix();
  const auto expect = [&](std::vector<double> numbers, pb::RotationForm form, const char* axes) {
    const auto made = make_rotation(numbers, form, axes, true);
    ASSERT_TRUE(made.has_value()) << made.error();
    EXPECT_LT(made.value().angularDistance(q), 1e-7) << form;
  };
  expect({q.w(), q.x(), q.y(), q.z()}, pb::WXYZ, "");
  expect({q.x(), q.y(), q.z(), q.w()}, pb::XYZW, "");
  expect({R(0, 0), R(0, 1), R(0, 2), R(1, 0), R(1, 1), R(1, 2), R(2, 0), R(2, 1), R(2, 2)},
         pb::MATRIX_BY_ROWS, "");
  expect({R(0, 0), R(1, 0), R(2, 0), R(0, 1), R(1, 1), R(2, 1), R(0, 2), R(1, 2), R(2, 2)},
         pb::MATRIX_BY_COLUMNS, "");
  expect({90, 0, 30}, pb::EULER, "zyx");
  expect({30, 0, 90}, pb::EULER_FIXED, "xyz");
  const Eigen::AngleAxisd turn(q);
  const Eigen::Vector3d v = turn.axis() * turn.angle() * 180 / kPi;
  expect({v.x(), v.y(), v.z()}, pb::ROTATION_VECTOR, "");
  EXPECT_THAT(make_rotation(std::vector<double>{1, 1, 0, 0}, pb::WXYZ, "", false).error(),
              HasSubstr("length 1.41"));
  EXPECT_THAT(
      make_rotation(std::vector<double>{1, 0, 0, 0, 1, 0, 0, 0, -1}, pb::MATRIX_BY_ROWS, "", false)
          .error(),
      HasSubstr("mirrors"));
}

TEST(ImportTransforms, PointPairsGiveTheTransform) {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  X.rotate(Eigen::AngleAxisd(2, Eigen::Vector3d(1, 2, 3).normalized()))
      .pretranslate(Eigen::Vector3d(0.3, -0.2, 0.1));
  std::vector<Eigen::Vector3d> from = {{0, 0, 0}, {0.1, 0, 0}, {0, 0.2, 0}, {0.1, 0.1, 0.05}}, to;
  for (const auto& p : from) to.push_back(X * p);
  const auto fit = fit_rigid(from, to);
  ASSERT_TRUE(fit.has_value()) << fit.error();
  EXPECT_TRUE(fit.value().X_TF.isApprox(X, 1e-9));
  EXPECT_LT(fit.value().rms_m, 1e-12);
  EXPECT_FALSE(fit_rigid({{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}, {{0, 0, 0}, {1, 0, 0}, {2, 0, 0}}));
  EXPECT_FALSE(fit_rigid({{0, 0, 0}, {1, 0, 0}}, {{0, 0, 0}, {1, 0, 0}}));
}

TEST_F(Import, TextWithEveryOddity) {
  write("day2/run_A_7.txt",
        "% rig: bench 3, probe 2,5 N\n% lot;X;\njunk\nzeit;weg;kraft;ok\nms;mm;N;-\n"
        "0;1,5;2;y\n10;2,5;-;y\n20;3,5;4;n\n30;4,5;5;y\n");
  const auto made = run(R"(
    name: "{day}_{rig}_{number}"
    set: "specimen={lot}" set: "day={day}" set: "coupon.gauge_length_m={probe}"
    when { value: "{number}" equals: "7" set: "held_out=true" }
    source {
      files: "{day}/run_{rig:letters}_{number}.txt" delimiter: ";" decimal_comma: true
      comment: "%" header_starts: "zeit" unit_rows: 1 unknown: "-"
      value { name: "lot" behind: "lot;" }
      value { name: "probe" behind: "bench 3, probe " until: "," number: 1 unit: "mm" }
      filter { column: "ok" equals: "y" }
      time { column: "zeit" unit: "ms" offset_s: 1 }
      column { from: "weg" to: "elongation_m" unit: "mm" factor: -1 offset: 0.5 }
      column { from: "kraft" to: "load_N" factor_value: "{number}" }
    })");
  ASSERT_EQ(made.size(), 1);
  const Recording& r = made.at("day2_A_7");
  EXPECT_EQ(r.info.specimen(), "X");
  EXPECT_TRUE(r.info.held_out());
  EXPECT_NEAR(r.info.coupon().gauge_length_m(), 0.002, 1e-15);
  const Series& coupon = *r.find("coupon");
  EXPECT_THAT(coupon.time_ns, ElementsAre(1'000'000'000, 1'010'000'000, 1'030'000'000));
  EXPECT_NEAR(coupon.at(0, 0), -0.001, 1e-15);
  EXPECT_NEAR(coupon.at(0, 1), 14, 1e-12);
  EXPECT_TRUE(std::isnan(coupon.at(1, 1)));
}

TEST_F(Import, OneFileHoldsManyRecordings) {
  write("all.csv", "run,load,q\na,1,0\na,1,100\nb,2,50\na,1,200\n");
  const std::string columns =
      "column { from: \"q\" to: \"q_in_measured_rad\" counts_per_turn: 400 } time { rate_hz: 10 } ";
  auto made =
      run("name: \"{run}\" set: \"notes=load {load}\" source { files: \"all.csv\" split { "
          "column: \"run\" column: \"load\" } " +
          columns + "}");
  ASSERT_EQ(made.size(), 2);
  EXPECT_EQ(made["a"].find("joints")->rows(), 3);
  EXPECT_NEAR(made["a"].find("joints")->at(2, 0), kPi, 1e-12);
  EXPECT_EQ(made["a"].find("joints")->time_ns[1], 100'000'000);
  EXPECT_EQ(made["b"].info.notes(), "load 2");

  made =
      run("name: \"{block}\" set: \"notes=from {from}\" source { files: \"all.csv\" split { "
          "rows: 2 parameter_rows: 1 parameter { name: \"from\" column: \"load\" } } " +
          columns + "}");
  ASSERT_EQ(made.size(), 2);
  EXPECT_EQ(made["1"].info.notes(), "from 2");
  EXPECT_EQ(made["1"].find("joints")->rows(), 1);

  made =
      run("name: \"{block}\" source { files: \"all.csv\" split { begins_with: \"a\" "
          "parameter_rows: 0 } " +
          columns + "}");
  EXPECT_EQ(made.size(), 3);
  EXPECT_THAT(refused("source { files: \"all.csv\" split { rows: 2 } " + columns + "}"),
              HasSubstr("name: \"all\" twice"));
}

TEST_F(Import, FilesAreJoinedByPartsTimeAndRow) {
  for (const std::string k : {"1", "2"}) {
    write("tip_" + k + ".csv", "t_s,x,y,z,a,b,c\n0.5,1,2,3,0,0,90\n0.7,1,2,4,0,0,90\n");
    write("load_" + k + ".csv", k + " 0 0\n0 " + k + " 0\n");
    write("cloud_" + k + "_250.ply",
          "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\n"
          "property float z\nend_header\n1 0 0\n");
  }
  write("tcr.csv", "0,-1,0,10\n1,0,0,20\n0,0,1,30\n");
  const auto made = run(R"(
    name: "lift{k}"
    source { name: "tip" files: "tip_{k}.csv"
      column { from: "x" to: "tip_measured_x_m" } column { from: "y" to: "tip_measured_y_m" }
      column { from: "z" to: "tip_measured_z_m" }
      rotation { to: "tip_measured" from: "a" from: "b" from: "c" form: EULER axes: "xyz" degrees: true }
      transform { matrix_file: "tcr.csv" } }
    source { files: "load_{k}.csv" delimiter: " " header: false time { of_source: "tip" }
      column { from: "1" to: "fx_N" } column { from: "2" to: "fy_N" } column { from: "3" to: "fz_N" }
      transform { rotation: "0 0 90" form: EULER axes: "xyz" degrees: true } }
    source { files: "cloud_{k}_{ms}.ply" frames: "clouds" time { value: "{ms}" unit: "ms" }
      transform { p_m: "0 0 1" } })");
  ASSERT_EQ(made.size(), 2);
  const Recording& r = made.at("lift2");
  const Series& tip = *r.find("tool");
  EXPECT_THAT(tip.time_ns, ElementsAre(500'000'000, 700'000'000));
  EXPECT_NEAR(tip.at(1, 0), 8, 1e-12);
  EXPECT_NEAR(tip.at(1, 1), 21, 1e-12);
  EXPECT_NEAR(tip.at(1, 2), 34, 1e-12);
  EXPECT_NEAR(tip.at(0, 3), 0, 1e-9) << "90 and 90 deg about z";
  EXPECT_EQ(r.find("force")->time_ns, tip.time_ns);
  EXPECT_NEAR(r.find("force")->at(0, 1), 2, 1e-12) << "x of the sensor is y of W";
  ASSERT_EQ(r.clouds.size(), 1);
  EXPECT_EQ(r.clouds.time_ns[0], 250'000'000);
  EXPECT_EQ(r.clouds.fetch(0)[0], Eigen::Vector3f(1, 0, 1));
}

TEST_F(Import, ArraysBecomeCloudsMarkersAndColumns) {
  std::string npy = npy_header("<i2", {3, 2, 4});  // xyz, time, point
  for (std::int16_t k = 0; k < 24; ++k) npy.append(reinterpret_cast<const char*>(&k), 2);
  write("a.npy", npy);
  const std::string source = "time { rate_hz: 2 } array { axes: \"xyz time point\" unit: \"mm\" ";
  auto made = run("source { files: \"a.npy\" " + source + "} }");
  const Cloud cloud = made.at("a").clouds.fetch(1);
  ASSERT_EQ(cloud.size(), 4);
  EXPECT_TRUE(cloud[2].isApprox(Eigen::Vector3f(6e-3F, 14e-3F, 22e-3F), 1e-6F)) << cloud[2];
  made = run("source { files: \"a.npy\" " + source + "to: \"markers\" } }");
  EXPECT_EQ(made.at("a").find("markers")->columns.size(), 12);
  EXPECT_NEAR(made.at("a").find("markers")->at(1, 8), 22e-3, 1e-15);

  NpzFile npz;
  npz.add("pos", {2, 3}, {1, 2, 3, 4, 5, 6});
  npz.write(folder_ / "b.npz");
  made =
      run("source { files: \"b.npz\" array { name: \"pos\" } time { at_rest: true } column { "
          "from: \"2\" to: \"q1_measured_rad\" } }");
  EXPECT_EQ(made.at("b").find("joints")->at(1, 0), 6);
  EXPECT_EQ(made.at("b").find("joints")->time_ns[1], 1'000'000'000);
  EXPECT_THAT(refused("source { files: \"b.npz\" array { name: \"vel\" } time { at_rest: true } }"),
              HasSubstr("no array vel.npy, there are pos.npy"));
  EXPECT_THAT(refused("source { files: \"a.npy\" array { } time { rate_hz: 1 } }"),
              HasSubstr("shape (3, 2, 4), needed one axis each of time column"));
}

TEST_F(Import, ArraysOfFourDimensionsHavePicturesOrPartsOfAnAxis) {
  std::string npy = npy_header("<i2", {2, 2, 2, 3});
  for (std::int16_t k = 0; k < 24; ++k) npy.append(reinterpret_cast<const char*>(&k), 2);
  write("a.npy", npy);
  const std::string source = "source { files: \"a.npy\" time { rate_hz: 2 } array { axes: ";
  const auto pictures = run(source + "\"time point point xyz\" } }");
  const Cloud cloud = pictures.at("a").clouds.fetch(1);
  ASSERT_EQ(cloud.size(), 4U);
  EXPECT_EQ(cloud[1], Eigen::Vector3f(15, 16, 17)) << "row by row";
  const auto second = run(source + "\"1 time point xyz\" } }");
  EXPECT_EQ(second.at("a").clouds.fetch(0)[1], Eigen::Vector3f(15, 16, 17));
  EXPECT_THAT(refused(source + "\"2 time point xyz\" } }"), HasSubstr("no part 2 of axis 0"));
  EXPECT_THAT(refused(source + "\"time point xyz\" } }"), HasSubstr("point may stand for several"));
}

TEST_F(Import, ANameThatStandsInSeveralColumnsIsRefusedWithItsPlaces) {
  write("a.csv", "t_s,X,Y,Z,X,Y,Z\n0,1,2,3,4,5,6\n1,1,2,3,4,5,6\n");
  const auto column = [](const std::string& from, const std::string& to) {
    return "column { from: \"" + from + "\" to: \"" + to + "\" } ";
  };
  EXPECT_THAT(refused("source { files: \"a.csv\" " + column("X", "m_x_m") + "}"),
              HasSubstr("a.csv:1: 2 columns are called X, those at 2, 5: needed \"#2\""));
  const auto made = run("source { files: \"a.csv\" " + column("#5", "m_x_m") +
                        column("#6", "m_y_m") + column("#7", "m_z_m") + "}");
  EXPECT_EQ(made.at("a").find("markers")->at(1, 0), 4);
  EXPECT_THAT(refused("source { files: \"a.csv\" " + column("#8", "m_x_m") + "}"),
              HasSubstr("column #8 is missing"));
}

TEST_F(Import, CellsBehindTheLastColumnAndBetweenTabsAreWhereTheyStand) {
  const std::string force =
      "time { column: \"t\" } column { from: \"x\" to: \"fx_N\" } column { from: \"y\" to: "
      "\"fy_N\" } column { from: \"z\" to: \"fz_N\" }";
  write("a.tsv",
        "\"t\"\t\"x\"\t\"y\"\t\"z\"\t\"a \"\"b\"\"\tc\"\n\"0\"\t\t\"2\"\t\"3\"\t\"\"\n"
        "\"1\"\t\"1\"\t\"2\"\t\"3\"\t\"d\"\n");
  const auto tabs = run("source { files: \"a.tsv\" delimiter: \"\\t\" " + force + "}");
  EXPECT_TRUE(std::isnan(tabs.at("a").find("force")->at(0, 0)));
  EXPECT_EQ(tabs.at("a").find("force")->at(0, 1), 2);
  write("b.csv", "t,x,y,z\n0,1,2,3,\n1,1,2,3,,\n");
  const auto ended = run("source { files: \"b.csv\" " + force + "}");
  EXPECT_EQ(ended.at("b").find("force")->at(1, 2), 3);
  EXPECT_THAT(ended.at("b").warnings, ElementsAre(HasSubstr("2 rows have empty cells behind")));
  write("c.csv", "t,x,y,z\n0,1,2,3,4\n");
  EXPECT_THAT(refused("source { files: \"c.csv\" " + force + "}"),
              HasSubstr("c.csv:2: row of 5 cells, needed 4"));
  write("d.csv", "t,x,y,z\n0,\"1,2,3\n");
  EXPECT_THAT(refused("source { files: \"d.csv\" " + force + "}"),
              HasSubstr("d.csv:2:3: a quote without its other one"));
}

TEST(TextTables, OneOfSeveralInAFileEndsWhereItIsSaid) {
  const std::string text = "t,x\n0,1\n1,2\n,\nDevices\nf,g,h\n1,2,3\n";
  TextFormat format;
  const auto rows = [&] { return TextTable("a.csv", text, format).rows(); };
  try {
    rows();
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("a.csv:5: row of 1 cells, needed 2"));
  }
  format.ends_before = "";
  EXPECT_EQ(rows(), 2U);
  format.ends_before = "Dev";
  EXPECT_EQ(rows(), 3U);
  try {
    TextTable("b.csv", "t,x\n0,1\n\nf,g,h\n", {});
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), HasSubstr("b.csv:4: row of 3 cells, needed 2: another table?"));
  }
}

TEST_F(Import, TheFirstOfTwoTablesIsTakenAlone) {
  write("a.csv", "t_s,f\n0,1\n1,2\n\nDevices\nt_s,g,h\n0,1,2\n");
  const std::string rest = "column { from: \"f\" to: \"load_N\" } }";
  EXPECT_THAT(refused("source { files: \"a.csv\" " + rest), HasSubstr("source.ends_before"));
  const auto made = run("source { files: \"a.csv\" ends_before: \"Devices\" " + rest);
  EXPECT_EQ(made.at("a").find("coupon")->rows(), 2U);
}

TEST_F(Import, NumbersOfFramesAndARateMakeTimesWithTheirGaps) {
  write("a.csv", "Frame,f\n7,1\n8,2\n32,3\n");
  const std::string column = "column { from: \"f\" to: \"load_N\" } ";
  const auto made =
      run("source { files: \"a.csv\" time { column: \"Frame\" rate_hz: 100 } " + column + "}");
  EXPECT_THAT(made.at("a").find("coupon")->time_ns, ElementsAre(0, 10'000'000, 250'000'000));
  write("b.csv", "Frame,f\n0.5,1\n");
  EXPECT_THAT(
      refused("source { files: \"b.csv\" time { column: \"Frame\" rate_hz: 100 } " + column + "}"),
      HasSubstr("b.csv:2:1: \"0.5\" is no number of a frame"));
}

TEST_F(Import, AStampThatStepsBackByAMillionthIsLeftOut) {
  std::string table = "t_s,f\n";
  for (int k = 0; k < 300; ++k) table += fmt::format("{:.7f},1\n", k == 150 ? 1.4899997 : 0.01 * k);
  write("a.csv", table);
  const std::string column = "column { from: \"f\" to: \"load_N\" } ";
  const auto made = run("source { files: \"a.csv\" " + column + "}");
  EXPECT_EQ(made.at("a").find("coupon")->rows(), 299U);
  EXPECT_THAT(made.at("a").warnings, ElementsAre(HasSubstr("1 of 300 rows no later")));
  write("a.csv", table + "1,1\n");
  EXPECT_THAT(refused("source { files: \"a.csv\" " + column + "}"), HasSubstr("needed increasing"));
}

TEST_F(Import, TextsOfInfoHaveValuesToo) {
  write("run_b.csv", "t_s,f\n0,1\n1,1\n");
  const auto made =
      run("info { notes: \"of {x}\" } source { files: \"run_{x}.csv\" column { from: \"f\" to: "
          "\"load_N\" } }");
  EXPECT_EQ(made.at("run_b").info.notes(), "of b");
}

TEST_F(Import, HiddenFilesAreNobodys) {
  write("a.csv", "t_s,f\n0,1\n1,1\n");
  write("._a.csv", "Mac");
  write(".git/b.csv", "x");
  EXPECT_EQ(run("source { files: \"{x}.csv\" column { from: \"f\" to: \"load_N\" } }").size(), 1U);
  EXPECT_THAT(files_below(folder_.path()), ElementsAre("a.csv"));
}

TEST_F(Import, WhatIsWrongIsToldWithItsPlace) {
  write("a.csv", "t_s,f\n0,1\n1,x\n");
  write("b.csv", "t_s,f\n1,1\n0,2\n");
  const std::string force = "column { from: \"f\" to: \"elongation_m\" } ";
  EXPECT_THAT(refused("source { files: \"c.csv\" }"), HasSubstr("no file fits"));
  EXPECT_THAT(refused("source { files: \"a.csv\" " + force + "}"),
              HasSubstr("a.csv:3:3: \"x\" in column f"));
  EXPECT_THAT(refused("source { files: \"b.csv\" " + force + "}"),
              HasSubstr("b.csv:3:1: 0 s after 1 s"));
  EXPECT_THAT(refused("source { files: \"b.csv\" column { from: \"g\" to: \"load_N\" } "
                      "time { rate_hz: 1 } }"),
              HasSubstr("b.csv:1: column g is missing; there are t_s f"));
  EXPECT_THAT(refused("source { files: \"b.csv\" column { from: \"f\" to: \"load\" } "
                      "time { rate_hz: 1 } }"),
              HasSubstr("source.column load: no column of a recording"));
  EXPECT_THAT(
      refused("source { files: \"b.csv\" column { from: \"f\" to: \"load_N\" unit: \"mm\" } "
              "time { rate_hz: 1 } }"),
      HasSubstr("unit mm of column load_N"));
  EXPECT_THAT(refused("name: \"{x}\" source { files: \"b.csv\" time { rate_hz: 1 } " + force + "}"),
              HasSubstr("no value {x}, there are"));
  EXPECT_THAT(refused("set: \"coupon.lenght=1\" source { files: \"b.csv\" time { rate_hz: 1 } " +
                      force + "}"),
              HasSubstr("no field lenght"));
  EXPECT_THAT(refused("set: \"cloud_rate_hz=-1\" source { files: \"b.csv\" time { rate_hz: 1 } " +
                      force + "}"),
              HasSubstr("cloud_rate_hz"));
}

}  // namespace
}  // namespace omentum

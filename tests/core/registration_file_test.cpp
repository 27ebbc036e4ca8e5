#include "core/registration_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "core/check.h"
#include "core/touched_points.h"
#include "core/utc_time.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;
using testing::StartsWith;

const char* const kHeader =
    "name,world_x_m,world_y_m,world_z_m,control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z\n";

/// Eight points of a board touched by a tool that points down in R (a half turn about x), R above W
/// by 0.15 m and turned a half turn about x as well.
std::string touches() {
  std::string text = kHeader;
  int k = 0;
  for (const Vector3d& p : std::vector<Vector3d>{{-0.08, -0.07, 0},
                                                 {0, -0.07, 0.03},
                                                 {0.06, -0.07, 0},
                                                 {-0.08, 0.03, 0.02},
                                                 {0.05, 0.02, 0},
                                                 {-0.07, 0.1, 0},
                                                 {0.01, 0.11, 0.04},
                                                 {0.06, 0.09, 0}}) {
    const Vector3d wobble = 0.0002 * Vector3d(k % 3 - 1, k % 2, (k + 1) % 3 - 1);
    const Vector3d p_RT = Vector3d(p.x(), -p.y(), 0.15 - p.z()) + wobble;
    const Vector3d control = p_RT - Vector3d(0, 0, -0.0102);
    text += fmt::format("board {},{},{},{},{},{},{},0,1,0,0\n", ++k, p.x(), p.y(), p.z(),
                        control.x(), control.y(), control.z());
  }
  return text;
}

void write(const std::string& path, const std::string& text) { std::ofstream(path) << text; }

RegistrationInput input_in(const test::TempDir& folder, const std::string& text) {
  RegistrationInput input;
  input.touches = folder.path() + "/touches.csv";
  write(input.touches, text);
  input.workspace_min = Vector3d(-0.09, -0.08, 0);
  input.workspace_max = Vector3d(0.07, 0.11, 0.1);
  input.instrument = "prograsp";
  input.date_ns = 1'795'000'000'000'000'000;
  return input;
}

Registration example() {
  const test::TempDir folder;
  return register_from_tables(input_in(folder, touches())).value();
}

std::string file_refusal(const std::string& text) {
  try {
    parse_registration("mine", text);
  } catch (const Error& error) {
    return error.what();
  }
  return "accepted";
}

std::string replaced(std::string text, const std::string& from, const std::string& to) {
  const std::size_t at = text.find(from);
  EXPECT_NE(at, std::string::npos) << from;
  return at == std::string::npos ? text : text.replace(at, from.size(), to);
}

TEST(UtcTime, TextAndMomentAreInverse) {
  EXPECT_EQ(utc_text(0), "1970-01-01T00:00:00Z");
  EXPECT_EQ(parse_utc("2026-11-23T08:00:00Z"), 1'795'420'800'000'000'000);
  for (std::int64_t s = 0; s < 7'000'000'000; s += 86'399 * 601) {
    const std::int64_t ns = s * 1'000'000'000;
    EXPECT_EQ(parse_utc(utc_text(ns + 999'999'999)), ns);
  }
  for (const char* wrong : {"", "2026-02-29T00:00:00Z", "2026-13-01T00:00:00Z",
                            "2026-01-01T24:00:00Z", "2026-01-01 00:00:00Z", "2026-01-01T00:00:00",
                            "-026-01-01T00:00:00Z", "2026-01-01T00:00:60Z"})
    EXPECT_EQ(parse_utc(wrong), std::nullopt) << wrong;
}

TEST(RegistrationTables, TouchesBecomeARegistration) {
  const Registration registration = example();
  EXPECT_EQ(registration.points.size(), 8U);
  EXPECT_EQ(registration.instrument, "prograsp");
  EXPECT_LT(registration.residual_rms, 0.0003);
  EXPECT_LT((registration.X_WR.translation() - Vector3d(0, 0, 0.15)).norm(), 0.0005);
  EXPECT_EQ(registration.p_CT, Vector3d(0, 0, 0.0102));
  const std::string text =
      describe_registration(registration, pb::RegistrationRules::default_instance(),
                            Vector3d::Constant(-0.1), Vector3d::Constant(0.1));
  EXPECT_THAT(text, AllOf(HasSubstr("board 3"), HasSubstr("leave-one-out"), HasSubstr("worst")));
}

TEST(RegistrationTables, APivotedTipReplacesTheNominalOne) {
  const test::TempDir folder;
  RegistrationInput input = input_in(folder, touches());
  input.pivots = folder.path() + "/pivots.csv";
  std::string text = "control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z\n";
  for (int k = 0; k < 9; ++k) {
    const Eigen::Quaterniond q(
        Eigen::AngleAxisd(0.7, Vector3d(k % 3 - 1, k / 3 - 1, 0.5).normalized()));
    const Vector3d control = Vector3d(0.01, 0.02, -0.1) - q * Vector3d(0, 0, 0.0142);
    text += fmt::format("{},{},{},{},{},{},{}\n", control.x(), control.y(), control.z(), q.w(),
                        q.x(), q.y(), q.z());
  }
  write(input.pivots, text);
  const Result<Registration> result = register_from_tables(input);
  ASSERT_TRUE(result.has_value()) << result.error();
  EXPECT_LT((result.value().p_CT - Vector3d(0, 0, 0.0142)).norm(), 1e-12);
  // Four millimetres from the nominal one is told.
  EXPECT_THAT(result.value().warnings, testing::Contains(HasSubstr("14.20 mm along the jaw")));
}

TEST(RegistrationTables, TellWhatIsWrongWithFileLineAndCharacter) {
  const test::TempDir folder;
  const auto error_of = [&](const std::string& text) {
    const RegistrationInput input = input_in(folder, text);
    const Result<Registration> result = register_from_tables(input);
    EXPECT_FALSE(result.has_value());
    EXPECT_THAT(result.error(), AllOf(StartsWith(input.touches + ":"), Not(HasSubstr("\n"))));
    return result.error();
  };
  EXPECT_THAT(error_of(replaced(touches(), "world_x_m", "world_x_mm")),
              HasSubstr(":1:6: unknown column \"world_x_mm\""));
  EXPECT_THAT(error_of("name,q_w\nboard,1\n"), HasSubstr(":1: no column control_x_m"));
  EXPECT_THAT(error_of(replaced(touches(), "0.05,0.02,", "0.05,inf,")),
              AllOf(HasSubstr(":6:"), HasSubstr("\"inf\" in column world_y_m")));
  EXPECT_THAT(error_of(replaced(touches(), "board 2", "")), HasSubstr(":3:1: \"\" in column name"));
  EXPECT_THAT(error_of(replaced(touches(), "board 2", "\"board\n2\"")),
              HasSubstr(":3:1: \"board 2\" in column name is no name"));
  EXPECT_THAT(error_of(replaced(touches(), "world_x_m", "\"world\nx\"")),
              HasSubstr("unknown column \"world x\""));
  EXPECT_THAT(error_of(replaced(touches(), "0,1,0,0", "0,1,1,0")),
              HasSubstr("quaternion of length 1.41421"));
  EXPECT_THAT(error_of(replaced(touches(), "board 2", "board 1")), HasSubstr("called board 1"));
}

TEST(RegistrationFile, WhatIsSavedIsLoadedToTheLastDigit) {
  const test::TempDir folder;
  const Registration saved = example();
  const std::string path = folder.path() + "/registration.txtpb";
  ASSERT_TRUE(save_registration(path, saved).has_value());
  const Registration loaded = load_registration(path);
  EXPECT_LT((loaded.X_WR.matrix() - saved.X_WR.matrix()).norm(), 1e-15);
  EXPECT_EQ(loaded.date_ns, saved.date_ns);
  EXPECT_EQ(loaded.instrument, saved.instrument);
  EXPECT_EQ(loaded.p_CT, saved.p_CT);
  EXPECT_EQ(loaded.residual_rms, saved.residual_rms);
  EXPECT_EQ(loaded.touch_error, saved.touch_error);
  ASSERT_EQ(loaded.points.size(), saved.points.size());
  for (std::size_t i = 0; i < saved.points.size(); ++i) {
    EXPECT_EQ(loaded.points[i].touched.name, saved.points[i].touched.name);
    EXPECT_EQ(loaded.points[i].touched.p_RT, saved.points[i].touched.p_RT);
    EXPECT_EQ(loaded.points[i].leave_one_out, saved.points[i].leave_one_out);
  }
}

TEST(RegistrationFile, TellsWhatIsWrongWithFileLineAndColumn) {
  const std::string text = print_registration(example());
  EXPECT_EQ(file_refusal(text), "accepted");
  EXPECT_THAT(file_refusal(replaced(text, "residual_rms_m", "residual_mm")),
              HasSubstr("mine:16:12: Message type \"omentum.pb.RegistrationFile\" has no field"));
  EXPECT_THAT(file_refusal(replaced(text, "format_version: 1", "format_version: 2")),
              StartsWith("mine:1:1: format_version: 2, allowed: 1"));
  EXPECT_THAT(file_refusal(replaced(text, "prograsp", "scissors")),
              AllOf(StartsWith("mine:3:1: instrument: "), HasSubstr("cadiere")));
  EXPECT_THAT(file_refusal(replaced(text, "date: \"2", "date: \"x2")),
              StartsWith("mine:2:1: date: "));
  EXPECT_THAT(file_refusal(replaced(text, "q_wxyz: ", "q_wxyz: 2 # ")),
              HasSubstr("quaternion of length"));
  EXPECT_THAT(file_refusal(replaced(text, "q_wxyz: ", "p_m: 0 q_wxyz: ")), HasSubstr("4 numbers"));
  EXPECT_THAT(file_refusal(replaced(text, "p_m: ", "p_m: nan # ")), HasSubstr("mine:4:1: p_m"));
  EXPECT_THAT(file_refusal(""), StartsWith("mine: format_version: 0"));
}

TEST(RegistrationFile, RefusesFiguresThatDoNotFollowFromItsPoints) {
  const std::string text = print_registration(example());
  EXPECT_THAT(file_refusal(replaced(text, "world_m {\n    x: -0.08", "world_m {\n    x: -0.081")),
              HasSubstr("point[0].residual_m"));
  EXPECT_THAT(file_refusal(replaced(text, "touch_error_m: 0.", "touch_error_m: 0.0")),
              HasSubstr("touch_error_m"));
  EXPECT_THAT(file_refusal(replaced(text, "residual_rms_m: 0.", "residual_rms_m: 0.0")),
              HasSubstr("residual_rms_m"));
  Registration moved = example();
  moved.X_WR.translation().x() += 0.001;
  double sum = 0;
  for (RegisteredPoint& point : moved.points) {
    point.residual = (moved.X_WR * point.touched.p_RT - point.touched.p_WT).norm();
    sum += point.residual * point.residual;
  }
  moved.residual_rms = std::sqrt(sum / 8);
  moved.touch_error = std::sqrt(sum / 6);
  EXPECT_THAT(file_refusal(print_registration(moved)),
              HasSubstr("pose is not the fit of the points"));
}

}  // namespace
}  // namespace omentum

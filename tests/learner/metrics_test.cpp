#include "learner/metrics.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <sstream>

#include "core/csv.h"
#include "core/durable_file.h"
#include "learner/json.h"
#include "learner/summary.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

class MetricsTest : public testing::Test {
 protected:
  std::vector<std::string> lines(const std::string& name) const {
    std::ifstream file(folder_ + "/" + name);
    std::vector<std::string> all;
    for (std::string line; std::getline(file, line);) all.push_back(line);
    return all;
  }

  const test::TempDir temp_dir_;
  const std::string& folder_ = temp_dir_.path();
  std::vector<std::string> branches_ = {"x", "y", "z", "gripper"};
};

MetricsRow row_of(const std::vector<std::string>& branches, double steps) {
  MetricsRow row(branches);
  row.set("charts/steps_total", steps);
  row.set("charts/episodic_return", -0.25);
  row.set("losses/entropy_gripper", 0.5);
  return row;
}

TEST_F(MetricsTest, NamesAreThoseOfTheDesign) {
  const std::vector<std::string> names = metric_names(branches_);
  for (const char* name :
       {"charts/SPS", "losses/entropy_x", "losses/kl_gripper", "losses/value_delta",
        "policy/logp_check_max", "ledger/audit_mismatch", "workers/declined", "time/save_s"}) {
    EXPECT_THAT(names, testing::Contains(std::string(name)));
  }
  EXPECT_EQ(std::set<std::string>(names.begin(), names.end()).size(), names.size());
}

TEST_F(MetricsTest, CsvAndJsonHoldOneRowPerUpdate) {
  MetricsWriter writer(folder_, branches_, 0, false);
  for (std::uint64_t k = 1; k <= 3; ++k) {
    ASSERT_TRUE(writer
                    .write(k, 0.5 * static_cast<double>(k),
                           row_of(branches_, 100.0 * static_cast<double>(k)))
                    .has_value());
  }
  const std::vector<std::string> csv = lines("metrics.csv");
  ASSERT_EQ(csv.size(), 4u);
  EXPECT_THAT(csv[0], testing::StartsWith("update,wall_time_s,charts/episodic_return,"));
  EXPECT_THAT(csv[2], testing::StartsWith("2,1.000,-0.25,,"));
  EXPECT_EQ(std::count(csv[0].begin(), csv[0].end(), ','),
            std::count(csv[3].begin(), csv[3].end(), ','));
  const std::vector<std::string> json = lines("metrics.jsonl");
  ASSERT_EQ(json.size(), 3u);
  EXPECT_EQ(json[0],
            "{\"update\":1,\"wall_time_s\":0.5,\"charts/episodic_return\":-0.25,\"charts/"
            "steps_total\":100,"
            "\"losses/entropy_gripper\":0.5}");
}

TEST_F(MetricsTest, AFileThatCannotBeWrittenTakesNoOtherAlong) {
  MetricsWriter writer(folder_, branches_, 0, false);
  ASSERT_TRUE(writer.write(1, 0.5, row_of(branches_, 100)));
  std::filesystem::remove(folder_ + "/metrics.csv");
  std::filesystem::create_directory(folder_ + "/metrics.csv");
  EXPECT_FALSE(writer.write(2, 1.0, row_of(branches_, 200)));
  EXPECT_EQ(lines("metrics.jsonl").size(), 2u);
  EXPECT_EQ(writer.incomplete(), 1u);
}

TEST_F(MetricsTest, ResumeDropsRowsThatWillBeRepeated) {
  {
    MetricsWriter writer(folder_, branches_, 0, false);
    for (std::uint64_t k = 1; k <= 5; ++k)
      (void)writer.write(k, 1, row_of(branches_, 1)).has_value();
  }
  std::ofstream(folder_ + "/metrics.csv", std::ios::app) << "6,1.0,torn";
  MetricsWriter writer(folder_, branches_, 3, false);
  ASSERT_TRUE(writer.write(4, 2, row_of(branches_, 1)).has_value());
  const std::vector<std::string> csv = lines("metrics.csv");
  ASSERT_EQ(csv.size(), 5u);
  EXPECT_THAT(csv[3], testing::StartsWith("3,"));
  EXPECT_THAT(csv[4], testing::StartsWith("4,2.000,"));
  EXPECT_EQ(lines("metrics.jsonl").size(), 4u);
}

TEST_F(MetricsTest, ResumePutsRowsOfOtherColumnsBelowItsOwn) {
  std::ofstream(folder_ + "/metrics.csv")
      << "update,wall_time_s,wire/fuse_level,charts/steps_total,charts/episodic_return\n"
         "1,0.5,,100,-3\n2,0.6,7,200,-2\n";
  { MetricsWriter writer(folder_, branches_, 2, false); }
  const Result<CsvTable> table = load_csv(folder_ + "/metrics.csv");
  ASSERT_TRUE(table) << table.error();
  EXPECT_FALSE(table.value().column("wire/fuse_level"));
  EXPECT_EQ(table.value().numbers("charts/steps_total"), (std::vector<double>{100, 200}));
  EXPECT_EQ(table.value().numbers("charts/episodic_return"), (std::vector<double>{-3, -2}));
}

TEST_F(MetricsTest, TensorboardFileReadsBack) {
  std::string path;
  {
    MetricsWriter writer(folder_, branches_, 0, true);
    path = writer.tensorboard_path();
    MetricsRow row = row_of(branches_, 1234);
    row.set("losses/policy_loss", std::numeric_limits<double>::quiet_NaN());
    ASSERT_TRUE(writer.write(7, 1, row).has_value());
  }
  EXPECT_THAT(fs::path(path).filename().string(), testing::StartsWith("events.out.tfevents."));
  const Bytes bytes = read_whole(path).value();
  const std::vector<pb::TensorboardEvent> events = parse_tensorboard(bytes);
  ASSERT_EQ(events.size(), 2u);
  EXPECT_EQ(events[0].file_version(), "brain.Event:2");
  EXPECT_EQ(events[1].step(), 1234);
  std::map<std::string, float> values;
  for (const auto& value : events[1].summary().value()) values[value.tag()] = value.simple_value();
  EXPECT_EQ(values.at("charts/episodic_return"), -0.25F);
  EXPECT_EQ(values.at("Environment/Cumulative Reward"), -0.25F);
  EXPECT_FALSE(values.contains("losses/policy_loss"));
  for (std::size_t size = 0; size < bytes.size(); ++size) {
    ASSERT_LE(parse_tensorboard(std::span(bytes).first(size)).size(),
              1u);  // a truncated tail is legal
  }
  Bytes flipped = bytes;
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    flipped[i] ^= std::byte{0x10};
    ASSERT_LT(parse_tensorboard(flipped).size(), 2u) << i;
    flipped[i] ^= std::byte{0x10};
  }
}

TEST_F(MetricsTest, FirstRecordHasTheKnownBytes) {
  // Length 24 and its masked CRC as every TensorBoard file of an 24-byte version event begins.
  const TensorboardWriter writer(folder_);
  const Bytes bytes = read_whole(writer.path()).value();
  ASSERT_EQ(bytes.size(), 12u + 24 + 4);
  const std::array<std::uint8_t, 12> expected = {0x18, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22};
  for (std::size_t i = 0; i < 12; ++i)
    EXPECT_EQ(static_cast<std::uint8_t>(bytes[i]), expected[i]) << i;
}

TEST(Json, NumbersAreShortAndMembersKeepTheirOrder) {
  const Json json = {{"z", json_number(1)},
                     {"a\"b\\", "line\nnext\ttab\x01 \xc3\xa9 \xff"},
                     {"small", json_number(1e-5)},
                     {"n", json_number(0.1)},
                     {"count", json_number(1 << 30)},
                     {"inf", json_number(std::numeric_limits<double>::infinity())}};
  EXPECT_EQ(
      json_text(json, -1),
      "{\"z\":1,\"a\\\"b\\\\\":\"line\\nnext\\ttab\\u0001 \xc3\xa9 \xef\xbf\xbd\",\"small\":1e-05,"
      "\"n\":0.1,\"count\":1073741824,\"inf\":null}");
}

TEST(RunSummary, HoldsTheKeysReadersLookFor) {
  RunSummary summary;
  summary.weights_hash = "00ff";
  summary.steps = 1000;
  summary.wall_s = 2.5;
  summary.timings["update"] = 1.5;
  EvaluationSummary grid;
  grid.name = "grid100_greedy";
  grid.figures.starts = 100;
  grid.figures.target_reached = 99;
  grid.best_exposure = 0.5;
  summary.evaluations.push_back(grid);
  const std::string text = summary_json(summary);
  EXPECT_THAT(text, testing::HasSubstr("\"weights_hash\": \"00ff\""));
  EXPECT_THAT(text, testing::HasSubstr("\"steps\": 1000"));
  EXPECT_THAT(text, testing::HasSubstr("\"timings\": {\n    \"update\": 1.5\n  }"));
  EXPECT_THAT(text, testing::HasSubstr("\"best_exposure\": 0.5,\n      \"failed\": 0"));
  EXPECT_THAT(
      text,
      testing::HasSubstr(
          "\"name\": \"grid100_greedy\",\n      \"starts\": 100,\n      \"target_reached\": 99"));
}

}  // namespace
}  // namespace omentum

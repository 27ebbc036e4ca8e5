// Tables of recording folders: docs/formats.md 3.

#include "core/table.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "core/check.h"
#include "core/rng.h"

namespace omentum {
namespace {

/// The one line with which a text is refused; empty = it was read.
std::string table_refusal(const std::string& text) {
  try {
    parse_table("tool.csv", text);
    return {};
  } catch (const Error& error) {
    return error.what();
  }
}

TEST(Table, UnitsBecomeSiByTheNameOfTheColumn) {
  const Table t = parse_table("t", "t_ms,x_mm,jaw_deg,dq_deg_per_s,m_g,tip_qw\n20,3,180,90,5,1\n");
  EXPECT_THAT(t.names,
              testing::ElementsAre("t_s", "x_m", "jaw_rad", "dq_rad_per_s", "m_kg", "tip_qw"));
  EXPECT_DOUBLE_EQ(t.column("t_s")[0], 0.02);
  EXPECT_DOUBLE_EQ(t.column("x_m")[0], 0.003);
  EXPECT_NEAR(t.column("jaw_rad")[0], M_PI, 1e-15);
  EXPECT_NEAR(t.column("dq_rad_per_s")[0], M_PI / 2, 1e-15);
  EXPECT_DOUBLE_EQ(t.column("m_kg")[0], 0.005);
}

TEST(Table, RefusalsNameFileLineAndColumn) {
  EXPECT_EQ(table_refusal(""), "tool.csv:1: no header line");
  EXPECT_EQ(table_refusal("t_s,x_m\n0,1\n1,nan\n"),
            "tool.csv:3:3: \"nan\" in column x_m is no finite number");
  EXPECT_EQ(table_refusal("t_s,x_m\n0,1e999\n"),
            "tool.csv:2:3: \"1e999\" in column x_m is no finite number");
  EXPECT_EQ(table_refusal("t_s,x_m\n0\n"), "tool.csv:2: row of 1 cells, needed 2");
  EXPECT_EQ(table_refusal("t_s,x_m\n0,1,2\n"), "tool.csv:2: row of 3 cells, needed 2");
  EXPECT_EQ(table_refusal("t_s,t_ms\n"), "tool.csv:1:5: column t_s appears twice");
  EXPECT_THAT(table_refusal("t_s,x_furlong\n"),
              testing::StartsWith("tool.csv:1:5: column \"x_furlong\""));
  EXPECT_THAT(table_refusal("v_cm_per_s\n"),
              testing::StartsWith("tool.csv:1:1: column \"v_cm_per_s\""));
}

TEST(Table, AMissingColumnIsNamed) {
  const Table t = parse_table("tool.csv", "t_s\n0\n");
  try {
    t.column("tip_commanded_x_m");
    FAIL();
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "tool.csv:1: column tip_commanded_x_m is missing");
  }
}

TEST(Table, TimeMustIncreaseAndComesFromTheRateWithoutAColumn) {
  try {
    table_times(parse_table("t", "t_s\n0\n\n1\n1\n"), 50);
    FAIL();
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(), "t:5:1: t_s 1 after 1, needed increasing");
  }
  EXPECT_THAT(table_times(parse_table("t", "x_m\n5\n6\n7\n"), 50),
              testing::ElementsAre(0.0, 0.02, 0.04));
}

TEST(Table, EveryPrefixAndEveryChangedByteIsReadOrRefused) {
  const std::string text = "t_s,x_mm\r\n0,1.5\r\n0.02,-2e-3\r\n";
  int refused = 0;
  for (std::size_t length = 0; length <= text.size(); ++length)
    refused += table_refusal(text.substr(0, length)).empty() ? 0 : 1;
  for (std::size_t at = 0; at < text.size(); ++at) {
    for (int byte = 0; byte < 256; ++byte) {
      std::string changed = text;
      changed[at] = static_cast<char>(byte);
      refused += table_refusal(changed).empty() ? 0 : 1;
    }
  }
  EXPECT_GT(refused, 1000);
}

}  // namespace
}  // namespace omentum

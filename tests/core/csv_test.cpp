#include "core/csv.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

namespace omentum {
namespace {

/// The one line with which a text is refused; empty = it was read.
std::string csv_refusal(const std::string& text) {
  const Result<CsvTable> read = parse_csv("f.csv", text);
  return read ? std::string() : read.error();
}

TEST(Csv, QuotedCellsHoldCommasQuotesAndLineEnds) {
  const CsvTable table = parse_csv("f.csv", "a, b\r\n1 ,\"x, \"\"y\"\"\n\"\n\n 2,\n").value();
  ASSERT_EQ(table.header.size(), 2u);
  EXPECT_EQ(table.header[1].text, "b");
  ASSERT_EQ(table.rows.size(), 2u);
  EXPECT_EQ(table.rows[0][1].text, "x, \"y\"\n");
  EXPECT_THAT(table.lines, testing::ElementsAre(2, 5));
  EXPECT_EQ(table.place(1, 1), "f.csv:5:4");
  EXPECT_EQ(table.number(1, "a"), 2);
  EXPECT_TRUE(std::isnan(table.number(1, "b")));
  EXPECT_TRUE(std::isnan(table.number(0, "none")));
  EXPECT_TRUE(table.numbers("none").empty());
}

TEST(Csv, RefusalsNameFileLineAndCharacter) {
  EXPECT_EQ(csv_refusal(""), "f.csv:1: no header line");
  EXPECT_EQ(csv_refusal(" \n\t\n"), "f.csv:1: no header line");
  EXPECT_EQ(csv_refusal("a,b\n1\n"), "f.csv:2: row of 1 cells, needed 2");
  EXPECT_EQ(csv_refusal("a,b\n1,2\n1,2,3"), "f.csv:3: row of 3 cells, needed 2");
  EXPECT_EQ(csv_refusal("a,b\n1,2\"\n"), "f.csv:2:4: quote inside a cell");
  EXPECT_EQ(csv_refusal("a,b\n1,\"2\"3\n"), "f.csv:2:6: text behind a quote");
  EXPECT_EQ(csv_refusal("\"a\n"), "f.csv:1:1: quote is never closed");
}

TEST(Csv, ALastRowThatWasCutOffIsLeftOutAndNamed) {
  for (const char* text : {"a,b\n1,2\n3", "a,b\n1,2\n3,\"4"}) {
    const Result<CsvTable> read = parse_csv("f.csv", text);
    ASSERT_TRUE(read) << read.error();
    EXPECT_EQ(read.value().rows.size(), 1u);
    EXPECT_THAT(read.value().cut_off, testing::StartsWith("f.csv:3"));
  }
  EXPECT_EQ(parse_csv("f.csv", "a,b\n1,2").value().rows.size(), 1u) << "complete without line end";
}

TEST(Csv, TextWhereNumbersAreNeededIsNamed) {
  EXPECT_TRUE(parse_csv("f.csv", "a,b\n1e-3,\nnan,-inf\n").value().require_numbers());
  EXPECT_EQ(parse_csv("f.csv", "a,b\n1,2\n3, 4x\n").value().require_numbers().error(),
            "f.csv:3:3: \"4x\" in column b is no number");
  EXPECT_FALSE(parse_csv("f.csv", "a\n1e999\n").value().require_numbers());
}

TEST(Csv, AFileThatIsNotThereIsNamed) {
  EXPECT_EQ(load_csv("/nonexistent/f.csv").error(), "/nonexistent/f.csv: cannot be opened: No such file or directory");
}

}  // namespace
}  // namespace omentum

#include "core/log.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/printable.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using testing::Not;

std::size_t count(const std::string& text, const std::string& part) {
  std::size_t found = 0;
  for (std::size_t at = 0; (at = text.find(part, at)) != std::string::npos; ++at) ++found;
  return found;
}

// A process of its own: what was kept back is told when it ends.
TEST(Log, WarningsThatRepeatAreToldFiveTimesAMinuteAndCounted) {
  const auto flood = [] {
    for (int i = 0; i < 1000; ++i) log().warn("event=not_taken number={}", i);
    for (int i = 0; i < 1000; ++i) log().error("metrics: disk {} is full", i);
    for (int i = 0; i < 7; ++i) log().info("event=joined number={}", i);
    log().warn("event=another number=1");
  };
  testing::internal::CaptureStderr();
  flood();
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_EQ(count(said, "event=not_taken number="), 5U) << said;
  EXPECT_EQ(count(said, "metrics: disk "), 5U) << said;
  EXPECT_EQ(count(said, "event=joined"), 7U) << said;
  EXPECT_EQ(count(said, "event=another"), 1U) << said;
  EXPECT_EXIT(
      {
        flood();
        std::exit(0);
      },
      testing::ExitedWithCode(0), "event=not_taken ... .* more like it kept back");
}

TEST(Log, NamesOfStrangersReachNoTerminalRaw) {
  EXPECT_EQ(printable("a\x1b[2J\x07 b\xc2\x9b"
                      "c\nd\xc3\xa4"),
            "a?[2J? b??c\nd\xc3\xa4");
  testing::internal::CaptureStderr();
  log().info("event=joined host={}", "\x1b]0;title");
  EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("host=?]0;title"));
}

}  // namespace
}  // namespace omentum

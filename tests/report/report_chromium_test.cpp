// The report in a real browser: opens from file://, runs without a script error, and the replay
// draws another picture when the slider moves. Skipped where no chromium is installed.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <regex>
#include <string>

#include "report/report.h"
#include "tests/support/paper_scene.h"
#include "tests/support/synthetic_run.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::StartsWith;

std::string output_of(const std::string& command) {
  std::string text;
  FILE* pipe = ::popen(command.c_str(), "r");
  if (pipe == nullptr) return text;
  std::array<char, 65536> buffer{};
  for (std::size_t got = 0; (got = std::fread(buffer.data(), 1, buffer.size(), pipe)) > 0;)
    text.append(buffer.data(), got);
  ::pclose(pipe);
  return text;
}

std::string find_chromium() {
  std::string path =
      output_of("command -v chromium || command -v chromium-browser || command -v google-chrome");
  while (!path.empty() && path.back() == '\n') path.pop_back();
  return path;
}

class ReportChromium : public testing::TestWithParam<const char*> {
 protected:
  void SetUp() override {
    chromium_ = find_chromium();
    if (chromium_.empty()) GTEST_SKIP() << "chromium is not installed";
    folder_ = fs::path(testing::TempDir()) /
              ("report_chromium_" + std::to_string(::getpid()) + "_" + (GetParam() + 1));
    test::write_synthetic_run((folder_ / "run").string(), 1);
  }
  void TearDown() override {
    std::error_code ignored;
    if (!folder_.empty()) fs::remove_all(folder_, ignored);
  }

  std::string chromium_;
  fs::path folder_;
};

TEST_P(ReportChromium, ReplayMovesWithTheSlider) {
  const Scene scene = test::make_paper_scene();
  const fs::path page = folder_ / "report.html";
  std::ofstream(page, std::ios::binary)
      << make_report(load_runs({(folder_ / "run").string()}), &scene);
  const std::string dom = output_of(
      "timeout 60 '" + chromium_ + "' --headless=new --no-sandbox --disable-gpu --user-data-dir='" +
      (folder_ / "profile").string() +
      "' --virtual-time-budget=20000 --window-size=1280,1600 --dump-dom 'file://" + page.string() +
      GetParam() + "' 2>/dev/null");
  std::smatch found;
  ASSERT_TRUE(std::regex_search(dom, found, std::regex("data-selftest=\"([^\"]*)\"")))
      << "the script did not reach its end; page of " << dom.size() << " bytes";
  const std::string verdict = found[1];
  EXPECT_THAT(verdict, StartsWith("ok "));
  const bool fallback = std::string(GetParam()) == "#selftest-2d";
  EXPECT_THAT(verdict, HasSubstr(fallback ? "painter=2d" : "painter="));
  RecordProperty("verdict", verdict);
}

INSTANTIATE_TEST_SUITE_P(Painters, ReportChromium, testing::Values("#selftest", "#selftest-2d"),
                         [](const auto& test) {
                           return std::string(test.param) == "#selftest" ? "AsTheBrowserCan"
                                                                         : "Canvas2d";
                         });

}  // namespace
}  // namespace omentum

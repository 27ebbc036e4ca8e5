// The report in a real browser: opens from file://, runs without a script error, the replay draws
// another picture when the slider moves or a key is pressed, and the page can be read on a phone.
// Skipped where no chromium is installed.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <cstdio>
#include <fstream>
#include <functional>
#include <regex>
#include <string>

#include "report/report.h"
#include "tests/support/paper_scene.h"
#include "tests/support/synthetic_run.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using testing::HasSubstr;
using testing::Not;
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

/// A report of a made-up run, and a browser.
class Browser : public testing::Test {
 protected:
  void SetUp() override {
    chromium_ = find_chromium();
    if (chromium_.empty()) GTEST_SKIP() << "chromium is not installed";
    test::write_synthetic_run(folder_ / "run", 1);
  }
  /// The file, with some more markup at its end.
  std::string write_page(const std::string& more) const {
    const Scene scene = test::make_paper_scene();
    std::ofstream(folder_ / "report.html", std::ios::binary)
        << make_report(load_runs({folder_ / "run"}), &scene) << more;
    return folder_ / "report.html";
  }
  /// What the document is when its scripts have run.
  std::string dom_of(const std::string& address) const {
    return output_of("timeout 60 '" + chromium_ +
                     "' --headless=new --no-sandbox --disable-gpu --user-data-dir='" +
                     (folder_ / "profile") +
                     "' --virtual-time-budget=20000 --window-size=1280,1600 --dump-dom 'file://" +
                     address + "' 2>/dev/null");
  }

  const test::TempDir folder_;
  std::string chromium_;
};

// Appended to the page: tells the document around it what is smaller than 11 px, cut off, wider
// than the page, or scrolls without saying so.
constexpr const char* kLayoutCheck = R"js(<script>
addEventListener("load", () => {
  const bad = [];
  let texts = 0, scrolling = 0;
  if (document.documentElement.scrollWidth > innerWidth)
    bad.push("page is " + document.documentElement.scrollWidth + " px wide");
  const walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const element = node.parentElement;
    const hidden = element.closest("script, style, option, title, details:not([open]) > :not(summary)");
    if (!node.data.trim() || hidden) continue;
    ++texts;
    const svg = element.ownerSVGElement;
    let size = parseFloat(getComputedStyle(element).fontSize);
    if (svg) {
      const m = element.getScreenCTM(), box = element.getBoundingClientRect(), frame = svg.getBoundingClientRect();
      size *= Math.hypot(m.a, m.b);
      if (box.left < frame.left - 1 || box.right > frame.right + 1 || box.top < frame.top - 1 || box.bottom > frame.bottom + 1)
        bad.push("cut: " + node.data);
    }
    if (size < 11) bad.push(size.toFixed(1) + " px: " + node.data);
  }
  for (const box of document.querySelectorAll("main *, header *")) {
    if (box.scrollWidth <= box.clientWidth + 1 || getComputedStyle(box).overflowX === "visible") continue;
    if (box.tagName === "SELECT") continue;
    ++scrolling;
    const note = box.previousElementSibling;
    if (box.tabIndex !== 0 || !note || !note.textContent.includes("scroll")) bad.push("scrolls silently: " + box.className);
  }
  parent.postMessage(`width=${innerWidth} texts=${texts} scrolling=${scrolling} bad=[${bad.slice(0, 9).join("; ")}]`, "*");
});
</script>)js";

std::string layout_at(const std::string& width, const std::string& frame,
                      const std::function<std::string(const std::string&)>& dom_of) {
  // A frame, since a window is 500 px wide at least.
  std::ofstream(frame) << "<!doctype html><html><body style='margin:0'><script>"
                          "addEventListener('message', (e) => document.documentElement.dataset."
                          "layout = e.data)</script><iframe style='border:0' height='9000' width='"
                       << width << "' src='report.html'></iframe></body></html>";
  const std::string dom = dom_of(frame);
  std::smatch found;
  const bool told = std::regex_search(dom, found, std::regex("data-layout=\"([^\"]*)\""));
  return told ? found[1].str() : "nothing told, page of " + std::to_string(dom.size()) + " bytes";
}

TEST_F(Browser, PhonesAndDesktopsShowNoSmallNoCutAndNoSilentlyScrollingText) {
  write_page(kLayoutCheck);
  const auto dom = [this](const std::string& address) { return dom_of(address); };
  for (const std::string width : {"420", "1280"}) {
    const std::string layout = layout_at(width, folder_ / "frame.html", dom);
    EXPECT_THAT(layout, StartsWith("width=" + width + " texts="));
    EXPECT_THAT(layout, HasSubstr("bad=[]"));
    if (width == "420") {
      EXPECT_THAT(layout, Not(HasSubstr("scrolling=0"))) << "tables are wide";
    }
  }
}

class ReportChromium : public Browser, public testing::WithParamInterface<const char*> {};

TEST_P(ReportChromium, ReplayMovesWithTheSliderAndByKeys) {
  const std::string dom = dom_of(write_page("") + GetParam());
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

#include "report/report.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <regex>

#include "core/check.h"
#include "core/config.h"
#include "report/episodes.h"
#include "report/html.h"
#include "report/plot.h"
#include "report/replay3d.h"
#include "report/section_parts.h"
#include "report/sections.h"
#include "report/skin.h"
#include "report/statistics.h"
#include "tests/support/episode_fixture.h"
#include "tests/support/paper_scene.h"
#include "tests/support/synthetic_run.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::Not;

/// Three made-up seeds in a folder that goes away with the test program.
class ReportTest : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder_ =
        (fs::path(testing::TempDir()) / ("report_test_" + std::to_string(::getpid()))).string();
    for (int seed = 1; seed <= 3; ++seed)
      test::write_synthetic_run(folder_ + "/seed" + std::to_string(seed), seed);
  }
  static void TearDownTestSuite() { fs::remove_all(folder_); }

  static std::string folder_;
};
std::string ReportTest::folder_;

TEST(ShownNumber, HasUnitsOfPeopleAndTheDigitsThatItsIntervalJustifies) {
  const auto text = [](double value, double low, double high, const char* unit) {
    const ShownNumber shown = show_number(value, low, high, unit);
    return shown.value + shown.unit + " " + shown.low + " " + shown.high;
  };
  EXPECT_EQ(text(5234, 4900, 5600, "Pa"), "5.23 kPa 4.90 5.60");
  EXPECT_EQ(text(0.0085, 0.007, 0.0103, "m"), "8.5 mm 7.0 10.3");
  EXPECT_EQ(text(431234, 298765, 520000, "Pa/m"), "430000 Pa/m 300000 520000");
  EXPECT_EQ(text(2.04e-9, 1.5e-9, 2.6e-9, "m^2/N"), "2e-09 m^2/N 1.5e-09 2.6e-09");
  const double none = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(text(0.04567, none, none, "1"), "0.0457 - -");
  EXPECT_EQ(text(0.0823, 0.071, 0.094, "s"), "82 ms 71 94");
  EXPECT_EQ(text(0.9, 0.5, 1.6, "s"), "0.9 s 0.5 1.6") << "one unit for all three";
  EXPECT_EQ(text(0.0012, none, none, "m/N"), "1.2 mm/N - -");
  EXPECT_EQ(text(431234, 298765, 520000, "N/m3"), "0.43 kPa/mm 0.30 0.52");
}

TEST(ShownNumber, StandsInALineWithItsInterval) {
  const double none = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(number_in_line(52013, 49310, 54790, "Pa"), "52.0 kPa (49.3 - 54.8)");
  EXPECT_EQ(number_in_line(0.45, 0.41, 0.49, "1"), "0.450 (0.410 - 0.490)");
  EXPECT_EQ(number_in_line(0.003, none, none, "m"), "3 mm");
}

TEST(EpisodeRecording, FrameStateIsWhatTheFrameShows) {
  EpisodeRecording episode = test::make_episode(10, 4, 5);
  EXPECT_EQ(frame_state(episode, 0).tool_position[1], 0.05F) << "the start of the tool";
  const FrameState middle = frame_state(episode, 1);
  EXPECT_EQ(middle.step, 5);
  EXPECT_DOUBLE_EQ(middle.time, 0.1);
  EXPECT_EQ(middle.tool_position[2], episode.segment.tool_positions_in_world_m[4 * 3 + 2])
      << "after step 4";
  EXPECT_EQ(middle.exposure, episode.segment.exposures[4]);
  EXPECT_FALSE(middle.held);
  const FrameState last = frame_state(episode, 2);
  EXPECT_EQ(last.step, 10);
  EXPECT_EQ(last.exposure, episode.segment.exposures[9]);
  EXPECT_TRUE(last.held);
}

TEST(Wilson, KnownIntervals) {
  // 100 of 100: [n / (n + z^2), 1]; 9 of 25 from the closed form.
  const Proportion all = wilson(100, 100);
  EXPECT_NEAR(all.low, 100 / (100 + 3.8414588), 1e-6);
  EXPECT_DOUBLE_EQ(all.high, 1);
  const Proportion some = wilson(9, 25);
  EXPECT_NEAR(some.low, 0.2025, 5e-4);
  EXPECT_NEAR(some.high, 0.5548, 5e-4);
  EXPECT_EQ(wilson(0, 0).high, 1);
}

TEST(Band, IsMeanAndRangeOnTheCommonRange) {
  const Band band = band_of({{{0, 10}, {0, 10}}, {{2, 12}, {4, 14}}}, 9);
  EXPECT_DOUBLE_EQ(band.x.front(), 2);
  EXPECT_DOUBLE_EQ(band.x.back(), 10);
  EXPECT_DOUBLE_EQ(band.mean.front(), 3);  // 2 and 4
  EXPECT_DOUBLE_EQ(band.low.back(), 10);
  EXPECT_DOUBLE_EQ(band.high.back(), 12);
  EXPECT_TRUE(band_of({{{0, 1}, {0, 0}}, {{2, 3}, {0, 0}}}).x.empty());
  EXPECT_TRUE(band_of({}).x.empty());
}

TEST(Ticks, AreRoundAndCover) {
  EXPECT_EQ(make_ticks(0, 1, 5), (std::vector<double>{0, 0.2, 0.4, 0.6000000000000001, 0.8, 1}));
  EXPECT_EQ(make_ticks(3, 3, 5), (std::vector<double>{3}));
  EXPECT_LT(make_ticks(-1e300, 1e300, 5).size(), 20);
  EXPECT_EQ(short_number(3e6), "3 M");
  EXPECT_EQ(short_number(500e3), "500 k");
}

TEST(Html, EscapesAndEncodes) {
  EXPECT_EQ(escape_html("<a href=\"x\">&\x01"), "&lt;a href=&quot;x&quot;&gt;&amp;?");
  EXPECT_EQ(base64(""), "");
  EXPECT_EQ(base64("f"), "Zg==");
  EXPECT_EQ(base64("fo"), "Zm8=");
  EXPECT_EQ(base64("foobar"), "Zm9vYmFy");
}

TEST(Plot, GapsAndEmptyChartsAreDrawn) {
  LineChart chart;
  chart.title = "a < b";
  EXPECT_THAT(draw_line_chart(chart), HasSubstr("a &lt; b"));
  chart.series.push_back({"s", {0, 1, 2, 3}, {0, NAN, 1, 2}, {}, {}, 1});
  const std::string svg = draw_line_chart(chart);
  EXPECT_THAT(svg, Not(HasSubstr("nan")));
  EXPECT_THAT(svg, HasSubstr("M"));
  HeatMap map;
  map.rows = map.columns = 2;
  map.value = {0, 0.5, NAN, 1};
  EXPECT_THAT(draw_heat_map(map), HasSubstr("not evaluated"));
}

/// Tissue sampled in the committed fat pad, in B, particles 4 mm apart.
TissueBody make_pad_tissue() {
  TissueBody tissue;
  const TriangleMesh pad =
      load_closed_mesh(std::string(OMENTUM_TESTS_DIR) + "/fixtures/fat_pad.obj", 0.001);
  tissue.surface_is_particles = false;
  tissue.surface_vertices = pad.vertices;
  tissue.surface_triangles = pad.triangles;
  tissue.X_WB =
      Eigen::Translation3d(-0.01, 0.05, 0.05) * Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitX());
  std::vector<Eigen::Vector3d> grid;
  for (int k = 0; k < 25 * 20 * 5; ++k) {
    const int row = k / 25 % 20;
    const int layer = k / 500;
    grid.emplace_back(-0.04 + 0.004 * (k % 25), -0.045 + 0.004 * row, -0.006 + 0.004 * layer);
  }
  const std::vector<bool> inside = points_inside(pad, grid);
  for (std::size_t k = 0; k < grid.size(); ++k) {
    if (inside[k]) tissue.particles.push_back(grid[k]);
  }
  return tissue;
}

TEST(SurfaceSkin, FollowsTheParticlesOfAVolume) {
  const TissueBody tissue = make_pad_tissue();
  ASSERT_GT(tissue.particles.size(), 100);
  const SurfaceSkin skin(tissue);
  EXPECT_EQ(skin.vertices(), tissue.surface_vertices.size());
  const Eigen::Vector3d shift(0.003, -0.002, 0.01);
  std::vector<float> moved;
  for (const Eigen::Vector3d& p_B : tissue.particles) {
    const Eigen::Vector3d p = tissue.X_WB * p_B + shift;
    for (const double value : p) moved.push_back(static_cast<float>(value));
  }
  const std::vector<float> vertices = skin.apply(moved);
  for (std::size_t k = 0; k < tissue.surface_vertices.size(); ++k) {
    const Eigen::Vector3d expected = tissue.X_WB * tissue.surface_vertices[k] + shift;
    // 0.1 um: four float products of lengths below 0.1 m.
    EXPECT_LT((Eigen::Vector3f::Map(vertices.data() + 3 * k).cast<double>() - expected).norm(),
              1e-7);
  }
}

TEST(SurfaceSkin, OfASheetIsTheParticles) {
  const Scene scene = test::make_paper_scene();
  const SurfaceSkin skin(scene.tissue);
  const std::vector<float> positions = test::rest_positions(scene);
  EXPECT_EQ(skin.apply(positions), positions);
}

TEST_F(ReportTest, FindsTheSeedsOfAFolder) {
  const std::vector<RunFolder> runs = load_runs({folder_});
  ASSERT_EQ(runs.size(), 3);
  EXPECT_EQ(runs[0].name, "seed1");
  EXPECT_EQ(runs[0].metrics.rows.size(), 293);
  EXPECT_EQ(runs[0].evaluations.at("grid100_greedy").starts.size(), 100);
  EXPECT_EQ(runs[0].evaluations.at("robot25_greedy").rows, 5);
  EXPECT_EQ(runs[0].lattice.size(), 961);
  EXPECT_EQ(runs[0].recordings.size(), 5);
  EXPECT_EQ(runs[0].figures[0].command, "train.sh --set a=1,b=2");
  EXPECT_THAT(runs[0].warnings, testing::IsEmpty());
  EXPECT_EQ(load_runs({folder_ + "/seed1", folder_ + "/seed2"}).size(), 2);
  EXPECT_THROW(load_runs({folder_ + "/none"}), Error);
}

TEST_F(ReportTest, ChoosesBestAndWorstRecording) {
  const std::vector<RunFolder> runs = load_runs({folder_});
  std::vector<std::string> warnings;
  const std::vector<ShownEpisode> episodes = choose_episodes(runs, 3, warnings);
  ASSERT_EQ(episodes.size(), 3);
  EXPECT_EQ(episodes.front().start.index, 75);
  EXPECT_EQ(episodes.back().start.index, 19);
  EXPECT_EQ(grasp_frame(episodes.front().recording), 19);  // held from step 190, a frame every 10
  EXPECT_THAT(warnings, testing::IsEmpty());
}

TEST_F(ReportTest, IsSelfContained) {
  const Scene scene = test::make_paper_scene();
  const std::string html = make_report(load_runs({folder_}), &scene);
  EXPECT_THAT(html, Not(HasSubstr("http://")));
  EXPECT_THAT(html, Not(HasSubstr("https://")));
  EXPECT_THAT(html, Not(HasSubstr("@import")));
  EXPECT_THAT(html, Not(HasSubstr("fetch(")));
  EXPECT_THAT(html, Not(HasSubstr("XMLHttpRequest")));
  const std::regex reference("(src|href)=\"([^\"]{0,20})");
  for (std::sregex_iterator it(html.begin(), html.end(), reference), end; it != end; ++it) {
    const std::string target = (*it)[2];
    EXPECT_TRUE(target.rfind("data:", 0) == 0 || target.rfind('#', 0) == 0) << target;
  }
  EXPECT_EQ(html.find("<script>alert(1)"), std::string::npos) << "the configuration is text";
  EXPECT_THAT(html, HasSubstr("300 / 300"));
  // Texts and marks of the task come from the configuration, and they are text.
  EXPECT_THAT(html, HasSubstr("Lift &lt;script&gt;alert(1)&lt;/script&gt;."));
  EXPECT_THAT(html, HasSubstr("Reward per step (figure &lt;i&gt;4&lt;/i&gt;)"));
  EXPECT_THAT(html, HasSubstr("approach &amp; more"));
  EXPECT_THAT(html, HasSubstr("Two &lt;b&gt;starts"));
  EXPECT_THAT(html, HasSubstr("(8, 6): shown"));
  EXPECT_THAT(html, HasSubstr("slip force [N]"));
  EXPECT_THAT(html, HasSubstr("replay-block-3"));
  EXPECT_LT(html.size(), 12'000'000);
  EXPECT_EQ(html, make_report(load_runs({folder_}), &scene)) << "same input, same text";
}

TEST_F(ReportTest, WorksWithoutSceneAndWithHalfOfTheFiles) {
  const std::string poor = folder_ + "/../poor_" + std::to_string(::getpid());
  fs::create_directories(poor + "/evaluation");
  std::ofstream(poor + "/metrics.csv") << "charts/steps_total,charts/episodic_return\n1,2\n3";
  std::ofstream(poor + "/evaluation/grid100_greedy.csv")
      << "index,row,column,exposure,reached\n0,1,1,0.5,1\n7,99999,-5,nan,1\n";
  std::ofstream(poor + "/evaluation/grid100_sampled.csv")
      << "index,row,column,exposure,reached\n0,1,1,0.5,x\n";
  const std::string html = make_report(load_runs({poor}), nullptr);
  fs::remove_all(poor);
  EXPECT_THAT(html, HasSubstr("No recordings"));
  EXPECT_THAT(html, HasSubstr("No grasp lattice"));
  EXPECT_THAT(html, HasSubstr("No grasp study"));
  EXPECT_THAT(html, HasSubstr("metrics.csv:3: row of 1 cells"));
  EXPECT_THAT(html, HasSubstr("grid100_sampled.csv:2:11: "));
}

TEST_F(ReportTest, DamagedRecordingBecomesAWarning) {
  const std::string run = folder_ + "/../damaged_" + std::to_string(::getpid());
  fs::copy(folder_ + "/seed1", run, fs::copy_options::recursive);
  std::ofstream(run + "/recordings/grid100_greedy_75.mcap", std::ios::trunc) << "not a recording";
  const Scene scene = test::make_paper_scene();
  const std::string html = make_report(load_runs({run}), &scene);
  fs::remove_all(run);
  EXPECT_THAT(html, HasSubstr("grid100_greedy_75.mcap: corrupt: byte 0: no MCAP magic"));
  EXPECT_THAT(html, HasSubstr("Of the recordings: "));
  EXPECT_THAT(html, HasSubstr("Best: start (7, 5)"));
}

/// A copy of the first seed that a test may change.
class ChangedRun : public ReportTest {
 protected:
  void SetUp() override { fs::copy(folder_ + "/seed1", run_, fs::copy_options::recursive); }
  std::string html(const Scene* scene = nullptr) {
    damaged_.clear();
    return make_report(load_runs({run_}), scene, &damaged_);
  }

  test::TempDir temp_;
  const std::string run_ = temp_ / "run";
  std::vector<std::string> damaged_;
};

TEST_F(ChangedRun, EveryUnreadableRecordingIsToldNotOnlyAShownOne) {
  for (const int index : {64, 42}) {
    const std::string path = fmt::format("{}/recordings/grid100_greedy_{}.mcap", run_, index);
    fs::resize_file(path, index == 64 ? 20 : fs::file_size(path) - 10);
  }
  std::ofstream(run_ + "/recordings/other_0.mcap") << "x";
  fs::copy(run_ + "/recordings/grid100_greedy_53.mcap", run_ + "/recordings/stray_7.mcap");
  const std::string page = html();
  EXPECT_THAT(damaged_, testing::UnorderedElementsAre(
                            HasSubstr("greedy_64.mcap: corrupt: "), HasSubstr("greedy_42.mcap: "),
                            HasSubstr("other_0.mcap: corrupt: "),
                            HasSubstr("stray_7.mcap: no row of it in a table")));
  for (const std::string& line : damaged_) EXPECT_THAT(page, HasSubstr(escape_html(line)));
  EXPECT_THAT(page, HasSubstr("(and 3 more"));
}

TEST_F(ChangedRun, NoneIsBestOrWorstWhereAllAreEqual) {
  const std::string table = run_ + "/evaluation/grid100_greedy.csv";
  std::string text = "index,row,column,exposure,reached\n";
  for (int k = 0; k < 100; ++k)
    text += fmt::format("{},{},{},{},1\n", k, k / 10 + 1, k % 10 + 1, 0.861 + 1e-5 * k);
  std::ofstream(table) << text;
  const Scene scene = test::make_paper_scene();
  const std::string page = html(&scene);
  for (const char* word : {"Best: ", "Worst: ", "best, start", "worst, start", "The best and the"})
    EXPECT_THAT(page, Not(HasSubstr(word)));
  EXPECT_THAT(page, HasSubstr("end with the same exposure: none is best"));
}

TEST_F(ChangedRun, ARunWhoseWorkersDifferedIsNotToBeTrusted) {
  EXPECT_THAT(html(), Not(HasSubstr("not to be trusted")));
  std::ofstream(run_ + "/summary.json")
      << R"({"results_compared": 37, "audit_mismatch": "two results of slot 3 differ: <a> and b"})";
  EXPECT_THAT(html(), testing::AllOf(HasSubstr("run is not to be trusted: two results of slot 3 "
                                               "differ: &lt;a&gt; and b"),
                                     HasSubstr(">37<")));
}

TEST_F(ChangedRun, StartsAreCountedFromTheRowsThatAreThere) {
  const std::string table = run_ + "/evaluation/grid100_greedy.csv";
  std::string text = "index,row,column,exposure,reached\n";
  for (int k = 0; k < 28; ++k) text += fmt::format("{},{},{},0.5,1\n", k, k / 10 + 1, k % 10 + 1);
  std::ofstream(table) << text;
  EXPECT_THAT(html(), testing::AllOf(HasSubstr("28 starts, greedy actions"), HasSubstr("28 / 28"),
                                     Not(HasSubstr("100 starts, greedy"))));
  std::ofstream(run_ + "/config.txtpb") << "scene { start_grid { rows: 10 columns: 10 } }\n";
  EXPECT_THAT(html(), HasSubstr("28 of 100 starts, greedy actions"));
}

TEST_F(ChangedRun, WhatCountsAsExposedIsTold) {
  std::ofstream(run_ + "/evaluation/grid100_greedy.csv")
      << "index,row,column,exposure,reached,held,exposed,best_exposure\n0,1,1,0.5,1,1,0,0.8\n";
  fs::remove(run_ + "/evaluation/grid100_sampled.csv");
  fs::remove(run_ + "/evaluation/robot25_greedy.csv");
  EXPECT_THAT(html(), HasSubstr("Exposed: reached, held, and at the end at least 90 % of the "
                                "exposure of the best grasp of the lattice, here 72.0 %."));
}

TEST_F(ChangedRun, TitlesHaveTheUnitsOfTheirAxes) {
  const std::string page = html();
  EXPECT_THAT(page, HasSubstr("<figcaption>min pinch</figcaption>"));
  EXPECT_THAT(page, HasSubstr("min pinch [mm]"));
  EXPECT_THAT(page, Not(HasSubstr("min_pinch_m")));
}

TEST(DrawnSection, ShowsSuccessOverTheValuesOfEachParameter) {
  RunFolder run;
  run.name = "robust";
  std::vector<EvaluationRow> rows(10);
  for (std::size_t k = 0; k < rows.size(); ++k) {
    rows[k].index = static_cast<std::uint32_t>(k);
    rows[k].row = 1;
    rows[k].column = static_cast<std::uint32_t>(k + 1);
    rows[k].drawn = 0.01 * static_cast<double>((7 * k) % 10);  // in no order
    rows[k].reached = rows[k].drawn < 0.05;
  }
  run.evaluations["drawn10_arm.transport_delay_s_sampled"] = {rows, 1, 10, 10};
  const Section section = make_drawn_section({run});
  EXPECT_THAT(section.content, HasSubstr("arm.transport_delay_s"));
  EXPECT_THAT(make_grid_section({run}).content, Not(HasSubstr("drawn alone")))
      << "shown once, as a curve";
  EXPECT_EQ(drawn_parameter("drawn100_arm.droop_s_sampled"), "arm.droop_s");
  EXPECT_EQ(drawn_parameter("drawn100_greedy"), "");
  EXPECT_EQ(drawn_parameter("grid100_greedy"), "");
  run.evaluations.clear();
  EXPECT_EQ(make_drawn_section({run}).content, "");
}

// "Approach" is a stage of the paper's training, its figures 4, 5 and 7 are of its task.
TEST(Presets, OnlyThePapersShowThePapersStages) {
  for (const std::string& preset : preset_names()) {
    RunFolder run;
    run.name = preset;
    run.config = load_config(preset, {});
    run.config_text = "x";
    run.metrics = parse_csv("metrics.csv",
                            "charts/steps_total,charts/episodic_return,charts/episodic_length\n"
                            "1,-3,10\n3000000,-2,10\n")
                      .value();
    EvaluationRow start;
    start.row = start.column = 1;
    run.evaluations["grid1_greedy"] = {{start}, 1, 1, 1};
    const std::string page = make_report({run}, nullptr);
    const bool paper = preset.starts_with("paper");
    for (const char* word :
         {">approach</text>", "the paper&#39;s figure 4", "paper's figure", "where the paper"}) {
      if (!paper) {
        EXPECT_THAT(page, Not(HasSubstr(word))) << preset;
      }
    }
    EXPECT_EQ(page.find(">approach</text>") != std::string::npos, paper) << preset;
  }
}

}  // namespace
}  // namespace omentum

// The programs learn, evaluate and record; recordings run again bit for bit.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <regex>

#include "core/episode_recording.h"
#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::Finished;
using test::operator+;
using test::Programs;
using test::read_text;
using test::Strings;
using test::tiny_task;

Strings cells(const std::string& line) {
  Strings found;
  std::istringstream in(line);
  for (std::string cell; std::getline(in, cell, ',');) found.push_back(cell);
  return found;
}

/// Column of a CSV by name, as text.
Strings column(const std::string& csv, const std::string& name) {
  const Strings lines = test::lines_of(csv);
  const Strings head = cells(lines.at(0));
  const auto at = std::find(head.begin(), head.end(), name) - head.begin();
  EXPECT_LT(at, static_cast<std::ptrdiff_t>(head.size())) << name;
  Strings values;
  for (std::size_t i = 1; i < lines.size(); ++i) {
    values.push_back(cells(lines[i]).at(static_cast<std::size_t>(at)));
  }
  return values;
}

// Episodes of 60 steps of 2 mm, the paper's reward. The first three updates, a random walk, have
// returns of -31 ... -36; the last one -8 (measured). -20 lies between.
TEST(Learning, TwoWorkersAndTheLearnerLearnToReach) {
  Programs programs;
  const Strings sets =
      tiny_task() + Strings{"task.reward=REWARD_PAPER", "task.increment_m=0.002",
                            "rollout.slots=16",         "rollout.steps_per_segment=120",
                            "rollout.max_steps=60000",  "ppo.hidden=32",
                            "ppo.minibatch=240",        "ppo.epochs=6",
                            "ppo.learning_rate=0.002",  "ppo.entropy=0.001"};
  programs.train("reach", sets, {{"--lanes", "8"}, {"--lanes", "8"}});
  const double mean_return = std::stod(Programs::value(programs.summary("reach"), "mean_return"));
  EXPECT_GT(mean_return, -20.0);
  // It was not there from the start.
  const Strings returns =
      column(read_text(programs.run_dir("reach") + "/metrics.csv"), "charts/episodic_return");
  ASSERT_GT(returns.size(), 10u);
  EXPECT_LT(std::stod(returns.front()), -28.0);
  RecordProperty("mean_return_x100", static_cast<int>(100 * mean_return));
}

class Evaluated : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    programs_ = std::make_unique<Programs>();
    programs_->train("evaluated", sets(), {{"--lanes", "4"}, {"--lanes", "2"}});
  }
  /// Both grids of 2 x 2, a lattice of 12 grasps, short episodes; starts low enough to touch.
  static Strings sets() {
    return tiny_task() + Strings{"evaluation.enabled=true",
                                 "evaluation.lattice_stride=10",
                                 "task.hold_s=0.2",
                                 "scene.start_grid.rows=2",
                                 "scene.start_grid.columns=2",
                                 "scene.robot_grid.rows=2",
                                 "scene.robot_grid.columns=2",
                                 "scene.start_grid.centre_m={ x: -0.0172 y: 0.0536 z: 0.045 }"};
  }
  static void TearDownTestSuite() { programs_.reset(); }

  static Strings recordings() {
    Strings files;
    for (const auto& entry :
         std::filesystem::directory_iterator(programs_->run_dir("evaluated") + "/recordings")) {
      files.push_back(entry.path().string());
    }
    std::sort(files.begin(), files.end());
    return files;
  }

  static std::unique_ptr<Programs> programs_;
};
std::unique_ptr<Programs> Evaluated::programs_;

TEST_F(Evaluated, RecordingsReplayIdenticallyAtEveryKernelWidth) {
  const Strings files = recordings();
  ASSERT_EQ(files.size(), 8u);
  for (const std::string width : {"0", "8"}) {
    const Finished replay =
        programs_->finish(Strings{OMENTUM_SIM_WORKER, "--lane-width", width, "--replay"} + files);
    EXPECT_EQ(replay.code, 0) << replay.out << replay.err;
    const Strings lines = test::lines_of(replay.out);
    ASSERT_EQ(lines.size(), files.size());
    for (std::size_t i = 0; i < files.size(); ++i) {
      const auto recording = load_episode(files[i]);
      ASSERT_TRUE(recording) << recording.error();
      EXPECT_EQ(lines[i],
                files[i] + ": identical steps=" + std::to_string(recording.value().segment.steps));
    }
  }
}

TEST_F(Evaluated, RecordingsHoldTheTaskThatWasGranted) {
  for (const std::string& file : recordings()) {
    const auto recording = load_episode(file);
    ASSERT_TRUE(recording) << recording.error();
    const RolloutTask& task = recording.value().task;
    EXPECT_EQ(task.kind, TaskKind::kEvaluate);
    // 60 and 10 periods in decisions of two.
    EXPECT_EQ(task.policy_steps, 30u);
    EXPECT_EQ(task.hold_steps, 5u);
    EXPECT_EQ(task.episode_limit, task.steps);
    EXPECT_EQ(task.frame_stride, 10u);
    EXPECT_GE(task.steps, recording.value().segment.steps);
    EXPECT_EQ(task.state_format, kSimStateFormat);
    EXPECT_FALSE(recording.value().segment.state_hashes.empty());
  }
}

TEST_F(Evaluated, ADifferenceIsNamedByStepAndValue) {
  const std::string file = recordings().front();
  auto recording = load_episode(file);
  ASSERT_TRUE(recording);
  EpisodeRecording changed = recording.value();
  changed.segment.rewards[7] += 0.5F;
  const std::string path = programs_->folder() / "changed.mcap";
  ASSERT_TRUE(save_episode(path, changed.task, changed.segment, changed.context));
  const Finished replay = programs_->finish({OMENTUM_SIM_WORKER, "--replay", path, file});
  EXPECT_EQ(replay.code, 1);
  EXPECT_NE(replay.out.find("differs at step 7: reward recorded"), std::string::npos) << replay.out;
  EXPECT_NE(replay.out.find(file + ": identical"), std::string::npos) << replay.out;

  changed = recording.value();
  changed.segment.actions[4 * 3] = 200;  // no branch has so many actions
  ASSERT_TRUE(save_episode(path, changed.task, changed.segment, changed.context));
  const Finished action = programs_->finish({OMENTUM_SIM_WORKER, "--replay", path});
  EXPECT_EQ(action.code, 2);
  EXPECT_NE(action.err.find("action 200 of step 3, allowed below 3"), std::string::npos)
      << action.err;
}

TEST_F(Evaluated, ADamagedFileIsOneLineAndExitCode2) {
  const std::string text = read_text(recordings().front());
  const std::string path = programs_->folder() / "cut.mcap";
  const auto write = [&path](const std::string& content) {
    std::ofstream(path, std::ios::binary) << content;
  };
  write("no recording");
  const Finished garbage = programs_->finish({OMENTUM_SIM_WORKER, "--replay", path});
  EXPECT_EQ(garbage.code, 2);
  EXPECT_EQ(test::lines_of(garbage.err).size(), 1u) << garbage.err;
  EXPECT_NE(garbage.err.find(path + ": corrupt: "), std::string::npos) << garbage.err;
  // A byte of a chunk in the middle: what can be read of it agrees, and the file is corrupt.
  std::string flipped = text;
  flipped[text.size() / 2] = static_cast<char>(flipped[text.size() / 2] ^ 1);
  write(flipped);
  const Finished corrupt = programs_->finish({OMENTUM_SIM_WORKER, "--replay", path});
  EXPECT_EQ(corrupt.code, 2) << corrupt.out;
  EXPECT_NE((corrupt.out + corrupt.err).find("corrupt: byte "), std::string::npos)
      << corrupt.out << corrupt.err;
  write(text.substr(0, text.size() * 3 / 4));
  EXPECT_EQ(programs_->finish({OMENTUM_SIM_WORKER, "--replay", path}).code, 2);
  EXPECT_EQ(programs_->finish({OMENTUM_SIM_WORKER, "--replay", path + ".missing"}).code, 2);
}

TEST_F(Evaluated, AFolderOfRecordingsIsReplayedAndOneWithoutAnyIsNamed) {
  for (const std::string& folder :
       {programs_->run_dir("evaluated"), programs_->run_dir("evaluated") + "/recordings"}) {
    const Finished replay = programs_->finish({OMENTUM_SIM_WORKER, "--replay", folder});
    EXPECT_EQ(replay.code, 0) << replay.err;
    EXPECT_EQ(test::lines_of(replay.out).size(), recordings().size());
  }
  const std::string none = programs_->run_dir("evaluated") + "/evaluation";
  const Finished empty = programs_->finish({OMENTUM_SIM_WORKER, "--replay", none});
  EXPECT_EQ(empty.code, 2);
  EXPECT_NE(empty.err.find(none + ": a folder without recordings"), std::string::npos) << empty.err;
}

TEST_F(Evaluated, EveryColumnOfTheMetricsIsFilled) {
  const std::string csv = read_text(programs_->run_dir("evaluated") + "/metrics.csv");
  for (const std::string& name : cells(test::lines_of(csv).at(0))) {
    const Strings values = column(csv, name);
    EXPECT_TRUE(std::all_of(values.begin(), values.end(), [](const auto& v) { return !v.empty(); }))
        << name;
  }
}

/// Text of the cells of the report's table row that holds all of `keys`.
Strings table_row(const std::string& html, const Strings& keys) {
  for (std::size_t at = html.find("<tr>"); at != std::string::npos;
       at = html.find("<tr>", at + 1)) {
    const std::string row = html.substr(at, html.find("</tr>", at) - at);
    Strings texts;
    for (std::size_t cell = row.find("<td"); cell != std::string::npos;
         cell = row.find("<td", cell + 1)) {
      const std::size_t begin = row.find('>', cell) + 1;
      texts.push_back(row.substr(begin, row.find("</td>", begin) - begin));
    }
    const bool all = std::all_of(keys.begin(), keys.end(), [&](const std::string& key) {
      return std::find(texts.begin(), texts.end(), key) != texts.end();
    });
    if (all) return texts;
  }
  ADD_FAILURE() << "no row with " << keys.front();
  return Strings(10);
}

TEST_F(Evaluated, TheReportTellsTheNumbersOfTheSummary) {
  const std::string run = programs_->run_dir("evaluated");
  const std::string page = programs_->folder() / "report.html";
  ASSERT_EQ(programs_->finish({OMENTUM_REPORT, run, "-o", page}).code, 0);
  const std::string html = read_text(page);
  const std::string summary = programs_->summary("evaluated");
  const auto percent = [](const std::string& share) {
    return fmt::format("{:.1f} %", 100 * std::stod(share));
  };
  const std::pair<const char*, const char*> sets[] = {
      {"grid4_greedy", "4 starts, greedy actions"},
      {"robot4_sampled", "4 starts of the robot, sampled actions"},
      {"grasp_lattice", "grasp lattice, 15 grasps"}};
  for (const auto& [name, words] : sets) {
    const std::string entry = summary.substr(summary.find(fmt::format("\"{}\"", name)));
    const auto value = [&entry](const char* key) { return Programs::value(entry, key); };
    const Strings row = table_row(html, {"evaluated", words});
    EXPECT_EQ(row[2], value("target_reached") + " / " + value("starts")) << name;
    EXPECT_EQ(row[4], value("held")) << name;
    EXPECT_EQ(row[5], value("grasp_held")) << name;
    EXPECT_EQ(row[6], value("exposed")) << name;
    EXPECT_EQ(row[7], percent(value("mean_exposure"))) << name;
    if (std::string(name) != "grasp_lattice") {
      EXPECT_EQ(row[8], fmt::format("{:.1f}", std::stod(value("mean_return")))) << name;
    }
    EXPECT_EQ(row[9], value("failed")) << name;
  }
  const Strings training = table_row(html, {"evaluated", Programs::value(summary, "steps")});
  EXPECT_EQ(training[2], fmt::format("{:.1f}", std::stod(Programs::value(summary, "mean_return"))));
  // What counts as exposed is told, with the number it is of this run.
  const double best = std::stod(Programs::value(summary, "best_exposure"));
  if (best > 0) {
    EXPECT_NE(html.find(fmt::format("here {:.1f} %", 90 * best)), std::string::npos);
  }
  // Console, too.
  const Strings out = test::lines_of(read_text(programs_->out("evaluated")));
  const auto line = std::find_if(out.begin(), out.end(), [](const std::string& text) {
    return text.starts_with("evaluation grasp_lattice");
  });
  ASSERT_NE(line, out.end());
  const std::string entry = summary.substr(summary.find("\"grasp_lattice\""));
  for (const char* key : {"target_reached", "exposed", "grasp_held"})
    EXPECT_NE(line->find(fmt::format("{} {:>3}", key, Programs::value(entry, key))),
              std::string::npos)
        << *line;
}

// One number, whoever asks again: a finished run that is started again has the same means.
TEST_F(Evaluated, AResumedRunTellsTheReturnThatItEndedWith) {
  const std::string before = programs_->summary("evaluated");
  programs_->train("evaluated", sets(), {{"--lanes", "4"}});
  const std::string after = programs_->summary("evaluated");
  for (const char* key : {"mean_return", "episodes", "weights_hash"})
    EXPECT_EQ(Programs::value(after, key), Programs::value(before, key)) << key;
  EXPECT_NE(Programs::value(after, "mean_return"), "0");
}

// docs/formats.md names every column and every field, so that the definitions there are of these.
TEST_F(Evaluated, FormatsNameEveryColumnAndField) {
  const std::string formats =
      read_text(std::string(OMENTUM_TESTS_DIR) + "/../" + "docs/formats.md");
  const std::string folder = programs_->run_dir("evaluated") + "/evaluation/";
  for (const char* table : {"grid4_greedy.csv", "grasp_lattice.csv"}) {
    for (const std::string& name : cells(test::lines_of(read_text(folder + table)).at(0)))
      EXPECT_NE(formats.find(fmt::format("`{}`", name)), std::string::npos) << name;
  }
  const std::string summary = programs_->summary("evaluated");
  const std::regex key("\"([a-z_]+)\":");
  for (std::sregex_iterator it(summary.begin(), summary.end(), key), end; it != end; ++it)
    EXPECT_NE(formats.find(fmt::format("`{}`", (*it)[1].str())), std::string::npos) << (*it)[1];
}

// 12 updates: after the fifth, the tenth and at the end.
TEST_F(Evaluated, OnTheWayAsOftenAsAskedAndTheWeightsStay) {
  programs_->train("on_the_way", sets() + Strings{"evaluation.interval_updates=5"},
                   {{"--lanes", "4"}});
  EXPECT_EQ(Programs::value(programs_->summary("on_the_way"), "weights_hash"),
            Programs::value(programs_->summary("evaluated"), "weights_hash"));
  const std::string folder = programs_->run_dir("on_the_way") + "/evaluation/";
  std::size_t folders = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    if (entry.is_directory()) {
      ++folders;
      continue;
    }
    const std::string name = entry.path().filename().string();
    const Strings lines = test::lines_of(read_text(entry.path().string()));
    for (const char* update : {"update-5/", "update-10/"}) {
      const Strings earlier = test::lines_of(read_text(folder + update + name));
      ASSERT_EQ(earlier.size(), lines.size()) << update << name;
      EXPECT_EQ(earlier.front(), lines.front());
    }
  }
  EXPECT_EQ(folders, 2u);
}

TEST_F(Evaluated, OnTheWayOfTheGridAloneIsMeasuredByTheSameLattice) {
  programs_->train(
      "grid_alone",
      sets() + Strings{"evaluation.interval_updates=5", "evaluation.interval_grid_only=true"},
      {{"--lanes", "4"}});
  EXPECT_EQ(Programs::value(programs_->summary("grid_alone"), "weights_hash"),
            Programs::value(programs_->summary("evaluated"), "weights_hash"));
  const std::string folder = programs_->run_dir("grid_alone") + "/evaluation/";
  for (const char* update : {"update-5/", "update-10/"}) {
    Strings names;
    for (const auto& entry : std::filesystem::directory_iterator(folder + update))
      names.push_back(entry.path().filename().string());
    std::sort(names.begin(), names.end());
    EXPECT_EQ(names, (Strings{"grasp_lattice.csv", "grid4_greedy.csv"})) << update;
    EXPECT_EQ(read_text(folder + update + "grasp_lattice.csv"),
              read_text(folder + "grasp_lattice.csv"));
  }
  // The lattice is scripted: that of another run is the same.
  EXPECT_EQ(read_text(folder + "grasp_lattice.csv"),
            read_text(programs_->run_dir("evaluated") + "/evaluation/grasp_lattice.csv"));
}

TEST_F(Evaluated, TablesAndSummaryAgree) {
  const std::string folder = programs_->run_dir("evaluated") + "/evaluation/";
  const std::string summary = programs_->summary("evaluated");
  const auto count = [](const Strings& values) {
    return std::to_string(std::count(values.begin(), values.end(), "1"));
  };
  const std::string lattice = read_text(folder + "grasp_lattice.csv");
  double best = 0;
  const Strings exposure = column(lattice, "exposure");
  const Strings reached = column(lattice, "reached");
  const Strings held = column(lattice, "held");
  for (std::size_t i = 0; i < exposure.size(); ++i) {
    if (reached[i] == "1" && held[i] == "1") best = std::max(best, std::stod(exposure[i]));
  }
  for (const std::string name :
       {"grid4_greedy", "grid4_sampled", "robot4_greedy", "robot4_sampled", "grasp_lattice"}) {
    const bool is_lattice = name == "grasp_lattice";
    const std::string csv = read_text(folder + name + ".csv");
    const std::size_t at = summary.find("\"" + name + "\"");
    ASSERT_NE(at, std::string::npos) << name << summary;
    const std::string entry = summary.substr(at);
    EXPECT_EQ(Programs::value(entry, "starts"), std::to_string(column(csv, "reached").size()));
    EXPECT_EQ(Programs::value(entry, "target_reached"), count(column(csv, "reached")));
    EXPECT_EQ(Programs::value(entry, "exposed"), count(column(csv, "exposed")));
    EXPECT_EQ(Programs::value(entry, "failed"), count(column(csv, "failed")));
    EXPECT_EQ(Programs::value(entry, "held"), count(column(csv, "held")));
    EXPECT_EQ(Programs::value(entry, "lost"), count(column(csv, "lost")));
    EXPECT_EQ(Programs::value(entry, "grasp_held"), count(column(csv, "grasp_held")));
    double shown = 0;
    for (const std::string& value : column(csv, "exposure")) shown += std::stod(value);
    EXPECT_NEAR(std::stod(Programs::value(entry, "mean_exposure")),
                shown / static_cast<double>(column(csv, "exposure").size()), 1e-12);
    EXPECT_DOUBLE_EQ(std::stod(Programs::value(entry, "best_exposure")), best);
    if (is_lattice) continue;
    for (const std::string& value : column(csv, "best_exposure"))
      EXPECT_DOUBLE_EQ(std::stod(value), best);
  }
  // A recording ends with the exposure and at the place that the table has.
  for (const std::string& file : recordings()) {
    const auto recording = load_episode(file);
    ASSERT_TRUE(recording);
    const std::string csv = read_text(folder + recording.value().context.name + ".csv");
    const Strings index = column(csv, "index");
    const auto row = static_cast<std::size_t>(
        std::find(index.begin(), index.end(), std::to_string(recording.value().task.start_index)) -
        index.begin());
    ASSERT_LT(row, index.size());
    EXPECT_EQ(std::stof(column(csv, "exposure")[row]), recording.value().segment.exposures.back());
  }
}

}  // namespace
}  // namespace omentum

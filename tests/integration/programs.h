#pragma once

#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <functional>
#include <regex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/domain.h"
#include "tests/support/process.h"
#include "tests/support/temp_dir.h"

namespace omentum::test {

using Strings = std::vector<std::string>;

/// A busy machine shared with others: a run of a few seconds gets this long.
inline constexpr std::chrono::seconds kRunTime{120};

inline std::string read_text(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return text.str();
}

inline Strings lines_of(const std::string& text) {
  Strings lines;
  std::istringstream in(text);
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

/// Column of a table such as metrics.csv by name, as numbers.
inline std::vector<double> metric(const std::string& csv, const std::string& name) {
  std::vector<double> values;
  std::size_t at = 0;
  for (const std::string& line : lines_of(csv)) {
    std::istringstream cells(line);
    Strings row;
    for (std::string cell; std::getline(cells, cell, ',');) row.push_back(cell);
    if (values.empty() && at == 0) {
      while (at < row.size() && row[at] != name) ++at;
      EXPECT_LT(at, row.size()) << name;
      if (at >= row.size()) return values;
      continue;
    }
    if (at < row.size() && !row[at].empty()) values.push_back(std::stod(row[at]));
  }
  return values;
}

/// Polls with a deadline; true when it came true.
inline bool eventually(const std::function<bool()>& condition,
                       std::chrono::seconds timeout = kRunTime) {
  const auto end = std::chrono::steady_clock::now() + timeout;
  while (!condition()) {
    if (std::chrono::steady_clock::now() > end) return false;
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  return true;
}

/// What a program that ended said.
struct Finished {
  int code = -1;
  std::string out, err;
};

/// A task of two seconds: 12 x 12 particles, 12 updates of 6 x 32 steps.
inline Strings tiny_task() {
  return {"scene.tissue.grid.count_x=12",
          "scene.tissue.grid.count_y=12",
          "scene.tissue.anchor_max_y_m=-0.014",
          "task.episode_steps=60",
          "rollout.slots=6",
          "rollout.steps_per_segment=32",
          "rollout.max_steps=2304",
          "ppo.hidden=16",
          "ppo.minibatch=64",
          "ppo.epochs=2",
          "evaluation.enabled=false"};
}

inline Strings operator+(Strings a, const Strings& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

/// The same task for a test in which something happens meanwhile: it goes on, on a machine of any
/// speed, until the learner is told to stop.
inline Strings endless_task() { return tiny_task() + Strings{"rollout.max_steps=2000000000"}; }

/// The real programs on a DDS domain and in a folder of their own.
class Programs {
 public:
  Process learner(const std::string& run, const Strings& sets, const Strings& more = {}) {
    Strings arguments = {OMENTUM_LEARNER, "--run", run};
    for (const std::string& set : Strings{"run.domain=" + std::to_string(domain_.id()),
                                          "run.runs_dir=" + (folder_ / "runs")} +
                                      sets) {
      arguments.push_back("--set");
      arguments.push_back(set);
    }
    return Process(arguments + more, out(run), err(run));
  }
  Process worker(const std::string& run, const Strings& more = {}) {
    const std::string log = folder_ / (run + ".worker" + std::to_string(workers_++));
    return Process(
        Strings{OMENTUM_SIM_WORKER, "--run", run, "--domain", std::to_string(domain_.id())} + more,
        log, log + ".err");
  }
  /// Runs a program to its end.
  Finished finish(const Strings& arguments) {
    Process process(arguments, folder_ / "out", folder_ / "err");
    Finished finished;
    finished.code = process.wait(kRunTime).value_or(-1);
    finished.out = read_text(folder_ / "out");
    finished.err = read_text(folder_ / "err");
    return finished;
  }

  /// Trains to the end with one worker per entry of `workers`; the weights' hash.
  std::string train(const std::string& run, const Strings& sets,
                    const std::vector<Strings>& workers = {{"--lanes", "6"}}) {
    std::vector<Process> others;
    for (const Strings& more : workers) others.push_back(worker(run, more));
    Process process = learner(run, sets);
    const std::optional<int> code = process.wait(kRunTime);
    EXPECT_EQ(code, 0) << read_text(err(run));
    if (code != 0) return {};
    for (Process& other : others) EXPECT_EQ(other.wait(std::chrono::seconds(20)), 0);
    return hash(run);
  }

  /// The first digits of the weights after each update, as the learner of a run printed them.
  Strings weights_of_updates(const std::string& run) const {
    static const std::regex line("update ([0-9]+)/.* weights ([0-9a-f]{8})");
    Strings weights;
    for (const std::string& text : lines_of(read_text(out(run)))) {
      std::smatch found;
      if (!std::regex_match(text, found, line)) continue;
      EXPECT_EQ(std::stoul(found[1]), weights.size() + 1) << text;
      weights.push_back(found[2]);
    }
    return weights;
  }
  /// The training of an endless task must go on; then it is stopped, and every update must have led
  /// to the weights of a training that nothing disturbed.
  void expect_goes_on_undisturbed(const std::string& run, Process& learner,
                                  const Strings& sets = endless_task()) {
    const auto updates = static_cast<int>(weights_of_updates(run).size());
    ASSERT_TRUE(reaches_update(run, updates + 10));
    learner.kill(SIGTERM);
    ASSERT_EQ(learner.wait(kRunTime), 130) << read_text(err(run));
    const Strings disturbed = weights_of_updates(run);
    ASSERT_FALSE(disturbed.empty()) << read_text(err(run));
    const std::string calm = run + "_calm";
    Process other = worker(calm, {"--lanes", "6"});
    Process process = this->learner(calm, sets);
    ASSERT_TRUE(reaches_update(calm, static_cast<int>(disturbed.size())));
    Strings undisturbed = weights_of_updates(calm);
    undisturbed.resize(disturbed.size());
    EXPECT_EQ(disturbed, undisturbed);
  }

  std::string run_dir(const std::string& run) const { return folder_ / ("runs/" + run); }
  std::string out(const std::string& run) const { return folder_ / (run + ".out"); }
  std::string err(const std::string& run) const { return folder_ / (run + ".err"); }
  const TempDir& folder() const { return folder_; }
  std::uint32_t domain() const { return domain_.id(); }

  std::string summary(const std::string& run) const {
    return read_text(run_dir(run) + "/summary.json");
  }
  /// A value of summary.json as it is written there, without quotes; empty if there is none.
  static std::string value(const std::string& json, const std::string& key) {
    std::size_t at = json.find("\"" + key + "\":");
    if (at == std::string::npos) return {};
    at = json.find_first_not_of(" \"", at + key.size() + 3);
    return json.substr(at, json.find_first_of("\",}\n", at) - at);
  }
  std::string hash(const std::string& run) const {
    const std::string found = value(summary(run), "weights_hash");
    EXPECT_EQ(found.size(), 64u) << read_text(err(run));
    return found;
  }
  /// Waits until the learner of a run has done so many updates.
  ::testing::AssertionResult reaches_update(const std::string& run, int update) const {
    const std::string line = "update " + std::to_string(update) + "/";
    if (eventually([&] { return read_text(out(run)).find(line) != std::string::npos; })) {
      return ::testing::AssertionSuccess();
    }
    return ::testing::AssertionFailure() << "no update " << update << ": " << read_text(err(run));
  }

 private:
  PrivateDomain domain_;
  TempDir folder_;
  int workers_ = 0;
};

}  // namespace omentum::test

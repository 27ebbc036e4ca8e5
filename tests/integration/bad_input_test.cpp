// Wrong input ends before anything begins: exit code 2, one line that names what, where and the
// allowed range, nothing half-written.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <utility>
#include <vector>

#include "tests/integration/programs.h"

namespace omentum {
namespace {

using test::Finished;
using test::operator+;
using test::Process;
using test::Programs;
using test::Strings;
using test::tiny_task;
using testing::HasSubstr;

const std::string kTests = OMENTUM_TESTS_DIR;

Strings with_sets(Strings arguments, const Strings& sets) {
  for (const std::string& set : sets) {
    arguments.push_back("--set");
    arguments.push_back(set);
  }
  return arguments;
}

void expect_refused(const Finished& finished, const Strings& parts) {
  EXPECT_EQ(finished.code, 2) << finished.err;
  EXPECT_EQ(test::lines_of(finished.err).size(), 1u) << finished.err;
  for (const std::string& part : parts) EXPECT_THAT(finished.err, HasSubstr(part));
}

Strings files_in(const std::string& folder) {
  Strings files;
  std::error_code error;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder, error)) {
    if (entry.is_regular_file()) files.push_back(entry.path().string());
  }
  return files;
}

class BadInput : public testing::Test {
 protected:
  /// The learner started like this is refused and leaves no file.
  void expect_learner_refuses(const Strings& sets, const Strings& parts,
                              const Strings& more = {"--run", "bad"}) {
    const Strings runs = {"run.runs_dir=" + (programs_.folder() / "runs")};
    const Finished finished =
        programs_.finish(with_sets(Strings{OMENTUM_LEARNER} + more, runs + sets));
    expect_refused(finished, parts);
    EXPECT_TRUE(files_in(programs_.folder() / "runs").empty());
  }
  /// The learner's dry run has a worker's check refuse the scene that these knobs make; so does the
  /// check by itself.
  void expect_scene_refused(const Strings& sets, const Strings& parts) {
    const Finished dry = programs_.finish(with_sets({OMENTUM_LEARNER, "--dry-run"}, sets));
    expect_refused(dry, parts);
    const std::string path = programs_.folder() / "config.txtpb";
    std::ofstream(path) << dry.out;
    expect_refused(programs_.finish({OMENTUM_SIM_WORKER, "--check-config", path}), parts);
  }

  Programs programs_;
};

TEST_F(BadInput, KnobsAreRefusedByName) {
  expect_learner_refuses({"task.nonsense=1"}, {"task.nonsense", "increment_m"});
  expect_learner_refuses({"task.increment_m=1"},
                         {"task.increment_m: 1 m", "allowed 1e-05 ... 0.01"});
  expect_learner_refuses({"task.increment_m=nan"}, {"task.increment_m: nan", "allowed"});
  expect_learner_refuses({"scene.target_m.x=nan"}, {"scene.target_m", "nan", "allowed"});
  expect_learner_refuses({"task.reward=REWARD_FREE"},
                         {"task.reward", "REWARD_FREE", "Allowed: REWARD_PAPER, REWARD_DERIVED"});
  expect_learner_refuses({"task.increment_m=0.001 }\nppo { hidden: 64"},
                         {"task.increment_m", "more than one value"});
  expect_learner_refuses({"format_version=2"}, {"format_version: 2", "allowed 1"});
  expect_learner_refuses({"scene.format_version=2"}, {"scene.format_version: 2", "allowed 1"});
  expect_learner_refuses({"task.increment_m"}, {"task.increment_m"});
  expect_learner_refuses({"run.domain=999"}, {"run.domain: 999", "allowed 0 ... 230"});
  expect_learner_refuses({"run.lane_width=3"}, {"run.lane_width: 3", "1, 8, 16"});
}

TEST_F(BadInput, CommandLinesAreRefusedByOption) {
  expect_learner_refuses({}, {"preset", "nowhere", "omentum"}, {"--preset", "nowhere"});
  const auto worker = [this](const Strings& more) {
    return programs_.finish(Strings{OMENTUM_SIM_WORKER} + more);
  };
  for (const std::string run : {"a/b", "..", ".a", "a b", "a*", "a=b"}) {
    expect_learner_refuses({}, {"run.name", run, "A-Z a-z 0-9 _ - ."}, {"--run", run});
    expect_refused(worker({"--run", run}), {"run.name", run, "A-Z a-z 0-9 _ - ."});
  }
  expect_learner_refuses({}, {"run.name", "\"-a\""}, {"--run=-a"});
  expect_refused(worker({"--run=-a"}), {"run.name", "\"-a\""});
  expect_learner_refuses({}, {"--nonsense"}, {"--nonsense"});
  expect_refused(worker({"--domain", "999"}), {"--domain", "999", "0", "230"});
  expect_refused(worker({"--lanes", "100000"}), {"--lanes", "100000", "1024"});
  expect_refused(worker({"--lane-width", "3"}), {"lane_width", "3", "1, 8, 16"});
  expect_refused(worker({"--check-config", programs_.folder() / "none"}), {"none"});
}

TEST_F(BadInput, WhatWouldBeIgnoredIsRefused) {
  const auto worker = [this](const Strings& more) {
    return programs_.finish(Strings{OMENTUM_SIM_WORKER} + more);
  };
  expect_refused(worker({"--tremor", "0.5"}), {"--tremor", "--demonstrate"});
  expect_refused(worker({"--preset", "paper"}), {"--preset", "--demonstrate"});
  expect_refused(worker({"--domain", "3", "--replay", "x.mcap"}), {"--domain", "--replay"});
  expect_refused(worker({"--max-wait", "nan"}), {"--max-wait", "nan"});
  expect_learner_refuses({"preset=paper"}, {"preset=paper", "--preset"});
  const Finished nowhere = programs_.finish({OMENTUM_LEARNER, "--set", "run.runs_dir="});
  expect_refused(nowhere, {"run.runs_dir", "empty"});
  for (const char* option : {"--max-wait", "--unsaved-limit"})
    expect_learner_refuses({}, {option, "nan"}, {option, "nan"});
  // A name that clears the screen.
  const Finished raw = programs_.finish({OMENTUM_LEARNER, "--run", "\x1b[2Jx"});
  expect_refused(raw, {"run.name", "?[2Jx"});
  const std::string run = programs_.folder() / "twice";
  std::filesystem::create_directories(run);
  expect_refused(programs_.finish({OMENTUM_REPORT, run, run + "/"}), {"named twice"});
}

// Each of these waited for a writer that never comes, a key even deaf to SIGTERM.
TEST_F(BadInput, APipeInThePlaceOfAFileIsRefused) {
  const std::string pipe = programs_.folder() / "pipe.mcap";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  const std::string run = programs_.folder() / "piped", keys = programs_.folder() / "keys";
  std::filesystem::create_directories(run);
  std::filesystem::create_symlink(pipe, run + "/config.txtpb");
  std::filesystem::create_directories(keys);
  for (const char* file : {"identity_ca.pem", "certificate.pem", "key.pem", "crl.pem",
                           "permissions_ca.pem", "governance.p7s", "permissions.p7s"})
    std::filesystem::create_symlink(pipe, keys + "/" + file);
  const std::string runs = "run.runs_dir=" + (programs_.folder() / "runs");
  for (const Strings& arguments :
       {Strings{OMENTUM_LEARNER, "--set", runs, "--initialise-from", pipe},
        Strings{OMENTUM_LEARNER, "--set", runs, "--set", "scene_file=" + pipe},
        Strings{OMENTUM_LEARNER, "--set", runs, "--security-dir", keys},
        Strings{OMENTUM_SIM_WORKER, "--check-config", pipe},
        Strings{OMENTUM_SIM_WORKER, "--grasp-study", run},
        Strings{OMENTUM_SIM_WORKER, "--replay", pipe},
        Strings{OMENTUM_SIM_WORKER, "--security-dir", keys}, Strings{OMENTUM_REPORT, pipe},
        Strings{OMENTUM_DVRK_GATEWAY, "--policy", pipe, "--robot", "127.0.0.1:48051", "check"}}) {
    Process program(arguments, programs_.folder() / "out", programs_.folder() / "err");
    EXPECT_EQ(program.wait(std::chrono::seconds(30)), 2) << arguments[0] << " " << arguments[1];
    EXPECT_THAT(test::read_text(programs_.folder() / "err"), HasSubstr("pipe"));
  }
}

TEST_F(BadInput, AGraspStudyNeedsARunFolderAndAGraspThatCanFail) {
  const std::string run = programs_.folder() / "run";
  const Strings study = {OMENTUM_SIM_WORKER, "--grasp-study", run};
  expect_refused(programs_.finish(study),
                 {"--grasp-study", run + "/config.txtpb", "cannot be opened"});
  std::filesystem::create_directories(run);
  std::ofstream(run + "/config.txtpb") << "grasp { radius_m: 9 }\n";
  expect_refused(programs_.finish(study), {"radius_m"});
  const Finished dry =
      programs_.finish({OMENTUM_LEARNER, "--dry-run", "--preset", "paper_literal"});
  std::ofstream(run + "/config.txtpb") << dry.out;
  const Finished plain = programs_.finish(study);
  EXPECT_EQ(plain.code, 0) << plain.err;
  EXPECT_THAT(plain.out, HasSubstr("no grasp study"));
  EXPECT_FALSE(std::filesystem::exists(run + "/evaluation"));
}

// Three dozen sweeps of four starts on a small sheet. A study takes its time, so it is made once,
// and not at all where it cannot be written.
TEST_F(BadInput, AGraspStudyIsMadeOnceAndNotWhereItCannotBeWritten) {
  const std::string run = programs_.folder() / "run";
  std::filesystem::create_directories(run);
  const auto configure = [&](const Strings& more) {
    const Finished dry = programs_.finish(with_sets(
        {OMENTUM_LEARNER, "--dry-run"},
        tiny_task() + Strings{"scene.robot_grid.rows=2", "scene.robot_grid.columns=2"} + more));
    std::ofstream(run + "/config.txtpb") << dry.out;
  };
  configure({});
  const Strings study = {OMENTUM_SIM_WORKER, "--grasp-study", run};
  const std::string table = run + "/evaluation/grasp_study.csv";
  std::ofstream(run + "/evaluation") << "a file in the way";
  const auto begin = std::chrono::steady_clock::now();
  expect_refused(programs_.finish(study), {"evaluation"});
  const auto refused = std::chrono::steady_clock::now() - begin;
  std::filesystem::remove(run + "/evaluation");
  const Finished made = programs_.finish(study);
  ASSERT_EQ(made.code, 0) << made.err;
  EXPECT_LT(refused, std::chrono::steady_clock::now() - begin - refused) << "before the study";
  const auto written = std::filesystem::last_write_time(table);
  EXPECT_THAT(programs_.finish(study).out, HasSubstr("already"));
  configure({"rollout.run_seed=7"});  // has no part in it
  EXPECT_THAT(programs_.finish(study).out, HasSubstr("already"));
  EXPECT_EQ(std::filesystem::last_write_time(table), written);
  configure({"grasp.min_pinch_m=0.0004"});
  EXPECT_EQ(programs_.finish(study).out, table + "\n");
}

TEST_F(BadInput, EveryProgramTellsItsVersion) {
  std::string first;
  for (const char* program :
       {OMENTUM_LEARNER, OMENTUM_SIM_WORKER, OMENTUM_REPORT, OMENTUM_MISMATCH}) {
    const Finished version = programs_.finish({program, "--version"});
    EXPECT_EQ(version.code, 0) << program;
    EXPECT_THAT(version.out,
                testing::MatchesRegex("omentum [0-9.]+, revision .*, build [0-9a-f]+\n"));
    if (first.empty()) first = version.out;
    EXPECT_EQ(version.out, first) << program;
  }
}

TEST_F(BadInput, ACheckpointThatCannotInitialiseLeavesNothing) {
  const std::string file = programs_.folder() / "other.pb";
  std::ofstream(file) << "OMCKPT01 and no more";
  expect_learner_refuses({}, {"--initialise-from", file},
                         {"--run", "bad", "--initialise-from", file});
  expect_learner_refuses({}, {"--initialise-from", "nowhere.pb"},
                         {"--run", "bad", "--initialise-from", "nowhere.pb"});
  EXPECT_FALSE(std::filesystem::exists(programs_.folder() / "runs"));
  programs_.train("other", tiny_task());
  const std::string other = files_in(programs_.run_dir("other") + "/checkpoints").front();
  const Finished larger = programs_.finish(with_sets(
      {OMENTUM_LEARNER, "--run", "larger", "--initialise-from", other},
      tiny_task() + Strings{"ppo.hidden=24", "run.runs_dir=" + (programs_.folder() / "runs")}));
  expect_refused(larger, {"--initialise-from", "another network"});
  EXPECT_FALSE(std::filesystem::exists(programs_.run_dir("larger")));
  // Nor does a run move aside for it.
  expect_refused(programs_.finish(with_sets(
                     {OMENTUM_LEARNER, "--run", "other", "--restart", "--initialise-from", file},
                     tiny_task() + Strings{"run.runs_dir=" + (programs_.folder() / "runs")})),
                 {"--initialise-from"});
  EXPECT_TRUE(std::filesystem::exists(other));
}

TEST_F(BadInput, ACorruptCheckpointIsSaidToBeSkipped) {
  programs_.train("run", tiny_task() + Strings{"run.checkpoint_interval_s=0"});
  Strings files = files_in(programs_.run_dir("run") + "/checkpoints");
  std::erase_if(files, [](const std::string& file) {
    return file.find("/checkpoint-") == std::string::npos;
  });
  std::sort(files.begin(), files.end());
  ASSERT_EQ(files.size(), 2u);
  std::filesystem::resize_file(files.back(), std::filesystem::file_size(files.back()) / 2);
  programs_.train("run", tiny_task());
  const std::string said = test::read_text(programs_.err("run"));
  EXPECT_THAT(said, HasSubstr("event=checkpoint_skipped reason=\"" + files.back() + ": truncated"));
  EXPECT_THAT(said, HasSubstr("resumed=" + files.front()));
}

TEST_F(BadInput, ACorruptEpochFileSaysHowToGoOn) {
  programs_.train("run", tiny_task());
  const std::string epoch = programs_.run_dir("run") + "/learner_epoch";
  std::ofstream(epoch) << "x";
  expect_refused(programs_.finish(with_sets(
                     {OMENTUM_LEARNER, "--run", "run"},
                     tiny_task() + Strings{"run.runs_dir=" + (programs_.folder() / "runs")})),
                 {epoch, "remove the file to go on"});
}

TEST_F(BadInput, AByteOrderMarkIsNoPartOfAConfiguration) {
  const std::string path = programs_.folder() / "config.txtpb";
  std::ofstream(path) << "\xef\xbb\xbf" << programs_.finish({OMENTUM_LEARNER, "--dry-run"}).out;
  const Finished checked = programs_.finish({OMENTUM_SIM_WORKER, "--check-config", path});
  EXPECT_EQ(checked.code, 0) << checked.err;
}

TEST_F(BadInput, ScenesAreRefusedByTheWorkersCheck) {
  const std::string open = programs_.folder() / "open.obj";
  std::ofstream(open) << "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nf 1 3 2\nf 1 2 4\nf 1 4 3\n";
  const auto organ = [](const std::string& path) {
    return R"(scene.rigid_body={ name: "organ" mesh { path: ")" + path + R"(" } })";
  };
  expect_learner_refuses({organ("/nowhere/organ.stl")},
                         {"scene.rigid_body[3].mesh.path", "/nowhere/organ.stl"});
  expect_scene_refused({organ(open)}, {"open.obj", "edge"});
  expect_scene_refused({R"(scene.tissue.volume={ mesh { path: ")" + kTests +
                        R"(/fixtures/fat_pad.obj" unit_m: 1 } })"},
                       {"fat_pad.obj", "m"});
  expect_scene_refused({"scene.tissue.cluster.cluster_spacing_m=0.0127",
                        "scene.tissue.cluster.cluster_radius_m=0.0095"},
                       {"orphan_policy", "particles"});
  expect_scene_refused({"scene.tissue.grid.pitch_m=0.05"},
                       {"scene.tissue", "metres", "0.002 ... 1"});
  expect_scene_refused({"scene.target_m={ x: 0.5 }"},
                       {"scene.target_m", "coordinate x", "0.5", "allowed -0.0916 ... 0.0691"});
  expect_scene_refused({"scene.tool.base={ translation_m { x: 1 } }"},
                       {"scene.tool_start_m", "out of reach"});
  expect_scene_refused({"scene.tissue.anchor_max_y_m=-1"}, {"anchor_max_y_m", "0 of 961"});
  Strings bodies;
  for (int i = 0; i < 12; ++i) {
    bodies.push_back(R"(scene.rigid_body={ name: "stone" sphere_radius_m: 0.001 })");
  }
  expect_scene_refused(bodies, {"scene.rigid_body", "15", "at most 11"});
}

TEST_F(BadInput, WhatTheBusCannotCarryIsRefusedByLearnerDryRunAndCheckAlike) {
  const Strings image = {"task.observation=OBSERVATION_IMAGE"};
  expect_learner_refuses(image + Strings{"task.image_size=200"},
                         {"task.image_size: 200 px", "allowed 8 ... 128"});
  const std::vector<std::pair<Strings, Strings>> refused = {
      {image + Strings{"task.image_size=30"}, {"task.image_size: 30 px", "multiples of 4 from 12"}},
      {{"ppo.network=NETWORK_CONVOLUTION"}, {"ppo.network: NETWORK_CONVOLUTION", "NETWORK_DENSE"}},
      {image + Strings{"task.image_size=128", "ppo.hidden=1024"},
       {"ppo.hidden: 1024", "parameters", "allowed up to "}},
      {image + Strings{"rollout.steps_per_segment=20000"},
       {"rollout.steps_per_segment: 20000", "allowed up to 16070"}},
      {image + Strings{"task.episode_steps=19000", "task.action_repeat=1"},
       {"task.episode_steps: 19000", "allowed up to 16070"}}};
  for (const auto& [sets, parts] : refused) {
    expect_learner_refuses(sets, parts);
    expect_scene_refused(sets, parts);
  }
  // What only the scene tells.
  const Strings fine = {"task.action_repeat=1",
                        "scene.tissue.model=TISSUE_ELASTIC",
                        "scene.tissue.grid.count_x=120",
                        "scene.tissue.grid.count_y=120",
                        "scene.tissue.grid.pitch_m=0.0006",
                        "scene.tissue.anchor_max_y_m=-0.014"};
  expect_scene_refused(
      fine + Strings{"scene.tissue.effects={ viscoelastic { share: 0.3 time_s: 1 } }"},
      {"scene.tissue: its state takes", "allowed up to 1048576"});
  expect_scene_refused(fine + Strings{"evaluation.frame_stride=1"},
                       {"evaluation.frame_stride: 1", "allowed from 2 on"});
}

TEST_F(BadInput, ScenesThatCannotBeMeantAreRefusedOddOnesToldByTheDryRun) {
  const std::string preset = test::read_text(kTests + "/../deploy/scenes/omentum.txtpb");
  const std::string file = programs_.folder() / "mine.txtpb";
  const Strings mine = {"scene_file=" + file};
  const auto write_scene = [&](const std::string& old, const std::string& text) {
    std::string scene = preset;
    std::ofstream(file) << scene.replace(scene.find(old), old.size(), text);
  };
  write_scene("x: 0.0109 y", "x: 36 y");
  expect_scene_refused(mine, {file + ":54:3: scene.rigid_body[1].pose", "36 m", "0.132 m"});
  write_scene("z: 0.0236 }", "z: 50 }");
  expect_scene_refused(mine, {file + ":64:1: scene.tumour_point_m", "50 m", "0.001 ... 0.119"});
  write_scene("x: 0.0109 y", "x: 0.055 y");
  const Finished beside = programs_.finish(with_sets({OMENTUM_LEARNER, "--dry-run"}, mine));
  EXPECT_EQ(beside.code, 0);
  EXPECT_THAT(beside.err,
              HasSubstr(file + ":54:3: scene.rigid_body[1].pose: the tumour lies beside"));
  EXPECT_THAT(beside.err, HasSubstr("-0.06391 ... 0.02951 m"));
  // A mesh beside the scene file.
  std::filesystem::copy(kTests + "/fixtures/organ.stl", programs_.folder() / "organ.stl");
  write_scene("workspace_min_m",
              "rigid_body { name: \"spleen\" mesh { path: \"organ.stl\" unit_m: 0.0005 } pose { "
              "translation_m { x: -0.05 y: 0.03 z: 0.01 } } }\nworkspace_min_m");
  const Strings dry_run = with_sets({OMENTUM_LEARNER, "--dry-run"}, mine);
  const Finished good = programs_.finish(dry_run);
  EXPECT_EQ(good.code, 0);
  std::filesystem::remove(programs_.folder() / "organ.stl");
  expect_refused(programs_.finish(dry_run),
                 {file + ":", "scene.rigid_body[3].mesh.path: cannot open " +
                                  (programs_.folder() / "organ.stl")});
  std::ofstream(programs_.folder() / "config.txtpb") << good.out;
  expect_refused(
      programs_.finish({OMENTUM_SIM_WORKER, "--check-config", programs_.folder() / "config.txtpb"}),
      {programs_.folder() / "organ.stl: cannot be opened"});
}

TEST_F(BadInput, ASceneThatNoWorkerCanMakeStopsTheLearnerWithTheirReason) {
  const std::vector<std::pair<Strings, std::string>> scenes = {
      {{"scene.target_m={ x: 0.5 }"}, "scene.target_m: coordinate x is 0.5 m, allowed"},
      {{"scene.tissue.model=TISSUE_ELASTIC", "scene.tissue.grid.count_x=120",
        "scene.tissue.grid.count_y=120", "scene.tissue.grid.pitch_m=0.0006",
        "scene.tissue.effects={ viscoelastic { share: 0.3 time_s: 1 } }"},
       "scene.tissue: its state takes"}};
  for (const auto& [sets, reason] : scenes) {
    Process one = programs_.worker("bad");
    Process two = programs_.worker("bad");
    Process learner = programs_.learner("bad", tiny_task() + sets);
    EXPECT_EQ(learner.wait(test::kRunTime), 2);
    Strings said;
    for (const std::string& line : test::lines_of(test::read_text(programs_.err("bad")))) {
      if (line.starts_with("learner: ")) said.push_back(line);
    }
    ASSERT_EQ(said.size(), 1u) << test::read_text(programs_.err("bad"));
    EXPECT_THAT(said[0], HasSubstr(reason));
    EXPECT_TRUE(programs_.summary("bad").empty());
    EXPECT_TRUE(files_in(programs_.run_dir("bad") + "/checkpoints").empty());
    EXPECT_EQ(one.wait(std::chrono::seconds(20)), 0);
    EXPECT_EQ(two.wait(std::chrono::seconds(20)), 0);
  }
  // The same name with a good scene is a new run, and a worker that refused serves it.
  EXPECT_EQ(programs_.train("bad", tiny_task()).size(), 64u);
}

TEST_F(BadInput, AWorkerThatRefusedOneLearnerServesTheNext) {
  Process worker = programs_.worker("later");
  const std::string log = programs_.folder() / "later.worker0.err";
  {
    // Killed when the worker refuses: the learner itself gives up 3 s after it has heard of that,
    // and would send the worker home.
    Process learner =
        programs_.learner("later", tiny_task() + Strings{"scene.target_m={ x: 0.5 }"});
    ASSERT_TRUE(test::eventually(
        [&] { return test::read_text(log).find("coordinate x") != std::string::npos; }));
    learner.kill(SIGKILL);
    ASSERT_EQ(learner.wait(test::kRunTime), 128 + SIGKILL);
  }
  Process learner = programs_.learner("later", tiny_task());
  EXPECT_EQ(learner.wait(test::kRunTime), 0) << test::read_text(programs_.err("later"));
  EXPECT_EQ(worker.wait(std::chrono::seconds(20)), 0) << test::read_text(log);
}

TEST_F(BadInput, CheckpointsOfAnotherConfigurationOrTornOnesAreRefused) {
  programs_.train("run", tiny_task() + Strings{"run.checkpoint_interval_s=0"});
  const std::string epoch = test::read_text(programs_.run_dir("run") + "/learner_epoch");
  const std::string config = test::read_text(programs_.run_dir("run") + "/config.txtpb");
  Strings arguments = {OMENTUM_LEARNER, "--run", "run"};
  const Strings runs = {"run.runs_dir=" + (programs_.folder() / "runs")};
  expect_refused(
      programs_.finish(with_sets(arguments, runs + tiny_task() + Strings{"ppo.hidden=24"})),
      {"runs/run", "another configuration", "ppo.hidden: 16 -> 24", "--restart"});
  int torn = 0;
  for (const std::string& file : files_in(programs_.run_dir("run") + "/checkpoints")) {
    std::filesystem::resize_file(file, std::filesystem::file_size(file) / 2);
    ++torn;
  }
  EXPECT_GE(torn, 2);
  expect_refused(programs_.finish(with_sets(arguments, runs + tiny_task())),
                 {"runs/run/checkpoints", "truncated"});
  EXPECT_EQ(test::read_text(programs_.run_dir("run") + "/learner_epoch"), epoch);
  EXPECT_EQ(test::read_text(programs_.run_dir("run") + "/config.txtpb"), config);
}

TEST_F(BadInput, AFileInTheWayOfTheRunFolderIsNamed) {
  std::filesystem::create_directories(programs_.folder() / "runs");
  std::ofstream(programs_.folder() / "runs/bad") << "in the way";
  const Strings runs = {"run.runs_dir=" + (programs_.folder() / "runs")};
  expect_refused(programs_.finish(with_sets({OMENTUM_LEARNER, "--run", "bad"}, runs)),
                 {"runs/bad", "directory"});
  EXPECT_EQ(test::read_text(programs_.folder() / "runs/bad"), "in the way");
}

TEST_F(BadInput, ARunsFolderThatCannotBeWrittenIsToldWithTheUser) {
  for (const char* folder : {"/proc", "/proc/runs"}) {
    const Strings runs = {std::string("run.runs_dir=") + folder};
    expect_refused(programs_.finish(with_sets({OMENTUM_LEARNER, "--run", "bad"}, runs)),
                   {folder, "let user " + std::to_string(geteuid()), "--set run.runs_dir="});
  }
}

TEST_F(BadInput, PortsThatAreTakenAreToldWithAWayOut) {
  // Those of every participant of the domain; the first is that of a hub's learner.
  std::vector<int> held;
  const auto first = static_cast<std::uint16_t>(7410 + 250 * programs_.domain());
  for (std::uint16_t port = first; port < first + 200; ++port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    held.push_back(socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0));
    ASSERT_EQ(bind(held.back(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  const Strings sets = {"run.runs_dir=" + (programs_.folder() / "runs"),
                        "run.domain=" + std::to_string(programs_.domain())};
  const Strings learner = with_sets({OMENTUM_LEARNER, "--run", "bad"}, sets);
  const std::string way_out = "another domain: learner --set run.domain=N";
  expect_refused(programs_.finish(learner), {std::to_string(first) + " + 2 x index", way_out});
  expect_refused(programs_.finish(learner + Strings{"--discovery", "hub"}),
                 {"port " + std::to_string(first) + " is taken", way_out});
  for (const int fd : held) close(fd);
}

TEST_F(BadInput, ScenesThatCannotBeReadAreNamedWithLineAndColumn) {
  // A deploy folder of our own.
  const std::string deploy = programs_.folder() / "deploy";
  std::filesystem::create_directories(deploy + "/presets");
  std::filesystem::create_directories(deploy + "/scenes");
  std::ofstream(deploy + "/presets/mine.txtpb") << "scene_file: \"mine.txtpb\"\n";
  ASSERT_EQ(setenv("OMENTUM_DEPLOY_DIR", deploy.c_str(), 1), 0);
  expect_learner_refuses({}, {"scenes/mine.txtpb", "cannot be opened"},
                         {"--preset", "mine", "--run", "bad"});
  std::ofstream(deploy + "/scenes/mine.txtpb") << "format_version: 1\ngravity: 9.8\n";
  expect_learner_refuses({}, {"mine.txtpb:2:8", "gravity"}, {"--preset", "mine", "--run", "bad"});
  std::filesystem::remove(deploy + "/scenes/mine.txtpb");
  std::filesystem::create_directories(deploy + "/scenes/mine.txtpb");
  expect_learner_refuses({}, {"mine.txtpb"}, {"--preset", "mine", "--run", "bad"});
  unsetenv("OMENTUM_DEPLOY_DIR");
}

}  // namespace
}  // namespace omentum

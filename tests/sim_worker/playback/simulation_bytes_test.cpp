// Simulations as bytes: whoever does one, it is the same to the bit; what cannot be one is refused.
#include "sim_worker/playback/simulation_bytes.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <fstream>
#include <functional>
#include <limits>
#include <string>

#include "core/check.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/simulation_records.h"
#include "proto/simulation.pb.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// A small sheet, clamped at one edge, that jaws lift by its other one. `more` goes into
/// scene.tissue, `beside` next to it.
SimulationTask lift_task(const std::string& model, const std::string& more = "",
                         const std::string& beside = "") {
  const test::TempDir folder;
  std::ofstream(folder / "sheet.txtpb")
      << "tissue { grid { count_x: 6 count_y: 9 pitch_m: 0.003 }\n"
         "thickness_m: 0.003 anchor_max_y_m: -0.011 model: "
      << model << "\nmaterial { damping_per_s: 5 }\n"
      << more << " }\n"
      << "tool { base { translation_m { x: 0.1427 z: 0.1584 } } "
         "contact: false }\n"
      << beside;
  SimulationTask task;
  task.scene = load_scene(folder / "sheet.txtpb", {});
  task.commands.time = {0, 0.05, 0.2, 0.3};
  const Vector3d grip(0, 0.011, 0);
  task.commands.p_WT = {grip, grip, grip + Vector3d(0, 0, 0.004), grip + Vector3d(0, 0, 0.004)};
  task.commands.jaw_rad = {0.4, 0, 0, 0};
  task.commands.path = "lift/tool.csv";
  return task;
}

/// As another process does it.
Simulation elsewhere(const SimulationTask& task) {
  const Result<Bytes> bytes = task_bytes(task);
  EXPECT_TRUE(bytes) << bytes.error();
  Result<Simulation> made = read_result(run_task_bytes(bytes.value(), {}), task);
  EXPECT_TRUE(made) << made.error();
  return std::move(made).value();
}

template <typename T>
bool same_bits(const std::vector<T>& a, const std::vector<T>& b) {
  return a.size() == b.size() &&
         (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(T)) == 0);
}

void expect_same(const Simulation& a, const Simulation& b) {
  EXPECT_TRUE(same_bits(a.recording.time, b.recording.time));
  EXPECT_TRUE(same_bits(a.recording.tip, b.recording.tip));
  EXPECT_TRUE(same_bits(a.recording.measured_tip, b.recording.measured_tip));
  EXPECT_TRUE(same_bits(a.recording.arm, b.recording.arm));
  EXPECT_TRUE(same_bits(a.recording.force, b.recording.force));
  ASSERT_EQ(a.recording.points.size(), b.recording.points.size());
  ASSERT_EQ(a.recording.surface.size(), b.recording.surface.size());
  for (std::size_t k = 0; k < a.recording.points.size(); ++k) {
    EXPECT_TRUE(same_bits(a.recording.points[k], b.recording.points[k])) << k;
    EXPECT_TRUE(same_bits(a.recording.surface[k], b.recording.surface[k])) << k;
  }
  EXPECT_EQ(a.recording.clocks.SerializeAsString(), b.recording.clocks.SerializeAsString());
  EXPECT_EQ(a.recording.missed_grasps, b.recording.missed_grasps);
  EXPECT_EQ(a.recording.start_speed, b.recording.start_speed);
  EXPECT_EQ(a.recording.failure, b.recording.failure);
  EXPECT_EQ(a.reference, b.reference);
  EXPECT_EQ(a.cells, b.cells);
  EXPECT_EQ(a.column_frames, b.column_frames);
  ASSERT_EQ(a.columns.size(), b.columns.size());
  for (const auto& [step, state] : a.columns) {
    ASSERT_TRUE(b.columns.contains(step));
    const StateColumns& other = b.columns.at(step);
    ASSERT_EQ(state.surface.size(), other.surface.size());
    for (std::size_t k = 0; k < state.surface.size(); ++k)
      EXPECT_TRUE(same_bits(state.surface[k], other.surface[k]));
    EXPECT_TRUE(same_bits(state.force, other.force));
  }
  ASSERT_EQ(a.mesh_error.has_value(), b.mesh_error.has_value());
  if (a.mesh_error) {
    EXPECT_EQ(a.mesh_error->rms_m, b.mesh_error->rms_m);
    EXPECT_EQ(a.mesh_error->worst_rms_m, b.mesh_error->worst_rms_m);
    EXPECT_EQ(a.mesh_error->force, b.mesh_error->force);
  }
  EXPECT_EQ(a.scene.warnings, b.scene.warnings);
  EXPECT_EQ(a.warnings, b.warnings);
  EXPECT_EQ(a.model_warnings, b.model_warnings);
}

TEST(SimulationBytes, TheSameBitsForEveryModelWithArmClocksAndFailedGrasps) {
  for (const char* model : {"TISSUE_ELASTIC", "TISSUE_CLUSTER", "TISSUE_REFERENCE"}) {
    SCOPED_TRACE(model);
    SimulationTask task = lift_task(model, "reference { elements_x: 2 elements_y: 4 }",
                                    "arm { transport_delay_s: 0.04 } clocks { force_s: 0.01 }");
    expect_same(simulate(task), elsewhere(task));
    task.commands.p_WT.assign(4, Vector3d(0.2, 0.2, 0.1));
    const Simulation missed = elsewhere(task);
    EXPECT_EQ(missed.recording.missed_grasps, 1);
    expect_same(simulate(task), missed);
  }
}

TEST(SimulationBytes, TheSameColumnsInMemoryAndInTheirFile) {
  SimulationTask task = lift_task("TISSUE_REFERENCE", "reference { elements_x: 3 elements_y: 5 }");
  task.parameters = "young_modulus,grasp_offset.x";
  task.column_steps = {0, 3, 9};
  task.estimate_error = true;
  expect_same(simulate(task), elsewhere(task));
  const test::TempDir here, there;
  task.column_steps.clear();
  task.stride = 4;
  task.columns_folder = here.path();
  const Simulation made = simulate(task);
  EXPECT_EQ(made.column_frames, 4u);
  task.columns_folder = there.path();
  expect_same(made, elsewhere(task));
  EXPECT_TRUE(read_whole(here / "columns.npz").value() ==
              read_whole(there / "columns.npz").value());
}

TEST(SimulationBytes, MeshesTravelWithTheTask) {
  const test::TempDir folder;
  std::ofstream(folder / "ball.obj") << "v 0.01 0 0\nv 0 0.01 0\nv 0 0 0.01\nv 0 0 0\n"
                                        "f 1 2 3\nf 4 2 1\nf 4 3 2\nf 4 1 3\n";
  SimulationTask task = lift_task("TISSUE_ELASTIC", "",
                                  "rigid_body { name: \"ball\" role: ROLE_ORGAN mesh { path: "
                                  "\"ball.obj\" } pose { translation_m { z: -0.03 } } }");
  task.folder = folder.path();
  expect_same(simulate(task), elsewhere(task));
  Bytes bytes = task_bytes(task).value();
  pb::SimulationTask message;
  ASSERT_TRUE(message.ParseFromArray(bytes.data(), static_cast<int>(bytes.size())));
  const auto refusal = [&](const std::function<void(pb::SimulationTask&)>& change) {
    pb::SimulationTask changed = message;
    change(changed);
    Bytes other(changed.ByteSizeLong());
    EXPECT_TRUE(changed.SerializeToArray(other.data(), static_cast<int>(other.size())));
    const test::TempDir scratch;
    const Result<SimulationTask> read = read_task(other, scratch.path());
    return read ? "accepted" : read.error();
  };
  EXPECT_EQ(refusal([](auto&) {}), "accepted");
  EXPECT_THAT(refusal([](auto& m) { m.mutable_mesh(0)->set_name("../ball.obj"); }),
              testing::HasSubstr("must not be called"));
  EXPECT_THAT(refusal([](auto& m) {
                m.mutable_scene()->mutable_rigid_body(0)->mutable_mesh()->set_path("/etc/passwd");
              }),
              testing::HasSubstr("not brought along"));
  EXPECT_THAT(refusal([](auto& m) { m.clear_mesh(); }), testing::HasSubstr("not brought along"));
}

TEST(SimulationBytes, WhatIsNoTaskIsRefused) {
  const Bytes good = task_bytes(lift_task("TISSUE_ELASTIC")).value();
  pb::SimulationTask message;
  ASSERT_TRUE(message.ParseFromArray(good.data(), static_cast<int>(good.size())));
  const test::TempDir scratch;
  const auto accepts = [&](const std::function<void(pb::SimulationTask&)>& change) {
    pb::SimulationTask changed = message;
    change(changed);
    Bytes other(changed.ByteSizeLong());
    EXPECT_TRUE(changed.SerializeToArray(other.data(), static_cast<int>(other.size())));
    return read_task(other, scratch.path()).has_value();
  };
  const double nan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(accepts([](auto&) {}));
  EXPECT_FALSE(accepts([](auto& m) { m.clear_time_s(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_tip()->RemoveLast(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_jaw_rad()->RemoveLast(); }));
  EXPECT_FALSE(accepts([&](auto& m) { m.set_tip(0, nan); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_time_s(1, 5); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_time_s(3, 1e300); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_period_s(0); }));
  EXPECT_FALSE(accepts([&](auto& m) { m.set_period_s(nan); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_patch_radius_m(-1); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_stride(0); }));
  EXPECT_FALSE(accepts([](auto& m) {
    m.add_column_step(5);
    m.add_column_step(4);
  }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_scene()->mutable_tissue()->set_thickness_m(1e9); }));
  EXPECT_FALSE(read_task(Bytes(100, std::byte{7}), scratch.path()));
}

TEST(SimulationBytes, AnErrorIsAResultAndNothingElseOfIt) {
  SimulationTask task = lift_task("TISSUE_ELASTIC");
  task.parameters = "young_modulus";  // a shell has no columns
  const Bytes result = run_task_bytes(task_bytes(task).value(), {});
  const Result<Simulation> read = read_result(result, task);
  ASSERT_FALSE(read);
  EXPECT_THAT(read.error(), testing::HasSubstr("TISSUE_REFERENCE"));
  EXPECT_THROW(simulate(task), Error);
}

TEST(SimulationBytes, ResultsThatCannotBeOfTheTaskAreRefused) {
  SimulationTask task = lift_task("TISSUE_REFERENCE", "reference { elements_x: 2 elements_y: 3 }");
  task.parameters = "young_modulus";
  task.column_steps = {2};
  const Bytes good = run_task_bytes(task_bytes(task).value(), {});
  pb::SimulationResult message;
  ASSERT_TRUE(message.ParseFromArray(good.data(), static_cast<int>(good.size())));
  const auto accepts = [&](const std::function<void(pb::SimulationResult&)>& change) {
    pb::SimulationResult changed = message;
    change(changed);
    Bytes other(changed.ByteSizeLong());
    EXPECT_TRUE(changed.SerializeToArray(other.data(), static_cast<int>(other.size())));
    return read_result(other, task).has_value();
  };
  EXPECT_TRUE(accepts([](auto&) {}));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_time_s()->RemoveLast(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_time_s(1, 0.5); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_surface()->RemoveLast(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_surface(3)->mutable_points()->RemoveLast(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_surface(3)->clear_drawn(); }));
  EXPECT_FALSE(accepts([](auto& m) {
    m.mutable_surface(3)->set_points(0, std::numeric_limits<double>::infinity());
  }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_reference(false); }));
  EXPECT_FALSE(accepts([](auto& m) { m.clear_cells(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.add_arm(1); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_columns(0)->set_step(3); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_columns(0)->clear_column(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.mutable_columns(0)->mutable_column(0)->clear_force(); }));
  EXPECT_FALSE(accepts([](auto& m) { m.set_columns_file("x"); }));
  EXPECT_FALSE(read_result(Bytes(10, std::byte{3}), task));
}

TEST(SimulationBytes, WhatIsStoppedEndsSoon) {
  SimulationTask task = lift_task("TISSUE_ELASTIC");
  task.commands.time = {0, 1, 1000, 2000};
  int asked = 0;
  const Bytes result = run_task_bytes(task_bytes(task).value(), [&] { return ++asked > 20; });
  EXPECT_LE(asked, 25);
  EXPECT_LT(result.size(), 1'000'000u);
}

TEST(SimulationBytes, ATaskThatIsTooLargeIsRefusedBeforeItIsSent) {
  SimulationTask task = lift_task("TISSUE_ELASTIC");
  for (int k = 0; k < 600'000; ++k) {
    task.commands.time.push_back(1 + 1e-3 * k);
    task.commands.p_WT.emplace_back(0, 0, 0.1);
    task.commands.jaw_rad.push_back(0);
  }
  const Result<Bytes> bytes = task_bytes(task);
  ASSERT_FALSE(bytes);
  EXPECT_THAT(bytes.error(), testing::HasSubstr("allowed up to 16777216"));
}

}  // namespace
}  // namespace omentum

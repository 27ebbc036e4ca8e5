#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <vector>

#include "core/check.h"
#include "core/scratch_folder.h"
#include "proto/simulation.pb.h"
#include "sim_worker/playback/simulation_bytes.h"
#include "tests/support/small_simulation.h"

// What a stranger sends to a worker as the task of a simulation, and to who asked as its result.
// Each is read or refused with a reason; of a task no file is written but in its folder, and one
// that was read is simulated, as far as it is small, or ends in an error. Bytes: 0 = task, 1 =
// result of test::small_simulation() by the shell, 2 = by the reference with a column; then the
// message.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

void require(bool good) {
  if (!good) __builtin_trap();
}

bool is_small(const pb::Scene& scene) {
  const pb::Tissue& tissue = scene.tissue();
  const pb::ReferenceModel& mesh = tissue.reference();
  const bool solid = tissue.model() == pb::TISSUE_REFERENCE;
  const auto few = [](std::uint32_t count) { return count >= 1 && count <= 3; };
  return tissue.has_grid() && tissue.grid().count_x() <= 6 && tissue.grid().count_y() <= 6 &&
         tissue.cluster().substeps() <= 20 && tissue.elastic().substeps() <= 20 &&
         scene.rigid_body_size() == 0 && !scene.has_held_start() &&
         (!solid || (few(mesh.elements_x()) && few(mesh.elements_y()) && few(mesh.elements_z())));
}

void take_task(std::span<const std::byte> bytes) {
  const ScratchFolder scratch;
  const auto folder = scratch.path() / "task";
  std::filesystem::create_directory(folder);
  const Result<SimulationTask> task = read_task(bytes, folder.string());
  require(std::distance(std::filesystem::directory_iterator(scratch.path()), {}) == 1);
  if (!task) return require(!task.error().empty());
  require(task_bytes(task.value()).has_value() || task.value().scene.ByteSizeLong() > 0);
  if (!is_small(task.value().scene) || task.value().from_rest || !task.value().parameters.empty())
    return;
  int asked = 0;
  pb::SimulationResult result;
  const Bytes made = run_task_bytes(bytes, [&asked] { return ++asked > 3; });
  require(result.ParseFromArray(made.data(), static_cast<int>(made.size())));
}

void take_result(std::span<const std::byte> bytes, pb::TissueModelKind model) {
  SimulationTask task = test::small_simulation(model);
  if (model == pb::TISSUE_REFERENCE) {
    task.parameters = "young_modulus";
    task.column_steps = {1};
  }
  const Result<Simulation> made = read_result(bytes, task);
  if (!made) return;
  const SimulatedRecording& recording = made.value().recording;
  require(!recording.time.empty() && recording.points.size() == recording.time.size() &&
          recording.surface.size() == recording.time.size());
  for (const auto& points : recording.points)
    require(points.size() == recording.points.front().size());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  const std::span<const std::byte> bytes = std::as_bytes(std::span(data, size)).subspan(1);
  if (data[0] % 3 == 0) {
    take_task(bytes);
  } else {
    take_result(bytes, data[0] % 3 == 1 ? pb::TISSUE_ELASTIC : pb::TISSUE_REFERENCE);
  }
  return 0;
}

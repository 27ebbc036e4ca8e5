// Writes the seeds of tests/fuzz/corpus/simulation/: tasks of simulations and their results, as
// tests/fuzz/fuzz_simulation.cpp reads them. Usage: make_simulation_corpus <folder>
#include <fmt/format.h>

#include <fstream>
#include <string>

#include "sim_worker/playback/simulation_bytes.h"
#include "tests/support/small_simulation.h"

int main(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  if (argc != 2) {
    fmt::print(stderr, "usage: make_simulation_corpus <folder>\n");
    return 2;
  }
  const auto write = [&](const std::string& name, char kind, const Bytes& bytes) {
    std::ofstream file(std::string(argv[1]) + "/" + name, std::ios::binary);
    file.put(kind);
    file.write(reinterpret_cast<const char*>(bytes.data()),
               static_cast<std::streamsize>(bytes.size()));
  };
  SimulationTask shell = test::small_simulation(pb::TISSUE_ELASTIC);
  write("task_shell", 0, task_bytes(shell).value());
  write("task_cluster", 0, task_bytes(test::small_simulation(pb::TISSUE_CLUSTER)).value());
  write("result_shell", 1, run_task_bytes(task_bytes(shell).value(), {}));
  SimulationTask reference = test::small_simulation(pb::TISSUE_REFERENCE);
  write("task_reference", 0, task_bytes(reference).value());
  reference.parameters = "young_modulus";
  reference.column_steps = {1};
  write("task_columns", 0, task_bytes(reference).value());
  write("result_columns", 2, run_task_bytes(task_bytes(reference).value(), {}));
  shell.parameters = "young_modulus";
  write("result_error", 1, run_task_bytes(task_bytes(shell).value(), {}));
  return 0;
}

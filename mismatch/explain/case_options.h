#pragma once

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "mismatch/calibrate/case_input.h"
#include "mismatch/explain/base_fit.h"

namespace omentum {

/// What the commands that ask recordings of a scene for effects have in common.
struct CaseOptions {
  std::string scene;
  std::vector<std::string> recordings, overrides, ruled_out;
  double tolerance_mm = 0.6, coarse_mm = 2;
  std::uint64_t seed = 1;
  std::size_t threads = std::max(1U, std::thread::hardware_concurrency());
  SimulatorOptions simulator;
};
void add_case_options(CLI::App& command, CaseOptions& options);

/// What explain() and planned_limits() are asked with; progress goes to a line of `program`, which
/// ends with it.
ExplainOptions explain_options(const CaseOptions& options, const CaseInput& input,
                               const std::shared_ptr<ProgressLine>& line);

/// Throws Error for a body that is no clamped sheet.
void check_is_clamped_sheet(const std::string& program, const CaseInput& input, const Scene& made);

}  // namespace omentum

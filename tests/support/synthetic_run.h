#pragma once

#include <string>

namespace omentum::test {

/// Writes a made-up run folder with every file the report reads: metrics of a run that learns, the
/// evaluation grids, a grasp lattice, figures and recordings of a sheet that is lifted by formula.
/// Nothing in it was simulated or trained.
void write_synthetic_run(const std::string& folder, int seed);

}  // namespace omentum::test

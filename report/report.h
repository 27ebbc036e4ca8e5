#pragma once

#include <string>
#include <vector>

#include "report/run_folder.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// The whole report of one run, or of several seeds of one experiment, as one HTML text that loads
/// nothing. `scene` is that of the runs; null leaves out pictures and replay. The same input gives
/// the same text.
std::string make_report(std::vector<RunFolder> runs, const Scene* scene);

}  // namespace omentum

#pragma once

#include <string>
#include <vector>

#include "report/run_folder.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// The whole report of one run, or of several seeds of one experiment, as one HTML text that loads
/// nothing. `scene` is that of the runs; null leaves out pictures and replay. The same input gives
/// the same text. `damaged` receives one line for all that could not be read, which the report
/// lists as well.
std::string make_report(const std::vector<RunFolder>& runs, const Scene* scene,
                        std::vector<std::string>* damaged = nullptr);

}  // namespace omentum

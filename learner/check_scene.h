#pragma once

#include <string>

namespace omentum {

/// Has the sim_worker beside this program make the scene of a resolved configuration, as a worker
/// of the run would: 0, or 2 where it cannot; it says why, and what is odd, on standard error. A
/// learner knows no scenes. Without a sim_worker there that is said instead.
int check_scene(const std::string& config_text);

}  // namespace omentum

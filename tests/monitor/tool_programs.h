#pragma once

#include <string>

#include "tests/integration/programs.h"

namespace omentum::test {

/// The program `omentum` on the domain of `programs`.
inline Strings tool(const Programs& programs, const std::string& subcommand, const std::string& run,
                    const Strings& more = {}) {
  return Strings{OMENTUM_TOOL, subcommand, "--run",
                 run,          "--domain", std::to_string(programs.domain())} +
         more;
}

}  // namespace omentum::test

#pragma once

namespace omentum {

/// `dvrk_gateway convert LOG -o FILE.mcap`: the recording of a captured wire log; of a recording
/// the plain folder. `argv[0]` is the word convert. Throws Error, one line with the option. Exit
/// code: 0 done.
int convert_program(int argc, char** argv);

}  // namespace omentum

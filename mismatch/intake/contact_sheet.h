#pragma once

#include <string>

#include "mismatch/recording/recording.h"

namespace omentum {

/// A PNG that shows what a recording holds: up to six of its clouds (from above, coloured by height
/// between the 2nd and 98th percentile of all shown), depth images (near is bright) and colour
/// pictures, then the curves of every channel by unit over one axis of time. Fetches only what it
/// shows. Throws Error where a picture cannot be read.
std::string make_contact_sheet(const Recording& recording);

}  // namespace omentum

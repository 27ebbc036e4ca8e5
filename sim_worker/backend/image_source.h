#pragma once

#include "sim_worker/backend/sim_backend.h"

namespace omentum {

/// What observation OBSERVATION_IMAGE sees: the endoscope's picture as floats in [0, 1], top row
/// first; object ids divided by 6, or shaded red, green, blue. Empty for other observations. Holds
/// one OSMesa context: one thread.
SimBackend::ImageSource make_image_source(const SimSetup& setup);

}  // namespace omentum

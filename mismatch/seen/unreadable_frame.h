#pragma once

#include "core/check.h"

namespace omentum {

/// Of a cloud that a recording states and that cannot be read.
class UnreadableFrame : public Error {
 public:
  using Error::Error;
};

}  // namespace omentum

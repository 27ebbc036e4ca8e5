#pragma once

#include <cstdint>

namespace omentum::test {

/// How often this thread has allocated by operator new, in a program that links
/// tests/support/allocation_count.cpp.
std::uint64_t allocation_count();

}  // namespace omentum::test

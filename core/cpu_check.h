#pragma once

#include <cstdint>

namespace omentum {

/// What CPUID and XGETBV say about the instructions that every program is compiled for.
struct CpuBits {
  std::uint32_t leaf1_ecx = 0;
  std::uint32_t leaf7_ebx = 0;
  std::uint64_t xcr0 = 0;  ///< registers that the operating system saves; 0 without OSXSAVE
};

/// Name of what is missing for x86-64 with AVX2 and FMA; null if nothing is.
const char* missing_instructions(const CpuBits& cpu) noexcept;

}  // namespace omentum

/// Ends the program with one line and exit code 2 on a CPU that lacks them. Runs by itself before
/// any initialiser of the program (core/CMakeLists.txt links it into every one); the name is C's so
/// that the linker can be told to keep it.
extern "C" void omentum_require_cpu() noexcept;

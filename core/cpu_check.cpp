// Compiled without the flags of everything else, and without anything of the C++ library: an
// inline function that others compile for AVX2 could be linked in the place of ours.

#include "core/cpu_check.h"

#include <cpuid.h>
#include <errno.h>
#include <string.h>
#include <unistd.h>

namespace omentum {
namespace {

CpuBits this_cpu() noexcept {
  CpuBits cpu;
  unsigned int a = 0, b = 0, c = 0, d = 0;
  if (__get_cpuid(1, &a, &b, &c, &d) != 0) cpu.leaf1_ecx = c;
  if (__get_cpuid_count(7, 0, &a, &b, &c, &d) != 0) cpu.leaf7_ebx = b;
  if ((cpu.leaf1_ecx & bit_OSXSAVE) != 0) {
    std::uint32_t low = 0, high = 0;
    __asm__("xgetbv" : "=a"(low), "=d"(high) : "c"(0));
    cpu.xcr0 = std::uint64_t{high} << 32 | low;
  }
  return cpu;
}

void say(const char* text) noexcept {
  // Nothing is left to do where standard error is closed.
  if (write(STDERR_FILENO, text, strlen(text)) < 0) return;
}

}  // namespace

const char* missing_instructions(const CpuBits& cpu) noexcept {
  if ((cpu.leaf1_ecx & bit_SSE4_2) == 0) return "SSE4.2";
  if ((cpu.leaf1_ecx & bit_AVX) == 0) return "AVX";
  if ((cpu.leaf1_ecx & bit_FMA) == 0) return "FMA";
  if ((cpu.leaf7_ebx & bit_AVX2) == 0) return "AVX2";
  constexpr std::uint64_t kVectorRegisters = 6;  // bits 1 and 2: XMM and YMM
  if ((cpu.xcr0 & kVectorRegisters) != kVectorRegisters) return "AVX in the operating system";
  return nullptr;
}

}  // namespace omentum

void omentum_require_cpu() noexcept {
  const char* missing = omentum::missing_instructions(omentum::this_cpu());
  if (missing == nullptr) return;
  omentum::say(program_invocation_short_name);
  omentum::say(": this CPU lacks ");
  omentum::say(missing);
  omentum::say("; needed: x86-64 with AVX2 and FMA (Intel since 2013, AMD since 2015)\n");
  _exit(2);
}

namespace {

// 101 is the first priority a program may use; initialisers of variables come at 65535.
__attribute__((constructor(101), used)) void check_at_start() { omentum_require_cpu(); }

}  // namespace

#include "core/cpu_check.h"

#include <cpuid.h>
#include <gtest/gtest.h>

namespace omentum {
namespace {

CpuBits haswell() {
  CpuBits cpu;
  cpu.leaf1_ecx = bit_SSE4_2 | bit_OSXSAVE | bit_AVX | bit_FMA;
  cpu.leaf7_ebx = bit_AVX2;
  cpu.xcr0 = 7;  // x87, XMM, YMM
  return cpu;
}

TEST(CpuCheck, NothingIsMissingOnAHaswell) { EXPECT_EQ(missing_instructions(haswell()), nullptr); }

TEST(CpuCheck, TheFirstMissingInstructionSetIsNamed) {
  EXPECT_STREQ(missing_instructions(CpuBits{}), "SSE4.2");
  CpuBits sandy_bridge = haswell();
  sandy_bridge.leaf1_ecx &= ~static_cast<std::uint32_t>(bit_FMA);
  sandy_bridge.leaf7_ebx = 0;
  EXPECT_STREQ(missing_instructions(sandy_bridge), "FMA");
  CpuBits piledriver = haswell();  // has FMA and no AVX2
  piledriver.leaf7_ebx = 0;
  EXPECT_STREQ(missing_instructions(piledriver), "AVX2");
  CpuBits nehalem;
  nehalem.leaf1_ecx = bit_SSE4_2;
  EXPECT_STREQ(missing_instructions(nehalem), "AVX");
}

TEST(CpuCheck, RegistersThatTheSystemDoesNotSaveCountAsMissing) {
  CpuBits cpu = haswell();
  for (const std::uint64_t saved : {0, 1, 3, 5}) {
    cpu.xcr0 = saved;
    EXPECT_STREQ(missing_instructions(cpu), "AVX in the operating system") << saved;
  }
}

TEST(CpuCheck, ThisCpuPasses) { omentum_require_cpu(); }

}  // namespace
}  // namespace omentum

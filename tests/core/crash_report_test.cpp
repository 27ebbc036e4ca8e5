// Faults that tell where they were (core/crash_report.h).
#include "core/crash_report.h"

#include <gtest/gtest.h>

#include <csignal>
#include <cstdint>

#include "core/check.h"

namespace omentum {
namespace {

// Whole paths of this program stand in the lines of the stack.
constexpr const char* kStack = "prog: signal 11 at address 0x[0-9a-f]+; stack.*\n.*_test.*\\+0x";

void write_to(std::uintptr_t address) {
  volatile std::uintptr_t hidden = address;  // from the compiler, which would refuse it
  *reinterpret_cast<volatile int*>(hidden) = 1;
}

TEST(CrashReport, ABadAddressIsToldWithTheStackAndEndsTheProcessByItsSignal) {
  EXPECT_EXIT(
      {
        report_crashes("prog");
        write_to(0x18);
      },
      testing::KilledBySignal(SIGSEGV), "prog: signal 11 at address 0x18; stack(.|\n)*\\+0x");
}

TEST(CrashReport, ASignalSentByAnotherEndsTheProcessToo) {
  EXPECT_EXIT(
      {
        report_crashes("prog");
        raise(SIGSEGV);
      },
      testing::KilledBySignal(SIGSEGV), kStack);
}

TEST(CrashReport, AFailedCheckTellsItsValuesAndThenItsStack) {
  EXPECT_EXIT(
      {
        report_crashes("prog");
        OMENTUM_CHECK(1 + 1 == 3, "sum {}", 2);
      },
      testing::KilledBySignal(SIGABRT), "check failed: 1 \\+ 1 == 3 sum 2\nprog: signal 6");
}

TEST(CrashReport, ASignalThatIsHandledAlreadyIsLeftAlone) {
  EXPECT_EXIT(
      {
        std::signal(SIGFPE, [](int) { _exit(7); });
        report_crashes("prog");
        raise(SIGFPE);
      },
      testing::ExitedWithCode(7), "^$");
}

}  // namespace
}  // namespace omentum

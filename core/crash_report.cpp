#include "core/crash_report.h"

#include <execinfo.h>
#include <signal.h>
#include <unistd.h>

#include <array>
#include <charconv>
#include <csignal>
#include <cstdint>
#include <string_view>

namespace omentum {
namespace {

constexpr int kMostFrames = 64;
const char* program_name = "";
std::array<char, 65536> other_stack;  // for a main thread whose own has run out

// Only write(2): the heap may be what broke.
void tell(std::string_view text) {
  [[maybe_unused]] const ssize_t written = write(STDERR_FILENO, text.data(), text.size());
}

void tell_number(std::uintptr_t number, int base) {
  std::array<char, 32> digits;
  const auto end = std::to_chars(digits.data(), digits.data() + digits.size(), number, base);
  tell({digits.data(), end.ptr});
}

void on_crash(int signal, siginfo_t* info, void* /*context*/) {
  tell(program_name);
  tell(": signal ");
  tell_number(static_cast<std::uintptr_t>(signal), 10);
  tell(" at address 0x");
  tell_number(reinterpret_cast<std::uintptr_t>(info->si_addr), 16);
  tell("; stack, for addr2line -Cfie:\n");
  std::array<void*, kMostFrames> frames;
  backtrace_symbols_fd(frames.data(), backtrace(frames.data(), kMostFrames), STDERR_FILENO);
  raise(signal);  // waits until this handler, which is taken out already, has returned
}

}  // namespace

void report_crashes(const char* program) {
  program_name = program;
  void* frame = nullptr;
  backtrace(&frame, 1);  // the first call loads a library, which a handler must not
  stack_t stack{};
  stack.ss_sp = other_stack.data();
  stack.ss_size = other_stack.size();
  sigaltstack(&stack, nullptr);
  for (const int signal : {SIGSEGV, SIGBUS, SIGILL, SIGFPE, SIGABRT}) {
    struct sigaction before {};
    if (sigaction(signal, nullptr, &before) != 0 || before.sa_handler != SIG_DFL) continue;
    struct sigaction action {};
    action.sa_sigaction = &on_crash;
    action.sa_flags = SA_SIGINFO | SA_RESETHAND | SA_ONSTACK;
    sigaction(signal, &action, nullptr);
  }
  // A file at its limit of size is as a full disk: the write fails and is told.
  std::signal(SIGXFSZ, SIG_IGN);
}

}  // namespace omentum

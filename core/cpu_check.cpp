// Ends a program at once, with one line and exit code 2, on a CPU or system that lacks the
// instructions every program is compiled for. core/CMakeLists.txt links this into every one and
// keeps it by its name, which is C's for that. Compiled without the flags of everything else, and
// without anything of the C++ library: an inline function that others compile for AVX2 could be
// linked in the place of ours.

#include <errno.h>
#include <string.h>
#include <unistd.h>

namespace {

/// Name of what is missing; null if nothing is. The built-in counts AVX, FMA and AVX2 only where
/// the operating system saves their registers.
const char* missing_instructions() noexcept {
  __builtin_cpu_init();
  if (!__builtin_cpu_supports("sse4.2")) return "SSE4.2";
  if (!__builtin_cpu_supports("avx")) return "AVX";
  if (!__builtin_cpu_supports("fma")) return "FMA";
  if (!__builtin_cpu_supports("avx2")) return "AVX2";
  return nullptr;
}

void say(const char* text) noexcept {
  // Nothing is left to do where standard error is closed.
  if (write(STDERR_FILENO, text, strlen(text)) < 0) return;
}

}  // namespace

extern "C" void omentum_require_cpu() noexcept;
extern "C" void omentum_require_cpu() noexcept {
  const char* missing = missing_instructions();
  if (missing == nullptr) return;
  say(program_invocation_short_name);
  say(": this CPU lacks ");
  say(missing);
  say("; needed: x86-64 with AVX2 and FMA (Intel since 2013, AMD since 2015)\n");
  _exit(2);
}

namespace {

// 101 is the first priority a program may use; initialisers of variables come at 65535.
__attribute__((constructor(101), used)) void check_at_start() { omentum_require_cpu(); }

}  // namespace

#pragma once

namespace omentum {

/// From now on a fault of ours that ends the process by a signal (SIGSEGV, SIGBUS, SIGILL, SIGFPE,
/// SIGABRT) first tells the signal and the stack of its thread on standard error; addr2line
/// resolves the lines. The process then ends by that signal as it would have: exit code and core
/// stay. A signal that somebody handles already, as sanitizers do, is left alone. Once, in main();
/// `program` must outlive the process.
void report_crashes(const char* program);

}  // namespace omentum

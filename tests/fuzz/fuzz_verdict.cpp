#include <cstddef>
#include <cstdint>
#include <string>

#include "mismatch/explain/verdict_file.h"
#include "mismatch/explain/verdict_text.h"

// Any text gives a verdict whose parts can be shown, or one line that names the file.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string text(reinterpret_cast<const char*>(data), size);
  const auto verdict = omentum::parse_verdict("fuzz", text);
  if (!verdict) {
    const std::string& error = verdict.error();
    if (!error.starts_with("fuzz:") || error.find('\n') != std::string::npos) __builtin_trap();
    return 0;
  }
  for (const std::string& part :
       {omentum::locate_text(verdict.value()), omentum::name_text(verdict.value()),
        omentum::model_text(verdict.value(), "scene"),
        omentum::show_text(verdict.value(), "scene")}) {
    if (part.empty() || part.back() != '\n') __builtin_trap();
    for (const char c : part) {
      if (c != '\n' && static_cast<unsigned char>(c) < 0x20) __builtin_trap();
    }
  }
  return 0;
}

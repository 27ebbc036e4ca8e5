#include <cstddef>
#include <cstdint>
#include <string>

#include "core/episode_recording.h"
#include "core/mcap.h"

// Any bytes give a content; what is damaged is listed. An episode is either there or refused.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string bytes(reinterpret_cast<const char*>(data), size);
  const omentum::McapContent content = omentum::read_mcap(bytes);
  if (!content.complete && content.problems.empty()) __builtin_trap();
  const auto episode = omentum::parse_episode("fuzz", bytes);
  if (!episode && episode.error().empty()) __builtin_trap();
  return 0;
}

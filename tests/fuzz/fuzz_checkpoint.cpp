#include <cstddef>
#include <cstdint>
#include <cstring>
#include <span>
#include <vector>

#include "core/hash.h"
#include "learner/checkpoint.h"
#include "tests/fuzz/tiny_ppo.h"

// Any bytes give a checkpoint or a reason, and any checkpoint is taken or refused by PPO.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

omentum::Ppo& tiny_ppo() {
  static const auto ppo = omentum::test::make_tiny_ppo();
  return *ppo;
}

void feed(std::span<const std::byte> bytes) {
  const auto checkpoint = omentum::decode_checkpoint(bytes);
  if (!checkpoint) {
    if (checkpoint.error().empty()) __builtin_trap();
    return;
  }
  const auto previous = omentum::from_disk(checkpoint.value().previous_weights());
  if (!previous && previous.error().empty()) __builtin_trap();
  const auto taken = tiny_ppo().load(checkpoint.value().ppo());
  if (!taken && taken.error().empty()) __builtin_trap();
  const auto same = omentum::check_same_config(checkpoint.value(), 1, "ppo {\n  hidden: 8\n}\n");
  if (!same && same.error().empty()) __builtin_trap();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto bytes = std::as_bytes(std::span(data, size));
  feed(bytes);
  // The same as the payload of a file whose frame is right: else the CRC hides everything behind.
  std::vector<std::byte> file(16 + size + 4);
  const std::uint64_t length = size;
  std::memcpy(file.data(), "OMCKPT01", 8);
  std::memcpy(file.data() + 8, &length, 8);
  if (size > 0) std::memcpy(file.data() + 16, data, size);
  const std::uint32_t crc = omentum::crc32c(std::span(file).first(16 + size));
  std::memcpy(file.data() + 16 + size, &crc, 4);
  feed(file);
  return 0;
}

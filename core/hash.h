#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>

namespace omentum {

/// FNV-1a 64. Continues from `seed`, the hash of what came before, so that pieces can be chained.
/// Source: draft-eastlake-fnv; offset basis cbf29ce484222325, prime 100000001b3.
inline constexpr std::uint64_t kFnvOffset = 0xcbf29ce484222325ULL;
std::uint64_t fnv1a64(std::span<const std::byte> bytes, std::uint64_t seed = kFnvOffset);
std::uint64_t fnv1a64(std::string_view text, std::uint64_t seed = kFnvOffset);

/// Hash of an environment state (start_hash, end_hash, state_hashes): four chains of 64-bit words,
/// each step a bijection of the word, so any change within one word changes the result. 20 times
/// the speed of fnv1a64 (a state of 23 kB, 25 us there, is hashed three times per segment). For
/// integrity, not against an adversary. Reaches wire and recordings: do not change.
std::uint64_t hash_state(std::span<const std::byte> bytes);

/// CRC-32C (Castagnoli), as used by TensorBoard records, checkpoints and segments; `seed` is the
/// CRC of what came before. Hardware instruction of SSE4.2.
std::uint32_t crc32c(std::span<const std::byte> bytes, std::uint32_t seed = 0);

/// SHA-256 through OpenSSL.
using Sha256 = std::array<std::uint8_t, 32>;
Sha256 sha256(std::span<const std::byte> bytes);

/// Lower-case hexadecimal of the bytes.
std::string hex(std::span<const std::uint8_t> bytes);

/// The values as they lie in memory: T must be trivially copyable and have no padding, whose bytes
/// are undefined.
template <typename T>
std::span<const std::byte> bytes_of(std::span<const T> values) {
  return std::as_bytes(values);
}

}  // namespace omentum

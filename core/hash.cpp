#include "core/hash.h"

#include <nmmintrin.h>
#include <openssl/evp.h>

#include <bit>
#include <cstring>

#include "core/check.h"

namespace omentum {

std::uint64_t fnv1a64(std::span<const std::byte> bytes, std::uint64_t seed) {
  std::uint64_t hash = seed;
  for (const std::byte b : bytes) {
    hash = (hash ^ static_cast<std::uint64_t>(b)) * 0x100000001b3ULL;
  }
  return hash;
}

std::uint64_t fnv1a64(std::string_view text, std::uint64_t seed) {
  return fnv1a64(std::as_bytes(std::span(text.data(), text.size())), seed);
}

// Not vectorised: AVX2 has no multiplication of 64-bit words, and what stands in for it takes 3
// times as long.
[[gnu::optimize("no-tree-slp-vectorize", "no-tree-loop-vectorize")]] std::uint64_t hash_state(
    std::span<const std::byte> bytes) {
  // The word is multiplied first: else a change of one word could equal a change of the next.
  constexpr std::uint64_t kWord = 0x9e3779b97f4a7c15ULL;   // 2^64 / golden ratio
  constexpr std::uint64_t kChain = 0xd1342543de82ef95ULL;  // multiplier of Steele and Vigna, 2021
  const auto mix = [](std::uint64_t hash, std::uint64_t word) {
    return std::rotl(hash + word * kWord, 31) * kChain;
  };
  std::array<std::uint64_t, 4> chain = {1, 2, 3, 4};
  std::size_t i = 0;
  for (; i + 32 <= bytes.size(); i += 32) {
    std::array<std::uint64_t, 4> words{};
    std::memcpy(words.data(), bytes.data() + i, 32);
    for (std::size_t k = 0; k < 4; ++k) chain[k] = mix(chain[k], words[k]);
  }
  std::array<std::uint64_t, 4> tail{};
  if (i < bytes.size()) std::memcpy(tail.data(), bytes.data() + i, bytes.size() - i);
  for (std::size_t k = 0; k < 4; ++k) chain[k] = mix(chain[k], tail[k]);
  std::uint64_t hash = mix(0, bytes.size());
  for (const std::uint64_t part : chain) hash = mix(hash, part);
  hash ^= hash >> 32;
  return hash * kWord;
}

std::uint32_t crc32c(std::span<const std::byte> bytes, std::uint32_t seed) {
  std::uint64_t crc = ~seed;
  std::size_t i = 0;
  for (; i + 8 <= bytes.size(); i += 8) {
    std::uint64_t word = 0;
    std::memcpy(&word, bytes.data() + i, 8);
    crc = _mm_crc32_u64(crc, word);
  }
  auto crc32 = static_cast<std::uint32_t>(crc);
  for (; i < bytes.size(); ++i) crc32 = _mm_crc32_u8(crc32, static_cast<std::uint8_t>(bytes[i]));
  return ~crc32;
}

Sha256 sha256(std::span<const std::byte> bytes) {
  Sha256 digest{};
  unsigned int size = 0;
  const int ok =
      EVP_Digest(bytes.data(), bytes.size(), digest.data(), &size, EVP_sha256(), nullptr);
  OMENTUM_CHECK(ok == 1 && size == digest.size());
  return digest;
}

std::string hex(std::span<const std::uint8_t> bytes) {
  std::string text;
  for (const std::uint8_t b : bytes) text += fmt::format("{:02x}", b);
  return text;
}

}  // namespace omentum

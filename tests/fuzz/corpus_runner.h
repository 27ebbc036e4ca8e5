#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace omentum::test {

/// Feeds every seed of a folder, prefixes of it and flipped bytes, `stride` bytes apart. Returns
/// how many seeds there were.
inline int run_corpus(const std::string& folder, std::size_t stride) {
  const auto feed = [](const std::string& content) {
    // A copy of exactly this size, so that a sanitizer sees a read beyond the end.
    const std::vector<std::uint8_t> bytes(content.begin(), content.end());
    LLVMFuzzerTestOneInput(bytes.data(), bytes.size());
  };
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    ++files;
    std::ifstream file(entry.path(), std::ios::binary);
    std::ostringstream text;
    text << file.rdbuf();
    const std::string content = text.str();
    EXPECT_FALSE(content.empty()) << entry.path();
    feed(content);
    for (std::size_t size = 0; size < content.size(); size += stride) {
      feed(content.substr(0, size));
    }
    std::string flipped = content;
    for (std::size_t at = 0; at < flipped.size(); at += stride) {
      const char original = flipped[at];
      for (const char mask : {'\x01', '\x10', '\x80', '\xff'}) {
        flipped[at] = static_cast<char>(original ^ mask);
        feed(flipped);
      }
      flipped[at] = original;
    }
  }
  return files;
}

}  // namespace omentum::test

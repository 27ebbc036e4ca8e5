#include <fmt/format.h>
#include <gtest/gtest.h>
#include <malloc.h>

#include <cstdint>
#include <sstream>
#include <string>
#include <string_view>

#include "core/mcap.h"
#include "core/mcap_format.h"
#include "proto/recording.pb.h"

namespace omentum {
namespace {

/// Takes everything and keeps nothing.
class NoBuffer : public std::streambuf {
 protected:
  int_type overflow(int_type c) override { return traits_type::not_eof(c); }
  std::streamsize xsputn(const char* /*text*/, std::streamsize size) override { return size; }
};

/// Of the summary a reader jumps to: opcode and content of the record at a place of the file.
std::pair<std::uint8_t, std::string_view> record_at(std::string_view file, std::uint64_t place) {
  mcap::ByteCursor cursor(file.substr(place));
  const auto opcode = cursor.get<std::uint8_t>();
  return {opcode, cursor.get_bytes(cursor.get<std::uint64_t>())};
}

TEST(McapWriter, TheSummaryPointsAtEveryChunkAndMessageIndex) {
  std::ostringstream out;
  McapWriter writer(out, McapCompression::kZstd);
  const auto a = writer.add_channel("/a", *pb::StepRecord::descriptor());
  const auto b = writer.add_channel("/b", *pb::StepRecord::descriptor());
  pb::StepRecord message;
  constexpr std::uint64_t kChunks = 800;         // so many that what is kept of them is packed
  for (std::uint64_t k = 0; k < kChunks; ++k) {  // chunks with one and with two channels
    for (std::uint64_t n = 0; n <= k % 7; ++n) writer.write(b, 100 * k + n, 0, message);
    if (k % 2 == 0) writer.write(a, 100 * k + 50, 0, message);
    writer.flush();
  }
  ASSERT_TRUE(writer.finish());
  const std::string file = out.str();

  constexpr std::size_t kFooterBytes = 1 + 8 + 8 + 8 + 4;
  const auto [footer, places] = record_at(file, file.size() - mcap::kMagic.size() - kFooterBytes);
  ASSERT_EQ(footer, mcap::kFooter);
  auto place = mcap::ByteCursor(places).get<std::uint64_t>();
  std::uint64_t chunks = 0;
  for (;;) {
    const auto [opcode, content] = record_at(file, place);
    if (opcode == mcap::kFooter) break;
    place += 9 + content.size();
    if (opcode != mcap::kChunkIndex) continue;
    mcap::ByteCursor entry(content);
    EXPECT_EQ(entry.get<std::uint64_t>(), 100 * chunks);
    EXPECT_EQ(entry.get<std::uint64_t>(), 100 * chunks + (chunks % 2 == 0 ? 50 : chunks % 7));
    const auto offset = entry.get<std::uint64_t>(), length = entry.get<std::uint64_t>();
    const auto [chunk, data] = record_at(file, offset);
    EXPECT_EQ(chunk, mcap::kChunk);
    EXPECT_EQ(length, 9 + data.size());
    mcap::ByteCursor indexes(entry.get_string());
    std::uint64_t bytes = 0;
    for (const McapWriter::ChannelId channel : {a, b}) {
      if (channel == a && chunks % 2 != 0) continue;
      EXPECT_EQ(indexes.get<McapWriter::ChannelId>(), channel);
      const auto [index, of] = record_at(file, indexes.get<std::uint64_t>());
      EXPECT_EQ(index, mcap::kMessageIndex);
      mcap::ByteCursor found(of);
      EXPECT_EQ(found.get<McapWriter::ChannelId>(), channel);
      EXPECT_EQ(found.get_string().size(), 16 * (channel == a ? 1 : chunks % 7 + 1));
      bytes += 9 + of.size();
    }
    EXPECT_TRUE(indexes.ok() && indexes.rest().empty());
    EXPECT_EQ(entry.get<std::uint64_t>(), bytes);
    ++chunks;
  }
  EXPECT_EQ(chunks, kChunks);
}

// A gateway flushes every second for hours: 1.5 kB, then 114 bytes, were kept for each before.
TEST(McapWriter, KeepsNextToNothingOfAChunkThatIsWritten) {
  NoBuffer nowhere;
  std::ostream out(&nowhere);
  McapWriter writer(out, McapCompression::kZstd);
  constexpr int kChannels = 12, kChunks = 4000;
  for (int i = 0; i < kChannels; ++i)
    writer.add_channel(fmt::format("/{}", i), *pb::StepRecord::descriptor());
  const auto in_use = [] {
    const struct mallinfo2 info = mallinfo2();
    return info.uordblks + info.hblkhd;
  };
  const pb::StepRecord message;
  std::size_t before = 0;
  for (std::uint64_t k = 0; k < 2 * kChunks; ++k) {
    if (k == kChunks) before = in_use();
    for (McapWriter::ChannelId i = 1; i <= kChannels; ++i) writer.write(i, k, 0, message);
    writer.flush();
  }
  EXPECT_LT(in_use(), before + 20 * std::size_t{kChunks});
  EXPECT_TRUE(writer.finish());
}

}  // namespace
}  // namespace omentum

#include <fmt/core.h>
#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <set>

#include "core/mcap.h"
#include "core/mcap_format.h"

namespace omentum {
namespace {

using namespace mcap;  // NOLINT(google-build-using-namespace): the byte level of this format

// Hostile input must not exhaust memory.
constexpr std::uint64_t kMaxDecompressed = std::uint64_t{1} << 30;
constexpr std::size_t kMaxProblems = 100;

std::uint32_t crc32_of(std::string_view bytes) {
  return static_cast<std::uint32_t>(
      crc32_z(0, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

/// One pass over a file.
class Reader {
 public:
  explicit Reader(std::string_view bytes) : bytes_(bytes) {}

  McapContent run() {
    if (bytes_.substr(0, kMagic.size()) != kMagic) {
      problem(0, "no MCAP magic at the start");
      return std::move(content_);
    }
    std::size_t at = kMagic.size();
    while (at < bytes_.size() && !content_.complete) {
      ByteCursor cursor(bytes_.substr(at));
      const auto opcode = cursor.get<std::uint8_t>();
      const auto length = cursor.get<std::uint64_t>();
      const std::string_view body = cursor.get_bytes(length);
      if (!cursor.ok()) {
        const bool chunk = opcode == kChunk && !data_ended_;
        content_.chunks_skipped += chunk ? 1 : 0;
        problem(at, fmt::format("file ends inside a {} of {} bytes", chunk ? "chunk" : "record",
                                length));
        break;
      }
      record(opcode, body, at);
      at += 9 + body.size();
    }
    if (!content_.complete) problem(at, "file ends without footer: the writer was stopped");
    return std::move(content_);
  }

 private:
  void problem(std::size_t at, const std::string& text) {
    if (content_.problems.size() < kMaxProblems)
      content_.problems.push_back(fmt::format("byte {}: {}", at, text));
  }

  /// A record outside of chunks.
  void record(std::uint8_t opcode, std::string_view body, std::size_t at) {
    switch (opcode) {
      case kHeader: {
        ByteCursor cursor(body);
        cursor.get_string();  // profile
        cursor.get_string();  // library
        if (!cursor.ok()) problem(at, "malformed header");
        break;
      }
      case kChunk:
        if (!data_ended_) chunk(body, at);
        break;
      case kDataEnd: {
        ByteCursor cursor(body);
        const auto crc = cursor.get<std::uint32_t>();
        if (!cursor.ok()) problem(at, "malformed end of data");
        if (crc != 0 && crc != crc32_of(bytes_.substr(0, at)))
          problem(at, "CRC of the data section differs");
        data_ended_ = true;
        summary_start_ = at + 9 + body.size();
        break;
      }
      case kFooter:
        footer(body, at);
        break;
      default:
        if (!data_ended_) data_record(opcode, body, at);
        break;
    }
  }

  void footer(std::string_view body, std::size_t at) {
    ByteCursor cursor(body);
    const auto summary_start = cursor.get<std::uint64_t>();
    cursor.get<std::uint64_t>();
    const auto crc = cursor.get<std::uint32_t>();
    const std::size_t end = at + 9 + body.size();
    if (!cursor.ok() || body.size() != 20) problem(at, "malformed footer");
    if (bytes_.substr(end) != kMagic) problem(end, "no MCAP magic at the end");
    if (!data_ended_) problem(at, "footer without end of data");
    // The CRC covers the summary and the footer up to the CRC itself.
    const std::size_t crc_at = at + 9 + 16;
    if (crc != 0 && (summary_start != summary_start_ ||
                     crc != crc32_of(bytes_.substr(summary_start_, crc_at - summary_start_)))) {
      problem(at, "CRC of the summary differs");
    }
    content_.complete = true;
  }

  void chunk(std::string_view body, std::size_t at) {
    ByteCursor cursor(body);
    cursor.get<std::uint64_t>();
    cursor.get<std::uint64_t>();
    const auto size = cursor.get<std::uint64_t>();
    const auto crc = cursor.get<std::uint32_t>();
    const std::string_view compression = cursor.get_string();
    const std::string_view packed = cursor.get_bytes(cursor.get<std::uint64_t>());
    const auto skip = [&](const std::string& why) {
      ++content_.chunks_skipped;
      problem(at, "chunk skipped: " + why);
    };
    if (!cursor.ok()) return skip("malformed");
    if (size > kMaxDecompressed - decompressed_)
      return skip(fmt::format("{} bytes decompressed, too many", size));
    std::string unpacked;
    std::string_view records = packed;
    if (compression == "zstd") {
      // The true size is known to zstd in most files; trusting it bounds what a lying `size` can
      // allocate.
      const unsigned long long framed = ZSTD_getFrameContentSize(packed.data(), packed.size());
      if (framed == ZSTD_CONTENTSIZE_ERROR) return skip("not zstd");
      if (framed != ZSTD_CONTENTSIZE_UNKNOWN && framed != size) return skip("sizes disagree");
      unpacked.resize(static_cast<std::size_t>(size));
      const std::size_t got =
          ZSTD_decompress(unpacked.data(), unpacked.size(), packed.data(), packed.size());
      if (ZSTD_isError(got) != 0) return skip(ZSTD_getErrorName(got));
      if (got != size) return skip("sizes disagree");
      records = unpacked;
    } else if (!compression.empty()) {
      return skip("compression is not supported");
    } else if (packed.size() != size) {
      return skip("sizes disagree");
    }
    if (crc != 0 && crc != crc32_of(records)) return skip("CRC differs");
    decompressed_ += records.size();
    ++content_.chunks;
    while (!records.empty()) {
      ByteCursor inner(records);
      const auto opcode = inner.get<std::uint8_t>();
      const std::string_view inner_body = inner.get_bytes(inner.get<std::uint64_t>());
      if (!inner.ok()) return problem(at, "chunk ends inside a record");
      data_record(opcode, inner_body, at);
      records = inner.rest();
    }
  }

  /// Schema, channel or message, inside or outside a chunk.
  void data_record(std::uint8_t opcode, std::string_view body, std::size_t at) {
    ByteCursor cursor(body);
    if (opcode == kSchema) {
      const auto id = cursor.get<std::uint16_t>();
      McapSchema schema;
      schema.name = cursor.get_string();
      schema.encoding = cursor.get_string();
      schema.data = cursor.get_string();
      if (!cursor.ok()) return problem(at, "malformed schema");
      if (id != 0) schemas_.emplace(id, std::move(schema));
    } else if (opcode == kChannel) {
      McapChannel channel;
      const auto id = cursor.get<std::uint16_t>();
      const auto schema_id = cursor.get<std::uint16_t>();
      channel.topic = cursor.get_string();
      channel.encoding = cursor.get_string();
      cursor.get_string();  // metadata
      if (!cursor.ok()) return problem(at, "malformed channel");
      if (const auto schema = schemas_.find(schema_id); schema != schemas_.end()) {
        channel.schema = schema->second;
      } else if (schema_id != 0) {
        problem(at, fmt::format("channel {} refers to schema {}, which is missing", id, schema_id));
      }
      content_.channels.emplace(id, std::move(channel));
    } else if (opcode == kMessage) {
      McapMessage message;
      message.channel = cursor.get<std::uint16_t>();
      message.sequence = cursor.get<std::uint32_t>();
      message.log_time = cursor.get<std::uint64_t>();
      cursor.get<std::uint64_t>();  // publish time
      if (!cursor.ok()) return problem(at, "malformed message");
      if (!content_.channels.contains(message.channel)) {
        return problem(
            at, fmt::format("message of channel {}, which is missing, dropped", message.channel));
      }
      message.data = cursor.rest();
      content_.messages.push_back(std::move(message));
    }
  }

  std::string_view bytes_;
  McapContent content_;
  std::map<std::uint16_t, McapSchema> schemas_;
  std::uint64_t decompressed_ = 0;
  bool data_ended_ = false;
  std::size_t summary_start_ = 0;
};

}  // namespace

std::vector<const McapMessage*> McapContent::of_topic(std::string_view topic) const {
  std::set<std::uint16_t> ids;
  for (const auto& [id, channel] : channels) {
    if (channel.topic == topic) ids.insert(id);
  }
  std::vector<const McapMessage*> found;
  for (const McapMessage& message : messages) {
    if (ids.contains(message.channel)) found.push_back(&message);
  }
  return found;
}

McapContent read_mcap(std::string_view bytes) { return Reader(bytes).run(); }

}  // namespace omentum

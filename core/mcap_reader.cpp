#include <fmt/core.h>
#include <zlib.h>

#include <algorithm>
#include <fstream>
#include <set>
#include <streambuf>

#include "core/check.h"
#include "core/mcap.h"
#include "core/mcap_chunk.h"
#include "core/mcap_format.h"
#include "core/regular_file.h"

namespace omentum {
namespace {

using namespace mcap;  // NOLINT(google-build-using-namespace): the byte level of this format

// Hostile input must not exhaust memory.
constexpr std::uint64_t kMaxChunk = std::uint64_t{1} << 30;
constexpr std::size_t kMaxProblems = 100;
/// A length that lies costs one block.
constexpr std::uint64_t kBlock = std::uint64_t{1} << 20;
constexpr std::size_t kHead = 9;  ///< opcode and length of a record

std::uint32_t crc32_of(std::string_view bytes, std::uint32_t start) {
  return static_cast<std::uint32_t>(
      crc32_z(start, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

struct Record {
  std::uint8_t opcode = 0;
  std::uint64_t length = 0;
};

Record record_of(std::string_view head) {
  ByteCursor cursor(head);
  Record record;
  record.opcode = cursor.get<std::uint8_t>();
  record.length = cursor.get<std::uint64_t>();
  return record;
}

/// A stream of bytes that lie in memory.
class ViewBuffer : public std::streambuf {
 public:
  explicit ViewBuffer(std::string_view bytes) {
    char* begin = const_cast<char*>(bytes.data());  // NOLINT: streambuf has no const; only read
    setg(begin, begin, begin + bytes.size());
  }
};

/// Reads up to `size` bytes; false where there are fewer.
bool read_from(std::istream& in, std::uint64_t size, std::string& bytes) {
  bytes.clear();
  while (bytes.size() < size) {
    const std::size_t had = bytes.size();
    const std::uint64_t more =
        std::min<std::uint64_t>(size - had, std::max<std::uint64_t>(kBlock, had));
    bytes.resize(had + static_cast<std::size_t>(more));
    in.read(bytes.data() + had, static_cast<std::streamsize>(more));
    bytes.resize(had + static_cast<std::size_t>(in.gcount()));
    if (bytes.size() < had + more) return false;
  }
  return true;
}

}  // namespace

McapReader::McapReader(std::istream& in, std::uint64_t most_unpacked)
    : in_(in), most_unpacked_(most_unpacked) {}

void McapReader::problem(std::uint64_t at, const std::string& text) {
  if (problems_.size() < kMaxProblems) problems_.push_back(fmt::format("byte {}: {}", at, text));
}

bool McapReader::read(std::size_t size, std::string& bytes) {
  const bool whole = read_from(in_, size, bytes);
  position_ += bytes.size();
  return whole;
}

bool McapReader::pass_over(std::uint64_t size) {
  while (size > 0) {
    const std::uint64_t block = std::min(size, kBlock);
    if (!read(static_cast<std::size_t>(block), body_)) return false;
    crc_ = crc32_of(body_, crc_);
    size -= block;
  }
  return true;
}

bool McapReader::next(McapView& message) {
  if (!begun_) {
    begun_ = true;
    if (!read(kMagic.size(), body_) || body_ != kMagic) {
      problem(0, "no MCAP magic at the start");
      ended_ = true;
    }
    crc_ = crc32_of(body_, 0);
  }
  while (!ended_) {
    if (records_.empty() ? next_record(message) : inner_record(message)) return true;
  }
  return false;
}

/// A record outside of chunks; true where it is a message.
bool McapReader::next_record(McapView& message) {
  at_ = position_;
  const bool has_head = read(kHead, head_);
  if (head_.empty()) {
    problem(at_, "file ends without footer: the writer was stopped");
    ended_ = true;
    return false;
  }
  const auto [opcode, length] = has_head ? record_of(head_) : Record{};
  const std::string head = head_;
  const bool holds_data = opcode == kHeader || opcode == kSchema || opcode == kChannel ||
                          opcode == kMessage || opcode == kChunk || opcode == kDataEnd ||
                          opcode == kFooter;
  const bool chunk_here = opcode == kChunk && !data_ended_;
  const bool kept = holds_data && length <= kMaxChunk;
  const std::uint32_t crc_before = crc_;
  crc_ = crc32_of(head, crc_);
  const bool whole =
      has_head && (kept ? read(static_cast<std::size_t>(length), body_) : pass_over(length));
  if (!whole) {
    chunks_skipped_ += chunk_here ? 1 : 0;
    problem(at_, fmt::format("file ends inside a {} of {} bytes", chunk_here ? "chunk" : "record",
                             length));
    problem(at_, "file ends without footer: the writer was stopped");
    ended_ = true;
    return false;
  }
  if (opcode == kDataEnd) {
    crc_ = crc_before;
    data_end();
    return false;
  }
  if (opcode == kFooter) {
    crc_ = crc_before;
    footer(head);
    return false;
  }
  if (kept) crc_ = crc32_of(body_, crc_);
  if (data_ended_) return false;
  if (!kept && holds_data) {
    chunks_skipped_ += chunk_here ? 1 : 0;
    problem(at_, fmt::format("record of {} bytes skipped: too many", length));
    return false;
  }
  if (!kept) return false;
  if (opcode == kChunk) {
    chunk();
    return false;
  }
  message.place = {at_, 0};
  return data_record(opcode, body_, message);
}

void McapReader::chunk() {
  const std::uint64_t most = std::min(kMaxChunk, most_unpacked_ - unpacked_bytes_);
  const Result<std::string_view> records = unpack_chunk(body_, most, unpacked_);
  if (!records) {
    ++chunks_skipped_;
    return problem(at_, "chunk skipped: " + records.error());
  }
  ++chunks_;
  records_ = records.value();
  in_chunk_ = records_.size();
  unpacked_bytes_ += in_chunk_;
}

/// A record of the chunk in hand; true where it is a message.
bool McapReader::inner_record(McapView& message) {
  message.place = {at_, in_chunk_ - records_.size()};
  ByteCursor cursor(records_);
  const auto opcode = cursor.get<std::uint8_t>();
  const std::string_view body = cursor.get_bytes(cursor.get<std::uint64_t>());
  records_ = cursor.rest();
  if (cursor.ok()) return data_record(opcode, body, message);
  problem(at_, "chunk ends inside a record");
  return false;
}

/// Schema, channel or message, inside or outside a chunk.
bool McapReader::data_record(std::uint8_t opcode, std::string_view body, McapView& message) {
  ByteCursor cursor(body);
  const auto malformed = [&](const char* what) {
    problem(at_, fmt::format("malformed {}", what));
    return false;
  };
  if (opcode == kHeader) {
    cursor.get_string();  // profile
    cursor.get_string();  // library
    if (!cursor.ok()) return malformed("header");
  } else if (opcode == kSchema) {
    const auto id = cursor.get<std::uint16_t>();
    McapSchema schema;
    schema.name = cursor.get_string();
    schema.encoding = cursor.get_string();
    schema.data = cursor.get_string();
    if (!cursor.ok()) return malformed("schema");
    if (id != 0) schemas_.emplace(id, std::move(schema));
  } else if (opcode == kChannel) {
    McapChannel channel;
    const auto id = cursor.get<std::uint16_t>();
    const auto schema_id = cursor.get<std::uint16_t>();
    channel.topic = cursor.get_string();
    channel.encoding = cursor.get_string();
    cursor.get_string();  // metadata
    if (!cursor.ok()) return malformed("channel");
    if (const auto schema = schemas_.find(schema_id); schema != schemas_.end()) {
      channel.schema = schema->second;
    } else if (schema_id != 0) {
      problem(at_, fmt::format("channel {} refers to schema {}, which is missing", id, schema_id));
    }
    channels_.emplace(id, std::move(channel));
  } else if (opcode == kMessage) {
    message.channel = cursor.get<std::uint16_t>();
    message.sequence = cursor.get<std::uint32_t>();
    message.log_time = cursor.get<std::uint64_t>();
    cursor.get<std::uint64_t>();  // publish time
    if (!cursor.ok()) return malformed("message");
    message.data = cursor.rest();
    if (channels_.contains(message.channel)) return true;
    problem(at_, fmt::format("message of channel {}, which is missing, dropped", message.channel));
  }
  return false;
}

void McapReader::data_end() {
  ByteCursor cursor(body_);
  const auto crc = cursor.get<std::uint32_t>();
  if (!cursor.ok()) problem(at_, "malformed end of data");
  if (crc != 0 && crc != crc_) problem(at_, "CRC of the data section differs");
  data_ended_ = true;
  summary_start_ = position_;
  crc_ = 0;
}

void McapReader::footer(std::string_view head) {
  constexpr std::size_t kBeforeCrc = 16;
  ByteCursor cursor(body_);
  const auto summary_start = cursor.get<std::uint64_t>();
  cursor.get<std::uint64_t>();
  const auto crc = cursor.get<std::uint32_t>();
  if (!cursor.ok() || body_.size() != kBeforeCrc + 4) problem(at_, "malformed footer");
  if (!data_ended_) problem(at_, "footer without end of data");
  // The CRC covers the summary and the footer up to the CRC itself.
  crc_ = crc32_of(head, crc_);
  crc_ = crc32_of(std::string_view(body_).substr(0, kBeforeCrc), crc_);
  if (crc != 0 && (summary_start != summary_start_ || crc != crc_))
    problem(at_, "CRC of the summary differs");
  const std::uint64_t end = position_;
  if (read(kMagic.size() + 1, body_) || body_ != kMagic) problem(end, "no MCAP magic at the end");
  complete_ = ended_ = true;
}

McapFetcher::McapFetcher(const std::string& path) : path_(path) {
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  in_ = std::make_unique<std::ifstream>(path, std::ios::binary);
  if (!*in_) throw_error("{}: cannot be opened", path);
}

std::string_view McapFetcher::fetch(const McapPlace& place) {
  const auto changed = [&] {
    throw_error("{}: byte {}: no message here any more: the file has changed", path_, place.record);
  };
  if (place.record != record_) {
    record_ = ~std::uint64_t{0};
    in_->clear();
    in_->seekg(static_cast<std::streamoff>(place.record));
    std::string head;
    if (!read_from(*in_, kHead, head)) changed();
    const auto [opcode, length] = record_of(head);
    if (length > kMaxChunk || !read_from(*in_, length, body_)) changed();
    if (opcode == kChunk) {
      const Result<std::string_view> records = unpack_chunk(body_, kMaxChunk, unpacked_);
      if (!records) changed();
      records_ = records.value();
    } else {
      body_.insert(0, head);
      records_ = body_;
    }
    record_ = place.record;
  }
  if (place.within > records_.size()) changed();
  ByteCursor cursor(records_.substr(static_cast<std::size_t>(place.within)));
  if (cursor.get<std::uint8_t>() != kMessage) changed();
  ByteCursor message(cursor.get_bytes(cursor.get<std::uint64_t>()));
  message.get_bytes(2 + 4 + 8 + 8);  // channel, sequence, log time, publish time
  if (!message.ok() || !cursor.ok()) changed();
  return message.rest();
}

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

McapContent read_mcap(std::string_view bytes) {
  constexpr std::uint64_t kMostUnpacked = std::uint64_t{1} << 30;
  ViewBuffer buffer(bytes);
  std::istream in(&buffer);
  McapReader reader(in, kMostUnpacked);
  McapContent content;
  for (McapView view; reader.next(view);)
    content.messages.push_back(
        {view.channel, view.sequence, view.log_time, std::string(view.data)});
  content.channels = reader.channels();
  content.chunks = reader.chunks();
  content.chunks_skipped = reader.chunks_skipped();
  content.complete = reader.complete();
  content.problems = reader.problems();
  return content;
}

}  // namespace omentum

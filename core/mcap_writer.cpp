#include <google/protobuf/descriptor.h>
#include <google/protobuf/descriptor.pb.h>
#include <zlib.h>

#include <algorithm>
#include <limits>
#include <set>

#include "core/check.h"
#include "core/mcap.h"
#include "core/mcap_chunk.h"
#include "core/mcap_format.h"

namespace omentum {
namespace {

constexpr std::size_t kEntriesPacked = std::size_t{1} << 14;

using namespace mcap;  // NOLINT(google-build-using-namespace): the byte level of this format

std::uint32_t crc32_of(std::string_view bytes, std::uint32_t start = 0) {
  return static_cast<std::uint32_t>(
      crc32_z(start, reinterpret_cast<const Bytef*>(bytes.data()), bytes.size()));
}

/// The file of the type with all its imports, imports first.
void collect_files(const google::protobuf::FileDescriptor& file, std::set<std::string>& seen,
                   google::protobuf::FileDescriptorSet& set) {
  if (!seen.insert(file.name()).second) return;
  for (int k = 0; k < file.dependency_count(); ++k) collect_files(*file.dependency(k), seen, set);
  file.CopyTo(set.add_file());
}

}  // namespace

McapWriter::McapWriter(std::ostream& out, McapCompression compression, std::size_t chunk_bytes)
    : out_(out), compression_(compression), chunk_bytes_(chunk_bytes) {
  std::string header;
  put_string(header, "");
  put_string(header, "omentum");
  emit(std::string(kMagic) + make_record(kHeader, header));
}

void McapWriter::emit(const std::string& bytes) {
  OMENTUM_CHECK(!finished_, "recording is finished");
  out_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  position_ += bytes.size();
  data_crc_ = crc32_of(bytes, data_crc_);
}

McapWriter::ChannelId McapWriter::add_channel(const std::string& topic,
                                              const google::protobuf::Descriptor& type) {
  const auto [found, added] = schema_ids_.try_emplace(
      std::string(type.full_name()), static_cast<std::uint16_t>(schema_ids_.size() + 1));
  if (added) {
    google::protobuf::FileDescriptorSet files;
    std::set<std::string> seen;
    collect_files(*type.file(), seen, files);
    std::string schema;
    put(schema, found->second);
    put_string(schema, type.full_name());
    put_string(schema, "protobuf");
    put_string(schema, files.SerializeAsString());
    schema_records_.push_back(make_record(kSchema, schema));
    chunk_ += schema_records_.back();
  }
  const auto id = static_cast<ChannelId>(channel_records_.size() + 1);
  std::string channel;
  put(channel, id);
  put(channel, found->second);
  put_string(channel, topic);
  put_string(channel, "protobuf");
  put(channel, std::uint32_t{0});  // length of the metadata
  channel_records_.push_back(make_record(kChannel, channel));
  chunk_ += channel_records_.back();
  return id;
}

void McapWriter::write(ChannelId channel, std::uint64_t time_ns, std::uint32_t sequence,
                       const google::protobuf::Message& message) {
  OMENTUM_CHECK(channel >= 1 && channel <= channel_records_.size(), "channel {}", channel);
  const bool first_of_file = message_counts_.empty();
  first_time_ = first_of_file ? time_ns : std::min(first_time_, time_ns);
  last_time_ = std::max(last_time_, time_ns);
  chunk_start_ = index_.empty() ? time_ns : std::min(chunk_start_, time_ns);
  chunk_end_ = index_.empty() ? time_ns : std::max(chunk_end_, time_ns);
  put(index_[channel], time_ns);
  put(index_[channel], static_cast<std::uint64_t>(chunk_.size()));
  std::string content;
  put(content, channel);
  put(content, sequence);
  put(content, time_ns);
  put(content, time_ns);
  content.append(message.SerializeAsString());
  chunk_ += make_record(kMessage, content);
  ++message_counts_[channel];
  if (chunk_.size() >= chunk_bytes_) flush();
}

void McapWriter::flush() {
  if (chunk_.empty()) return;
  const std::string records = compress(compression_, chunk_);
  std::string content;
  put(content, chunk_start_);
  put(content, chunk_end_);
  put(content, static_cast<std::uint64_t>(chunk_.size()));
  put(content, crc32_of(chunk_));
  put_string(content, name_of(compression_));
  put(content, static_cast<std::uint64_t>(records.size()));
  content.append(records);
  const std::string record = make_record(kChunk, content);
  if (chunk_count_++ == 0) first_chunk_ = position_;
  put(chunk_entries_, chunk_start_);
  put(chunk_entries_, chunk_end_);
  put(chunk_entries_, static_cast<std::uint64_t>(record.size()));
  put(chunk_entries_, static_cast<std::uint64_t>(records.size()));
  put(chunk_entries_, static_cast<std::uint64_t>(chunk_.size()));
  put(chunk_entries_, static_cast<std::uint16_t>(index_.size()));
  emit(record);
  for (const auto& [channel, entries] : index_) {
    std::string index;
    put(index, channel);
    put_string(index, entries);
    const std::string index_record = make_record(kMessageIndex, index);
    put(chunk_entries_, channel);
    put(chunk_entries_, static_cast<std::uint32_t>(index_record.size()));
    emit(index_record);
  }
  if (chunk_entries_.size() >= kEntriesPacked) {
    packed_entries_.push_back(compress(McapCompression::kZstd, chunk_entries_));
    packed_entries_.back().shrink_to_fit();
    chunk_entries_.clear();
  }
  chunk_.clear();
  index_.clear();
  chunk_start_ = chunk_end_ = 0;
  out_.flush();
}

std::string McapWriter::summary_groups(std::string& offsets) const {
  std::string summary;
  const auto close_group = [&](Opcode opcode, std::size_t start) {
    if (summary.size() == start) return;
    std::string offset;
    put(offset, static_cast<std::uint8_t>(opcode));
    put(offset, position_ + start);
    put(offset, static_cast<std::uint64_t>(summary.size() - start));
    offsets += make_record(kSummaryOffset, offset);
  };
  std::size_t start = summary.size();
  for (const std::string& record : schema_records_) summary += record;
  close_group(kSchema, start);
  start = summary.size();
  for (const std::string& record : channel_records_) summary += record;
  close_group(kChannel, start);
  start = summary.size();
  std::string statistics;
  std::uint64_t messages = 0;
  std::string counts;
  for (const auto& [channel, count] : message_counts_) {
    messages += count;
    put(counts, channel);
    put(counts, count);
  }
  put(statistics, messages);
  put(statistics, static_cast<std::uint16_t>(schema_records_.size()));
  put(statistics, static_cast<std::uint32_t>(channel_records_.size()));
  put(statistics, std::uint32_t{0});  // attachments
  put(statistics, std::uint32_t{0});  // metadata records
  put(statistics, chunk_count_);
  put(statistics, first_time_);
  put(statistics, last_time_);
  put_string(statistics, counts);
  summary += make_record(kStatistics, statistics);
  close_group(kStatistics, start);
  start = summary.size();
  summary += chunk_indexes();
  close_group(kChunkIndex, start);
  return summary;
}

std::string McapWriter::chunk_indexes() const {
  std::string all, unpacked;
  for (const std::string& packed : packed_entries_) unpacked += uncompress_zstd(packed);
  unpacked += chunk_entries_;
  ByteCursor entries(unpacked);
  std::uint64_t position = first_chunk_;  // chunks and their message indexes follow one another
  for (std::uint32_t i = 0; i < chunk_count_; ++i) {
    const std::uint64_t chunk = position;
    std::string content;
    put(content, entries.get<std::uint64_t>());  // start and end time
    put(content, entries.get<std::uint64_t>());
    put(content, chunk);
    const auto length = entries.get<std::uint64_t>();
    put(content, length);
    position += length;
    const auto compressed = entries.get<std::uint64_t>();
    const auto uncompressed = entries.get<std::uint64_t>();
    std::string index_offsets;
    for (auto left = entries.get<std::uint16_t>(); left > 0; --left) {
      put(index_offsets, entries.get<ChannelId>());
      put(index_offsets, position);
      position += entries.get<std::uint32_t>();
    }
    put_string(content, index_offsets);
    put(content, position - chunk - length);
    put_string(content, name_of(compression_));
    put(content, compressed);
    put(content, uncompressed);
    all += make_record(kChunkIndex, content);
  }
  return all;
}

Result<void> McapWriter::finish() {
  flush();
  std::string data_end;
  put(data_end, data_crc_);
  emit(make_record(kDataEnd, data_end));
  std::string offsets;
  std::string tail = summary_groups(offsets);
  const std::uint64_t offsets_start = position_ + tail.size();
  tail += offsets;
  // The summary CRC runs from the summary through the footer up to the CRC itself.
  std::string footer;
  put(footer, position_);
  put(footer, offsets_start);
  std::string footer_head = make_record(kFooter, footer + std::string(4, '\0'));
  footer_head.resize(footer_head.size() - 4);
  tail += footer_head;
  put(tail, crc32_of(tail));
  tail += kMagic;
  emit(tail);
  out_.flush();
  finished_ = true;
  if (!out_) return Failure{"recording: the stream failed while writing"};
  return {};
}

}  // namespace omentum

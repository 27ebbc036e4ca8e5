#pragma once

#include <google/protobuf/message.h>

#include <cstddef>
#include <cstdint>
#include <istream>
#include <map>
#include <memory>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

// MCAP, the container of recordings (specification: mcap.dev/spec, version 0). What we use of it:
// protobuf channels with embedded schemas, chunks with lz4 or zstd and a CRC, message and chunk
// index, statistics. Files written here open in Foxglove, PlotJuggler and the `mcap` tools; files
// of others are read, chunk by chunk, whatever they are compressed with.

namespace omentum {

enum class McapCompression { kNone, kLz4, kZstd };

/// Writes one file, front to back, so that a killed process leaves whole chunks that any reader can
/// use. Times are nanoseconds of the log clock. Memory: one chunk, and some 100 bytes for each
/// chunk written. Not thread-safe. The stream must outlive the writer and start at byte 0.
class McapWriter {
 public:
  using ChannelId = std::uint16_t;

  /// A chunk is closed once it holds `chunk_bytes` or more: some seconds of an episode; smaller
  /// ones compress worse.
  explicit McapWriter(std::ostream& out, McapCompression compression = McapCompression::kZstd,
                      std::size_t chunk_bytes = std::size_t{1} << 18);

  /// Declares a topic with messages of one protobuf type; the schema holds the type's file and all
  /// its imports.
  ChannelId add_channel(const std::string& topic, const google::protobuf::Descriptor& type);

  /// Appends a message, which must be of the type of its channel. Aborts for a channel that
  /// add_channel() did not give. Times may come in any order.
  void write(ChannelId channel, std::uint64_t time_ns, std::uint32_t sequence,
             const google::protobuf::Message& message);

  /// Closes the open chunk and writes it to the stream; a crash later does not lose it.
  void flush();

  /// Writes the summary and the footer. Nothing may be written afterwards; a second call aborts.
  /// Fails if the stream did at any time.
  Result<void> finish();

 private:
  void emit(const std::string& bytes);
  std::string summary_groups(std::string& offsets) const;
  std::string chunk_indexes() const;

  std::ostream& out_;
  McapCompression compression_;
  std::size_t chunk_bytes_;
  std::uint64_t position_ = 0;  ///< bytes written so far
  std::uint32_t data_crc_ = 0;  ///< of the bytes before DataEnd
  /// Complete records, repeated in the summary.
  std::vector<std::string> schema_records_, channel_records_;
  std::map<std::string, std::uint16_t> schema_ids_;  ///< by type name
  std::string chunk_;                                ///< records of the open chunk
  std::map<ChannelId, std::string> index_;           ///< message index entries of the open chunk
  std::uint64_t chunk_start_ = 0, chunk_end_ = 0;
  /// What the summary tells of each chunk: the one thing that grows with the file. A recording that
  /// is flushed every second for hours has many chunks of 100 bytes here, so blocks are compressed.
  std::vector<std::string> packed_entries_;
  std::string chunk_entries_;  ///< of the last chunks
  std::uint32_t chunk_count_ = 0;
  std::uint64_t first_chunk_ = 0;  ///< its place in the file
  std::map<ChannelId, std::uint64_t> message_counts_;
  std::uint64_t first_time_ = 0, last_time_ = 0;
  bool finished_ = false;
};

struct McapSchema {
  std::string name, encoding, data;
};

struct McapChannel {
  std::string topic, encoding;
  McapSchema schema;  ///< empty without one
};

struct McapMessage {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0;  ///< [ns]
  std::string data;
};

/// Where a message lies: the chunk, or the message itself outside of chunks, and its place in it.
struct McapPlace {
  std::uint64_t record = 0;  ///< byte of the file
  std::uint64_t within = 0;  ///< byte of the unpacked chunk
};

/// A message where it lies; `data` goes with the next call of the reader.
struct McapView {
  std::uint16_t channel = 0;
  std::uint32_t sequence = 0;
  std::uint64_t log_time = 0;  ///< [ns]
  std::string_view data;
  McapPlace place;
};

/// Reads a file of any size front to back, one chunk in memory at a time, and checks every CRC
/// there is. Accepts any bytes and lists what is wrong with them: of a truncated file the whole
/// chunks are read. Memory: one chunk and what it unpacks to, at most 1 GiB each. Not thread-safe.
/// The stream, which must stand at byte 0, must outlive the reader.
class McapReader {
 public:
  /// At most `most_unpacked` bytes are read of all chunks together.
  explicit McapReader(std::istream& in, std::uint64_t most_unpacked = ~std::uint64_t{0});

  /// The next message in file order; false at the end. Its channel is in channels() by then.
  bool next(McapView& message);

  const std::map<std::uint16_t, McapChannel>& channels() const { return channels_; }
  std::size_t chunks() const { return chunks_; }
  std::size_t chunks_skipped() const { return chunks_skipped_; }
  // At the end of the file:
  bool complete() const { return complete_; }
  const std::vector<std::string>& problems() const { return problems_; }

 private:
  bool next_record(McapView& message);
  bool inner_record(McapView& message);
  bool data_record(std::uint8_t opcode, std::string_view body, McapView& message);
  void chunk();
  void data_end();
  void footer(std::string_view head);
  bool read(std::size_t size, std::string& bytes);
  bool pass_over(std::uint64_t size);
  void problem(std::uint64_t at, const std::string& text);

  std::istream& in_;
  std::uint64_t most_unpacked_, unpacked_bytes_ = 0;
  std::uint64_t at_ = 0;        ///< of the record in hand
  std::uint64_t position_ = 0;  ///< of the stream
  std::uint64_t summary_start_ = 0;
  std::uint32_t crc_ = 0;     ///< of what was read of the data section or the summary
  std::string head_, body_;   ///< of the record in hand
  std::string unpacked_;      ///< chunk in hand
  std::string_view records_;  ///< of it, what is not read yet
  std::size_t in_chunk_ = 0;  ///< bytes of records in it
  std::map<std::uint16_t, McapSchema> schemas_;
  std::map<std::uint16_t, McapChannel> channels_;
  std::vector<std::string> problems_;
  std::size_t chunks_ = 0, chunks_skipped_ = 0;
  bool begun_ = false, ended_ = false, data_ended_ = false, complete_ = false;
};

/// Fetches single messages of a file again, in any order; those of one chunk one after the other
/// cost it once. Not thread-safe.
class McapFetcher {
 public:
  /// Throws Error where the file cannot be opened.
  explicit McapFetcher(const std::string& path);
  /// Data of the message at a place that McapReader gave. Throws Error where the file has changed.
  std::string_view fetch(const McapPlace& place);

 private:
  std::string path_, body_, unpacked_;
  std::unique_ptr<std::istream> in_;
  std::uint64_t record_ = ~std::uint64_t{0};
  std::string_view records_;
};

/// Whatever could be read of a file, and what could not.
struct McapContent {
  std::map<std::uint16_t, McapChannel> channels;
  std::vector<McapMessage> messages;  ///< in file order
  std::size_t chunks = 0;             ///< read
  std::size_t chunks_skipped = 0;     ///< truncated, damaged or compressed in an unknown way
  bool complete = false;              ///< DataEnd, footer and closing magic are there
  std::vector<std::string> problems;  ///< one line each, with the byte offset

  /// Messages of one topic, in file order.
  std::vector<const McapMessage*> of_topic(std::string_view topic) const;
};

/// What McapReader gives of a small file, all at once. Memory is bounded by 1 GiB of decompressed
/// chunks.
McapContent read_mcap(std::string_view bytes);

}  // namespace omentum

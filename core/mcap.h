#pragma once

#include <google/protobuf/message.h>

#include <cstddef>
#include <cstdint>
#include <map>
#include <ostream>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

// MCAP, the container of recordings (specification: mcap.dev/spec, version 0). What we use of it:
// protobuf channels with embedded schemas, chunks with zstd and a CRC, message and chunk index,
// statistics. Files written here open in Foxglove, PlotJuggler and the `mcap` tools; files of
// others are read as far as they use no lz4.

namespace omentum {

enum class McapCompression { kNone, kZstd };

/// Writes one file, front to back, so that a killed process leaves whole chunks that any reader can
/// use. Times are nanoseconds of the log clock. Not thread-safe. The stream must outlive the writer
/// and start at byte 0.
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

  void write(ChannelId channel, std::uint64_t time_ns, std::uint32_t sequence,
             const google::protobuf::Message& message);

  /// Closes the open chunk and writes it to the stream; a crash later does not lose it.
  void flush();

  /// Writes the summary and the footer. Nothing may be written afterwards. Fails if the stream did
  /// at any time.
  Result<void> finish();

 private:
  struct ChunkEntry {
    std::uint64_t start_time = 0, end_time = 0, offset = 0, length = 0;
    std::map<ChannelId, std::uint64_t> index_offsets;
    std::uint64_t index_length = 0, compressed = 0, uncompressed = 0;
  };

  void emit(const std::string& bytes);
  std::string summary_groups(std::string& offsets) const;

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
  std::vector<ChunkEntry> chunks_;
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

/// Whatever could be read of a file, and what could not.
struct McapContent {
  std::map<std::uint16_t, McapChannel> channels;
  std::vector<McapMessage> messages;  ///< in file order
  std::size_t chunks = 0;             ///< read
  std::size_t chunks_skipped = 0;     ///< truncated, damaged or in an unknown compression
  bool complete = false;              ///< DataEnd, footer and closing magic are there
  std::vector<std::string> problems;  ///< one line each, with the byte offset

  /// Messages of one topic, in file order.
  std::vector<const McapMessage*> of_topic(std::string_view topic) const;
};

/// Reads the data section front to back and checks every CRC there is. Accepts any bytes and lists
/// what is wrong with them; a truncated last chunk is reported, counted and skipped. Memory is
/// bounded by 1 GiB of decompressed chunks.
McapContent read_mcap(std::string_view bytes);

}  // namespace omentum

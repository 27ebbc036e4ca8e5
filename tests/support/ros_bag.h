#pragma once

#include <algorithm>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <string>
#include <vector>

#include "core/mcap_chunk.h"
#include "core/mcap_format.h"

namespace omentum::test {

/// Bytes of a ROS message, field after field: packed as ROS 1 has it, or aligned as `cdr` with its
/// header, in either byte order.
class RosBytes {
 public:
  enum Form { kPacked, kLittle, kBig };
  explicit RosBytes(Form form = kPacked) : form_(form) {
    if (form != kPacked) bytes_ = std::string("\0\0\0\0", 4);
    if (form == kLittle) bytes_[1] = 1;
  }

  template <typename T>
  RosBytes& put(T value) {
    align(sizeof(T));
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    if (form_ == kBig) std::reverse(raw, raw + sizeof(T));
    bytes_.append(raw, sizeof(T));
    return *this;
  }
  RosBytes& text(const std::string& text) {
    const bool packed = form_ == kPacked;
    put(static_cast<std::uint32_t>(text.size() + (packed ? 0 : 1)));
    bytes_ += text;
    if (!packed) bytes_.push_back('\0');
    return *this;
  }
  template <typename T>
  RosBytes& open(const std::vector<T>& values) {
    put(static_cast<std::uint32_t>(values.size()));
    return fixed(values);
  }
  template <typename T>
  RosBytes& fixed(const std::vector<T>& values) {
    for (const T value : values) put(value);
    return *this;
  }
  RosBytes& texts(const std::vector<std::string>& values) {
    put(static_cast<std::uint32_t>(values.size()));
    for (const std::string& value : values) text(value);
    return *this;
  }
  /// An array of bytes.
  RosBytes& blob(const std::string& data) {
    put(static_cast<std::uint32_t>(data.size()));
    bytes_ += data;
    return *this;
  }
  /// std_msgs/Header; in ROS 1 it begins with a number.
  RosBytes& header(std::int64_t time_ns, const std::string& frame) {
    if (form_ == kPacked) put(std::uint32_t{7});
    put(static_cast<std::uint32_t>(time_ns / 1'000'000'000));
    put(static_cast<std::uint32_t>(time_ns % 1'000'000'000));
    return text(frame);
  }
  const std::string& bytes() const { return bytes_; }
  Form form() const { return form_; }

 private:
  void align(std::size_t size) {
    if (form_ == kPacked) return;
    while ((bytes_.size() - 4) % size != 0) bytes_.push_back('\0');
  }
  Form form_;
  std::string bytes_;
};

/// A bag in MCAP, written by hand: channels of any encoding, whole in memory.
class BagFile {
 public:
  explicit BagFile(bool ros1) : ros1_(ros1) {}

  /// Definitions of the type, as a bag has them; of another encoding where it is given.
  std::uint16_t topic(const std::string& name, const std::string& type,
                      const std::string& definition, std::string encoding = "") {
    const bool other = !encoding.empty();
    if (!other) encoding = ros1_ ? "ros1" : "cdr";
    const auto id = static_cast<std::uint16_t>(++channels_);
    std::string schema, channel;
    mcap::put(schema, id);
    mcap::put_string(schema, type);
    mcap::put_string(schema, other ? encoding : ros1_ ? "ros1msg" : "ros2msg");
    mcap::put_string(schema, definition);
    mcap::put(channel, id);
    mcap::put(channel, id);
    mcap::put_string(channel, name);
    mcap::put_string(channel, encoding);
    mcap::put(channel, std::uint32_t{0});
    records_ +=
        mcap::make_record(mcap::kSchema, schema) + mcap::make_record(mcap::kChannel, channel);
    return id;
  }

  void message(std::uint16_t channel, std::int64_t log_time_ns, const std::string& bytes) {
    std::string content;
    mcap::put(content, channel);
    mcap::put(content, std::uint32_t{0});
    mcap::put(content, static_cast<std::uint64_t>(log_time_ns));
    mcap::put(content, static_cast<std::uint64_t>(log_time_ns));
    records_ += mcap::make_record(mcap::kMessage, content + bytes);
  }

  /// As one chunk.
  std::string bytes(McapCompression compression = McapCompression::kNone) const {
    std::string header, chunk, end, footer;
    mcap::put_string(header, ros1_ ? "ros1" : "ros2");
    mcap::put_string(header, "");
    mcap::put(chunk, std::uint64_t{0});
    mcap::put(chunk, std::uint64_t{0});
    mcap::put(chunk, static_cast<std::uint64_t>(records_.size()));
    mcap::put(chunk, std::uint32_t{0});  // CRC: not given
    mcap::put_string(chunk, mcap::name_of(compression));
    const std::string packed = mcap::compress(compression, records_);
    mcap::put(chunk, static_cast<std::uint64_t>(packed.size()));
    mcap::put(end, std::uint32_t{0});
    footer.assign(20, '\0');
    return std::string(mcap::kMagic) + mcap::make_record(mcap::kHeader, header) +
           mcap::make_record(mcap::kChunk, chunk + packed) +
           mcap::make_record(mcap::kDataEnd, end) + mcap::make_record(mcap::kFooter, footer) +
           std::string(mcap::kMagic);
  }
  void save(const std::string& path, McapCompression compression = McapCompression::kNone) const {
    std::ofstream(path, std::ios::binary) << bytes(compression);
  }

 private:
  bool ros1_;
  int channels_ = 0;
  std::string records_;
};

}  // namespace omentum::test

#include "mismatch/ros/message.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/check.h"
#include "mismatch/import/read_number.h"

namespace omentum {
namespace {

constexpr std::size_t kMostParts = 1'000'000;
/// Some writers fill the last word of `cdr`, some round to 8.
constexpr std::size_t kMostFill = 7;

double read_number(RosNumber type, const char* bytes, bool swapped) {
  switch (type) {
    case RosNumber::kBool:
    case RosNumber::kUint8:
      return read_as<std::uint8_t>(bytes, swapped);
    case RosNumber::kInt8:
      return read_as<std::int8_t>(bytes, swapped);
    case RosNumber::kInt16:
      return read_as<std::int16_t>(bytes, swapped);
    case RosNumber::kUint16:
      return read_as<std::uint16_t>(bytes, swapped);
    case RosNumber::kInt32:
      return read_as<std::int32_t>(bytes, swapped);
    case RosNumber::kUint32:
      return read_as<std::uint32_t>(bytes, swapped);
    case RosNumber::kInt64:
      return read_as<std::int64_t>(bytes, swapped);
    case RosNumber::kUint64:
      return read_as<std::uint64_t>(bytes, swapped);
    case RosNumber::kFloat32:
      return read_as<float>(bytes, swapped);
    default:
      return read_as<double>(bytes, swapped);
  }
}

class Decoder {
 public:
  Decoder(const RosSchema& schema, RosEncoding encoding, std::string_view bytes)
      : schema_(schema), cdr_(encoding == RosEncoding::kCdr), bytes_(bytes) {}

  Result<RosValue> decode() {
    if (cdr_ && !encapsulation()) return Failure{error_};
    RosValue value;
    if (!message(0, value)) return Failure{error_};
    const std::size_t left = bytes_.size() - at_;
    if (left > (cdr_ ? kMostFill : 0))
      return Failure{fmt::format("{} bytes behind the end of a {}: another definition?", left,
                                 schema_.types[0].name)};
    return value;
  }

 private:
  bool fail(const std::string& what) {
    error_ = what;
    return false;
  }

  /// The header of four bytes: CDR (0, 1) or plain CDR2 (6, 7), even is big-endian.
  bool encapsulation() {
    constexpr std::size_t kHeader = 4;
    if (bytes_.size() < kHeader) return fail("shorter than the header of cdr");
    const int id = static_cast<unsigned char>(bytes_[1]);
    if (bytes_[0] != 0 || (id != 0 && id != 1 && id != 6 && id != 7))
      return fail(fmt::format("cdr of kind {}, allowed 0, 1, 6, 7", id));
    swapped_ = id % 2 == 0;
    most_alignment_ = id >= 6 ? 4 : 8;
    at_ = origin_ = kHeader;
    return true;
  }

  bool need(std::size_t bytes, const RosField& field) {
    if (bytes <= bytes_.size() - at_) return true;
    return fail(fmt::format("ends inside {}", field.name));
  }

  bool align(std::size_t size, const RosField& field) {
    if (!cdr_) return true;
    const std::size_t to = std::min(size, most_alignment_);
    const std::size_t past = (at_ - origin_) % to;
    if (past == 0) return true;
    if (!need(to - past, field)) return false;
    at_ += to - past;
    return true;
  }

  bool length(std::size_t& size, const RosField& field) {
    if (!align(4, field) || !need(4, field)) return false;
    size = static_cast<std::size_t>(read_number(RosNumber::kUint32, bytes_.data() + at_, swapped_));
    at_ += 4;
    return true;
  }

  bool text(RosValue& value, const RosField& field) {
    value.kind = RosValue::kText;
    std::size_t size = 0;
    if (!length(size, field) || !need(size, field)) return false;
    value.bytes = bytes_.substr(at_, size);
    at_ += size;
    // The terminating zero counts in cdr.
    if (cdr_ && value.bytes.ends_with('\0')) value.bytes.remove_suffix(1);
    return true;
  }

  bool one(const RosField& field, RosValue& value) {
    if (++parts_ > kMostParts) return fail("more than a million parts");
    if (field.kind == RosField::kMessage) return message(field.type, value);
    if (field.kind == RosField::kText) return text(value, field);
    const std::size_t size = bytes_of(field.number);
    if (!align(size, field) || !need(size, field)) return false;
    value.type = field.number;
    value.number = read_number(field.number, bytes_.data() + at_, swapped_);
    at_ += size;
    return true;
  }

  bool many(const RosField& field, RosValue& value) {
    if (++parts_ > kMostParts) return fail("more than a million parts");
    std::size_t count = field.count;
    if (field.shape == RosField::kOpen && !length(count, field)) return false;
    if (field.kind == RosField::kNumber) {
      const std::size_t size = bytes_of(field.number);
      value.kind = RosValue::kNumbers;
      value.type = field.number;
      value.swapped = swapped_;
      if (count == 0) return true;  // nothing is aligned that is not there
      if (!align(size, field) || !need(count * size, field)) return false;
      value.bytes = bytes_.substr(at_, count * size);
      at_ += count * size;
      return true;
    }
    value.kind = RosValue::kList;
    const std::size_t least =
        field.kind == RosField::kText ? 4 : schema_.types[field.type].least_bytes;
    if (count > 0 && (count > bytes_.size() || !need(count * least, field)))
      return fail(fmt::format("ends inside {}", field.name));
    for (std::size_t k = 0; k < count; ++k) {
      if (!one(field, value.items.emplace_back())) return false;
    }
    return true;
  }

  bool message(std::size_t type, RosValue& value) {
    value.kind = RosValue::kMessage;
    value.message = &schema_.types[type];
    value.items.resize(value.message->fields.size());
    for (std::size_t k = 0; k < value.items.size(); ++k) {
      const RosField& field = value.message->fields[k];
      if (!(field.shape == RosField::kOne ? one(field, value.items[k])
                                          : many(field, value.items[k])))
        return false;
    }
    return true;
  }

  const RosSchema& schema_;
  bool cdr_;
  bool swapped_ = false;
  std::string_view bytes_;
  std::size_t at_ = 0, origin_ = 0, most_alignment_ = 8, parts_ = 0;
  std::string error_;
};

}  // namespace

double RosValue::at(std::size_t k) const {
  OMENTUM_CHECK(kind == kNumbers && k < size(), "{} of {}", k, size());
  return read_number(type, bytes.data() + k * bytes_of(type), swapped);
}

const RosValue* RosValue::find(std::string_view name) const {
  if (kind != kMessage) return nullptr;
  for (std::size_t k = 0; k < items.size(); ++k) {
    if (message->fields[k].name == name) return &items[k];
  }
  return nullptr;
}

const RosValue& RosValue::get(std::string_view path) const {
  const RosValue* value = this;
  for (std::string_view rest = path; value != nullptr;) {
    const std::size_t end = std::min(rest.find('.'), rest.size());
    value = value->find(rest.substr(0, end));
    if (end == rest.size()) break;
    rest.remove_prefix(end + 1);
  }
  if (value == nullptr)
    throw_error("{} has no {}", message == nullptr ? "a part" : message->name, path);
  return *value;
}

double RosValue::number_at(std::string_view path) const {
  const RosValue& value = get(path);
  if (value.kind != kNumber) throw_error("{} of {} is no number", path, message->name);
  return value.number;
}

std::string_view RosValue::text_at(std::string_view path) const {
  const RosValue& value = get(path);
  if (value.kind != kText) throw_error("{} of {} is no string", path, message->name);
  return value.bytes;
}

const RosValue& RosValue::numbers_at(std::string_view path) const {
  const RosValue& value = get(path);
  if (value.kind != kNumbers) throw_error("{} of {} is no array of numbers", path, message->name);
  return value;
}

Result<RosValue> decode_ros_message(const RosSchema& schema, RosEncoding encoding,
                                    std::string_view bytes) {
  return Decoder(schema, encoding, bytes).decode();
}

}  // namespace omentum

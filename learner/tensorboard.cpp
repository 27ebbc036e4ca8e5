#include "learner/tensorboard.h"

#include <fmt/core.h>
#include <unistd.h>

#include <array>
#include <cmath>
#include <cstring>

#include "core/check.h"
#include "core/clock.h"
#include "core/hash.h"

namespace omentum {

namespace {

/// Record checksums are stored rotated and shifted, so that a CRC of data that holds CRCs stays
/// useful.
std::uint32_t masked_crc(std::span<const std::byte> bytes) {
  const std::uint32_t crc = crc32c(bytes);
  return ((crc >> 15) | (crc << 17)) + 0xa282ead8u;
}

double seconds_since_epoch() { return 1e-9 * static_cast<double>(wall_now_ns()); }

std::string host_name() {
  std::array<char, 256> name{};
  if (::gethostname(name.data(), name.size() - 1) != 0 || name[0] == '\0') return "localhost";
  return name.data();
}

std::string record_of(const pb::TensorboardEvent& event) {
  const std::string payload = event.SerializeAsString();
  const std::uint64_t length = payload.size();
  const std::uint32_t length_crc = masked_crc(std::as_bytes(std::span(&length, 1)));
  const std::uint32_t payload_crc = masked_crc(std::as_bytes(std::span(payload)));
  std::string record(16 + payload.size(), '\0');
  std::memcpy(record.data(), &length, 8);
  std::memcpy(record.data() + 8, &length_crc, 4);
  std::memcpy(record.data() + 12, payload.data(), payload.size());
  std::memcpy(record.data() + 12 + payload.size(), &payload_crc, 4);
  return record;
}

}  // namespace

TensorboardWriter::TensorboardWriter(const std::string& folder) {
  const double now = seconds_since_epoch();
  path_ = fmt::format("{}/events.out.tfevents.{}.{}", folder, static_cast<std::int64_t>(now),
                      host_name());
  pb::TensorboardEvent first;
  first.set_wall_time(now);
  first.set_file_version("brain.Event:2");
  file_.emplace(path_, record_of(first));
}

Result<void> TensorboardWriter::write(std::int64_t step, std::span<const Scalar> scalars) {
  pb::TensorboardEvent event;
  event.set_wall_time(seconds_since_epoch());
  event.set_step(step);
  for (const auto& [tag, value] : scalars) {
    if (!std::isfinite(value)) continue;
    pb::TensorboardValue& entry = *event.mutable_summary()->add_value();
    entry.set_tag(tag);
    entry.set_simple_value(static_cast<float>(value));
  }
  return file_->append(record_of(event));
}

std::vector<pb::TensorboardEvent> parse_tensorboard(std::span<const std::byte> bytes) {
  constexpr std::size_t kHead = 12, kTail = 4;
  std::vector<pb::TensorboardEvent> events;
  while (bytes.size() >= kHead + kTail) {
    std::uint64_t length = 0;
    std::uint32_t length_crc = 0, payload_crc = 0;
    std::memcpy(&length, bytes.data(), 8);
    std::memcpy(&length_crc, bytes.data() + 8, 4);
    if (length_crc != masked_crc(bytes.first(8)) || length > bytes.size() - kHead - kTail) break;
    const auto payload = bytes.subspan(kHead, length);
    std::memcpy(&payload_crc, bytes.data() + kHead + length, 4);
    pb::TensorboardEvent event;
    if (payload_crc != masked_crc(payload)) break;
    if (!event.ParseFromArray(payload.data(), static_cast<int>(length))) break;
    events.push_back(std::move(event));
    bytes = bytes.subspan(kHead + length + kTail);
  }
  return events;
}

}  // namespace omentum

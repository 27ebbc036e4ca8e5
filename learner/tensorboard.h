#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/durable_file.h"
#include "core/result.h"
#include "proto/tensorboard_event.pb.h"

namespace omentum {

using Scalar = std::pair<std::string, double>;  ///< tag, value

/// One TensorBoard event file, <folder>/events.out.tfevents.<seconds>.<host>. Record = u64 length,
/// masked CRC-32C of the length, payload, masked CRC-32C of the payload, little-endian. A truncated
/// tail is legal. Not thread-safe.
class TensorboardWriter {
 public:
  /// Throws Error when the file cannot be created.
  explicit TensorboardWriter(const std::string& folder);

  /// One event with all scalars that are finite, flushed. A failed write (full disk) is returned,
  /// not thrown.
  Result<void> write(std::int64_t step, std::span<const Scalar> scalars);

  const std::string& path() const { return path_; }

 private:
  std::string path_;
  std::optional<AppendFile> file_;
};

/// Events of a file up to the first record that is cut off or damaged; total over arbitrary bytes.
std::vector<pb::TensorboardEvent> parse_tensorboard(std::span<const std::byte> bytes);

}  // namespace omentum

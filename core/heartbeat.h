#pragma once

#include <cstdint>
#include <string>

namespace omentum {

/// A file whose time of change says that a program's main loop runs, for the health check of a
/// container (docker/health.sh).
class Heartbeat {
 public:
  /// An empty path: no file.
  explicit Heartbeat(std::string path) : path_(std::move(path)) {}
  /// Touches the file, at most once a second. A path that cannot be written is told once.
  void beat(std::int64_t now_ns);

 private:
  std::string path_;
  std::int64_t beaten_ns_ = 0;
  bool told_ = false;
};

}  // namespace omentum

#pragma once

#include <termios.h>

#include <optional>

namespace omentum {

/// Single keys of a terminal, without Enter; whole lines where standard input is none. The terminal
/// is as it was when this object goes.
class OperatorKeys {
 public:
  OperatorKeys();
  ~OperatorKeys();
  OperatorKeys(const OperatorKeys&) = delete;
  OperatorKeys& operator=(const OperatorKeys&) = delete;

  /// The next key, waiting up to `timeout_ms`; nothing where none came or input has ended.
  std::optional<char> next(int timeout_ms);

 private:
  std::optional<termios> before_;
  bool open_ = true;
};

}  // namespace omentum

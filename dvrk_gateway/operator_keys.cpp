#include "dvrk_gateway/operator_keys.h"

#include <poll.h>
#include <unistd.h>

#include <chrono>
#include <thread>

namespace omentum {

OperatorKeys::OperatorKeys() {
  termios terminal{};
  if (tcgetattr(STDIN_FILENO, &terminal) != 0) return;
  before_ = terminal;
  terminal.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  tcsetattr(STDIN_FILENO, TCSANOW, &terminal);
}

OperatorKeys::~OperatorKeys() {
  if (before_) tcsetattr(STDIN_FILENO, TCSANOW, &*before_);
}

std::optional<char> OperatorKeys::next(int timeout_ms) {
  if (!open_) {
    std::this_thread::sleep_for(std::chrono::milliseconds(timeout_ms));
    return std::nullopt;
  }
  pollfd input{STDIN_FILENO, POLLIN, 0};
  if (poll(&input, 1, timeout_ms) <= 0) return std::nullopt;
  char key = 0;
  if (read(STDIN_FILENO, &key, 1) == 1) return key;
  open_ = false;  // ended: signals still arm and stop
  return std::nullopt;
}

}  // namespace omentum

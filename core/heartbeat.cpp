#include "core/heartbeat.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <utility>

#include "core/log.h"

namespace omentum {

void Heartbeat::beat(std::int64_t now_ns) {
  constexpr std::int64_t kPeriodNs = 1'000'000'000;
  if (path_.empty() || (beaten_ns_ > 0 && now_ns - beaten_ns_ < kPeriodNs)) return;
  beaten_ns_ = now_ns;
  const int fd = open(path_.c_str(), O_CREAT | O_WRONLY | O_NONBLOCK | O_CLOEXEC, 0644);
  const bool touched = fd >= 0 && futimens(fd, nullptr) == 0;
  if (fd >= 0) close(fd);
  if (!touched && !std::exchange(told_, true))
    log().warn("event=no_heartbeat file={} cannot be written", path_);
}

}  // namespace omentum

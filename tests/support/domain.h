#pragma once

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/file.h>
#include <unistd.h>

#include <cstdint>
#include <string>

#include "core/dds_options.h"

namespace omentum::test {

/// A DDS domain for one test alone: tests run in parallel on one host and must not see each other.
/// The number starts at the process id and is held by a file lock until the object goes; processes
/// the test starts get it as a number.
class PrivateDomain {
 public:
  PrivateDomain() {
    const std::uint32_t first = static_cast<std::uint32_t>(getpid()) % kDomains;
    for (std::uint32_t i = 0; i < kDomains && fd_ < 0; ++i) {
      id_ = 1 + (first + i) % kDomains;
      const std::string path = "/tmp/omentum_test_domain_" + std::to_string(id_);
      const int fd = open(path.c_str(), O_CREAT | O_RDWR | O_CLOEXEC, 0666);
      if (fd < 0) continue;
      if (flock(fd, LOCK_EX | LOCK_NB) == 0) {
        fd_ = fd;
      } else {
        close(fd);
      }
    }
    EXPECT_GE(fd_, 0) << "every test domain is taken";
  }
  ~PrivateDomain() {
    if (fd_ >= 0) close(fd_);
  }
  PrivateDomain(const PrivateDomain&) = delete;
  PrivateDomain& operator=(const PrivateDomain&) = delete;

  std::uint32_t id() const { return id_; }

 private:
  static constexpr std::uint32_t kDomains = 90;  // ports 7650 to 30 000: below the ephemeral ones
  std::uint32_t id_ = 0;
  int fd_ = -1;
};

/// Loopback, whatever the environment says.
inline DdsProfile loopback_profile() {
  DdsProfile profile;
  profile.name = "loopback";
  profile.uri = dds_config_xml({});
  profile.receive_buffer_bytes = probe_receive_buffer(kReceiveBufferBytes);
  return profile;
}

}  // namespace omentum::test

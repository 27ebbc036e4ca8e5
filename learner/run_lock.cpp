#include "learner/run_lock.h"

#include <fcntl.h>
#include <fmt/core.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <filesystem>
#include <system_error>

#include "core/check.h"

namespace omentum {
namespace {

std::string owner_of(int fd) {
  std::array<char, 300> text{};
  const ssize_t size = ::pread(fd, text.data(), text.size(), 0);
  std::string owner(text.data(), size > 0 ? static_cast<std::size_t>(size) : 0);
  owner.resize(std::min(owner.find('\n'), owner.size()));
  const std::size_t space = owner.find(' ');
  if (space == std::string::npos) return "another process";
  return fmt::format("host {}, pid {}", owner.substr(0, space), owner.substr(space + 1));
}

[[noreturn]] void throw_not_writable(const std::string& path, const std::string& reason) {
  throw_error(
      "{}: {}: let user {}, group {} write there, or name another folder: --set "
      "run.runs_dir=FOLDER",
      path, reason, ::geteuid(), ::getegid());
}

}  // namespace

RunLock::RunLock(const std::string& run_dir) {
  namespace fs = std::filesystem;
  fs::path folder = fs::absolute(run_dir).lexically_normal();
  if (folder.filename().empty()) folder = folder.parent_path();  // "runs/x/"
  std::error_code error;
  fs::create_directories(folder.parent_path(), error);
  if (error) throw_not_writable(folder.parent_path().string(), error.message());
  const std::string path =
      fmt::format("{}/.{}.lock", folder.parent_path().string(), folder.filename().string());
  fd_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (fd_ < 0) throw_not_writable(path, std::generic_category().message(errno));
  if (::flock(fd_, LOCK_EX | LOCK_NB) != 0) {
    const std::string owner = owner_of(fd_);
    ::close(fd_);
    throw_error("{}: in use by the learner of {}", run_dir, owner);
  }
  std::array<char, 256> host{};
  ::gethostname(host.data(), host.size() - 1);
  const std::string owner = fmt::format("{} {}\n", host.data(), ::getpid());
  // Only the message to others depends on it: a full disk does not refuse the run.
  if (::ftruncate(fd_, 0) != 0 || ::pwrite(fd_, owner.data(), owner.size(), 0) < 0) return;
}

RunLock::~RunLock() { ::close(fd_); }

}  // namespace omentum

#include "learner/durable_file.h"

#include <fcntl.h>
#include <fmt/core.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <utility>

namespace omentum {

namespace {

/// Closes on scope exit.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  int get() const { return fd_; }
  /// Reports the result of close, which may be the first to see a full disk.
  bool close() { return ::close(std::exchange(fd_, -1)) == 0; }

 private:
  int fd_ = -1;
};

Failure failed(const char* what, const std::string& path) {
  return Failure{fmt::format("{} {}: {}", what, path, std::generic_category().message(errno))};
}

bool write_all(int fd, std::span<const std::byte> bytes) {
  while (!bytes.empty()) {
    const ssize_t written = ::write(fd, bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written <= 0) return false;
    bytes = bytes.subspan(static_cast<std::size_t>(written));
  }
  return true;
}

Result<void> write_temporary(const std::string& path, std::span<const std::byte> bytes) {
  Descriptor file(::open(path.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (file.get() < 0) return failed("cannot create", path);
  if (!write_all(file.get(), bytes)) return failed("cannot write", path);
  if (::fsync(file.get()) != 0) return failed("cannot fsync", path);
  if (!file.close()) return failed("cannot close", path);
  return {};
}

}  // namespace

Result<void> write_durably(const std::string& path, std::span<const std::byte> bytes) {
  const std::string temporary = path + ".tmp";
  if (Result<void> result = write_temporary(temporary, bytes); !result) {
    ::unlink(temporary.c_str());
    return result;
  }
  if (::rename(temporary.c_str(), path.c_str()) != 0) {
    const Failure failure = failed("cannot rename to", path);
    ::unlink(temporary.c_str());
    return failure;
  }
  const std::filesystem::path parent = std::filesystem::path(path).parent_path();
  const std::string folder = parent.empty() ? "." : parent.string();
  const Descriptor directory(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (directory.get() < 0 || ::fsync(directory.get()) != 0)
    return failed("cannot fsync folder", folder);
  return {};
}

Result<Bytes> read_whole(const std::string& path) {
  if (std::filesystem::exists(path) && !std::filesystem::is_regular_file(path))
    return Failure{fmt::format("{} is not a file", path)};
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return failed("cannot open", path);
  Bytes bytes(static_cast<std::size_t>(file.tellg()));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(file.gcount()));
  return bytes;
}

AppendFile::AppendFile(const std::string& path)
    : path_(path), file_(std::fopen(path.c_str(), "ab")) {
  if (file_ == nullptr) throw_error("cannot open {}", path);
}

Result<void> AppendFile::append(std::string_view bytes) {
  const bool good = std::fwrite(bytes.data(), 1, bytes.size(), file_.get()) == bytes.size() &&
                    std::fflush(file_.get()) == 0;
  return good ? Result<void>() : Result<void>(Failure{fmt::format("cannot write {}", path_)});
}

}  // namespace omentum

#include "core/durable_file.h"

#include <fcntl.h>
#include <fmt/core.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>
#include <filesystem>
#include <fstream>
#include <utility>

#include "core/regular_file.h"

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

/// Into what is there already: a device, a pipe.
Result<void> write_into(const std::string& path, std::span<const std::byte> bytes) {
  Descriptor file(::open(path.c_str(), O_WRONLY | O_CLOEXEC));
  if (file.get() < 0) return failed("cannot open", path);
  if (!write_all(file.get(), bytes)) return failed("cannot write", path);
  if (!file.close()) return failed("cannot close", path);
  return {};
}

}  // namespace

Result<void> write_durably(const std::string& path, std::span<const std::byte> bytes) {
  std::error_code unknown;  // then there is nothing, or it shows below
  if (std::filesystem::is_other(std::filesystem::status(path, unknown)))
    return write_into(path, bytes);
  const std::string temporary = path + ".tmp";
  const std::filesystem::path parent = std::filesystem::path(path).parent_path();
  std::error_code ignored;  // shows as the failed write below
  if (!parent.empty()) std::filesystem::create_directories(parent, ignored);
  if (Result<void> result = write_temporary(temporary, bytes); !result) {
    ::unlink(temporary.c_str());
    return result;
  }
  if (::rename(temporary.c_str(), path.c_str()) != 0) {
    const Failure failure = failed("cannot rename to", path);
    ::unlink(temporary.c_str());
    return failure;
  }
  const std::string folder = parent.empty() ? "." : parent.string();
  const Descriptor directory(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (directory.get() < 0 || ::fsync(directory.get()) != 0)
    return failed("cannot fsync folder", folder);
  return {};
}

Result<void> write_durably(const std::string& path, std::string_view text) {
  return write_durably(path, std::as_bytes(std::span(text)));
}

Result<Bytes> read_whole(const std::string& path) {
  if (const Result<void> regular = require_regular_file(path);
      !regular && std::filesystem::exists(path))
    return Failure{regular.error()};
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) return failed("cannot open", path);
  Bytes bytes(static_cast<std::size_t>(file.tellg()));
  file.seekg(0);
  file.read(reinterpret_cast<char*>(bytes.data()), static_cast<std::streamsize>(bytes.size()));
  bytes.resize(static_cast<std::size_t>(file.gcount()));
  return bytes;
}

AppendFile::AppendFile(std::string path, std::string header)
    : path_(std::move(path)), header_(std::move(header)) {
  if (const Result<void> opened = open(); !opened) throw_error("{}", opened.error());
}

AppendFile::~AppendFile() {
  if (fd_ >= 0) ::close(fd_);
}

Result<void> AppendFile::open() {
  const std::filesystem::path parent = std::filesystem::path(path_).parent_path();
  std::error_code ignored;  // shows as the failed open below
  if (!parent.empty()) std::filesystem::create_directories(parent, ignored);
  if (fd_ >= 0) ::close(fd_);
  fd_ = ::open(path_.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (fd_ < 0) return failed("cannot open", path_);
  return ::lseek(fd_, 0, SEEK_END) == 0 ? write(header_) : Result<void>();
}

Result<void> AppendFile::write(std::string_view bytes) {
  const off_t size = ::lseek(fd_, 0, SEEK_END);
  if (write_all(fd_, std::as_bytes(std::span(bytes)))) return {};
  const Failure failure = failed("cannot write", path_);
  if (::ftruncate(fd_, size) != 0) return failed("cannot cut back", path_);
  return failure;
}

Result<void> AppendFile::append(std::string_view bytes) {
  struct stat own {};
  struct stat present {};
  const bool same = ::fstat(fd_, &own) == 0 && ::stat(path_.c_str(), &present) == 0 &&
                    own.st_ino == present.st_ino && own.st_dev == present.st_dev;
  if (!same) {
    if (Result<void> opened = open(); !opened) return opened;
  }
  return write(bytes);
}

}  // namespace omentum

#include "sim_worker/playback/npz.h"

#include <fmt/format.h>
#include <zip.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <limits>

#include "core/check.h"

namespace omentum {

std::string npy_header(const std::string& dtype, const std::vector<std::size_t>& shape) {
  std::string sizes;
  for (const std::size_t n : shape) sizes += fmt::format("{},", n);
  std::string text =
      fmt::format("{{'descr': '{}', 'fortran_order': False, 'shape': ({}), }}", dtype, sizes);
  constexpr std::size_t kBefore = 10;  // magic, version, length
  text.append((64 - (kBefore + text.size() + 1) % 64) % 64, ' ');
  text += '\n';
  OMENTUM_CHECK(text.size() < 65536, "npy header of {} bytes", text.size());
  std::string header = "\x93NUMPY\x01";
  header += '\0';
  header += static_cast<char>(text.size() & 0xff);
  header += static_cast<char>(text.size() >> 8);
  return header + text;
}

NpyFile::NpyFile(std::string path, const std::vector<std::size_t>& shape)
    : path_(std::move(path)), file_(std::fopen(path_.c_str(), "wb")) {
  require(file_ != nullptr);
  const std::string header = npy_header("<f4", shape);
  header_ = header.size();
  require(std::fwrite(header.data(), 1, header.size(), file_.get()) == header.size());
  std::size_t left = 1;
  for (const std::size_t n : shape) left *= n;
  const std::vector<float> block(1 << 16, std::numeric_limits<float>::quiet_NaN());
  for (; left > 0; left -= std::min(left, block.size())) {
    const std::size_t count = std::min(left, block.size());
    require(std::fwrite(block.data(), sizeof(float), count, file_.get()) == count);
  }
}

void NpyFile::write(std::size_t first, const std::vector<float>& values) {
  require(fseeko(file_.get(), static_cast<off_t>(header_ + first * sizeof(float)), SEEK_SET) == 0);
  require(std::fwrite(values.data(), sizeof(float), values.size(), file_.get()) == values.size());
}

void NpyFile::close() {
  require(std::fflush(file_.get()) == 0);
  file_.reset();
}

void NpyFile::require(bool done) const {
  if (!done) throw_error("{}: cannot be written: {}", path_, std::strerror(errno));
}

void NpzFile::add(const std::string& name, const std::vector<std::string>& values) {
  std::size_t width = 1;
  for (const std::string& value : values) width = std::max(width, value.size());
  std::string content = npy_header(fmt::format("<U{}", width), {values.size()});
  for (const std::string& value : values) {
    for (std::size_t k = 0; k < width; ++k) {  // ASCII as UTF-32
      content += k < value.size() ? value[k] : '\0';
      content.append(3, '\0');
    }
  }
  entries_.push_back({name, std::move(content), ""});
}

void NpzFile::add(const std::string& name, const std::vector<std::size_t>& shape,
                  const std::vector<double>& values) {
  std::string content = npy_header("<f8", shape);
  content.append(reinterpret_cast<const char*>(values.data()), values.size() * sizeof(double));
  entries_.push_back({name, std::move(content), ""});
}

void NpzFile::add_file(const std::string& name, const std::string& path) {
  entries_.push_back({name, "", path});
}

void NpzFile::write(const std::string& path) const {
  int code = 0;
  zip_t* archive = zip_open(path.c_str(), ZIP_CREATE | ZIP_EXCL, &code);
  if (archive == nullptr) throw_error("{}: cannot be written: zip error {}", path, code);
  const auto fail = [&](const char* what) {
    const std::string reason = zip_strerror(archive);
    zip_discard(archive);
    throw_error("{}: {}: {}", path, what, reason);
  };
  for (const Entry& entry : entries_) {
    zip_source_t* source = entry.path.empty() ? zip_source_buffer(archive, entry.content.data(),
                                                                  entry.content.size(), 0)
                                              : zip_source_file(archive, entry.path.c_str(), 0, -1);
    if (source == nullptr) fail("cannot be read");
    const zip_int64_t index =
        zip_file_add(archive, (entry.name + ".npy").c_str(), source, ZIP_FL_ENC_UTF_8);
    if (index < 0) {
      zip_source_free(source);
      fail("cannot be added");
    }
    const auto at = static_cast<zip_uint64_t>(index);
    // 1980: equal arrays make equal files.
    constexpr std::time_t kFirstZipTime = 315532800;
    if (zip_set_file_compression(archive, at, ZIP_CM_STORE, 0) != 0 ||
        zip_file_set_mtime(archive, at, kFirstZipTime, 0) != 0)
      fail("cannot be added");
  }
  if (zip_close(archive) != 0) fail("cannot be written");
}

}  // namespace omentum

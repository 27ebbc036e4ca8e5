#pragma once

#include <Eigen/Core>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

namespace omentum {

/// Header of a .npy file (format 1.0), padded to 64 bytes: what numpy.load reads before the values.
std::string npy_header(const std::string& dtype, const std::vector<std::size_t>& shape);

/// A .npy file of 32-bit floats that is written in pieces, in any order; what is never written
/// reads as NaN. Throws Error where the disk refuses.
class NpyFile {
 public:
  NpyFile(std::string path, const std::vector<std::size_t>& shape);
  /// `first`: index of the first value in C order.
  void write(std::size_t first, const std::vector<float>& values);
  void close();
  const std::string& path() const { return path_; }

 private:
  void require(bool done) const;
  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  std::string path_;
  std::unique_ptr<std::FILE, Close> file_;
  std::size_t header_ = 0;
};

/// Arrays of one .npz file: numpy.load gives them by their names. Not compressed.
class NpzFile {
 public:
  void add(const std::string& name, const std::vector<std::string>& values);
  void add(const std::string& name, const std::vector<std::size_t>& shape,
           const std::vector<double>& values);
  /// A closed .npy file, which must stay until write().
  void add_file(const std::string& name, const std::string& path);
  /// Throws Error.
  void write(const std::string& path) const;

 private:
  struct Entry {
    std::string name, content, path;  ///< content or path
  };
  std::vector<Entry> entries_;
};

}  // namespace omentum

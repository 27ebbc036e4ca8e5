#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// An array of numpy (format 1 to 3): whole numbers, floats of 32 or 64 bits, booleans, of either
/// byte order.
class NpyArray {
 public:
  /// Total over any bytes; fails with one line that begins with `name`.
  static Result<NpyArray> parse(const std::string& name, std::string bytes);
  const std::vector<std::size_t>& shape() const { return shape_; }
  /// Value at an index along each axis, as many as there are axes.
  double at(const std::vector<std::size_t>& index) const;

 private:
  std::string bytes_;
  std::size_t body_ = 0, item_ = 0;
  char kind_ = 'f';
  bool swapped_ = false;
  std::vector<std::size_t> shape_, stride_;  ///< stride in items
};

/// One array of an .npz, "name.npy" within it, at most 1 GB. Fails with one line: no ZIP, no such
/// array (and which there are), damaged.
Result<std::string> read_npz_entry(const std::string& path, const std::string& array);
/// The same of a file that lies in memory.
Result<std::string> parse_npz_entry(const std::string& name, std::string_view bytes,
                                    const std::string& array);

}  // namespace omentum

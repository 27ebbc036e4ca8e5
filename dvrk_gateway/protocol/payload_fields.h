#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>

#include "dvrk_gateway/protocol/json_text.h"
#include "dvrk_gateway/protocol/json_writer.h"

namespace omentum {

// Parts that payloads of both directions have. For protocol/ alone. `finite` becomes false where a
// number was not; such a number is 0.

/// A list of numbers; null is an empty one. How many there were; more than N are refused.
template <std::size_t N>
int read_numbers(JsonText& text, std::array<double, N>& values, bool& finite) {
  values.fill(0);
  if (text.null()) return 0;
  std::size_t count = 0;
  text.array([&] {
    double value = 0;
    text.number(value);
    if (!text.ok()) return;
    if (count == N) {
      text.refuse();
      return;
    }
    finite = finite && std::isfinite(value);
    values[count++] = std::isfinite(value) ? value : 0;
  });
  return static_cast<int>(count);
}

/// Three numbers; anything else is refused. Whether they were read.
inline bool read_vector(JsonText& text, Eigen::Vector3d& vector, bool& finite) {
  std::array<double, 3> values{};
  if (read_numbers(text, values, finite) != 3) return text.refuse();
  vector = Eigen::Vector3d::Map(values.data());
  return text.ok();
}

/// Three rows of three numbers.
inline bool read_rotation(JsonText& text, Eigen::Matrix3d& rotation, bool& finite) {
  int rows = 0;
  text.array([&] {
    Eigen::Vector3d row = Eigen::Vector3d::Zero();
    if (rows == 3 || !read_vector(text, row, finite)) {
      text.refuse();
      return;
    }
    rotation.row(rows++) = row.transpose();
  });
  return rows == 3 ? text.ok() : text.refuse();
}

inline void write_pose(JsonWriter& writer, const Eigen::Matrix3d& rotation,
                       const Eigen::Vector3d& translation) {
  for (int row = 0; row < 3; ++row) {
    const Eigen::Vector3d values = rotation.row(row);
    writer.put(row == 0 ? R"({"Rotation":[)" : ",");
    writer.numbers({values.data(), 3});
  }
  writer.put(R"(],"Translation":)");
  writer.numbers({translation.data(), 3});
  writer.put("}");
}

}  // namespace omentum

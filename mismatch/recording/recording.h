#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "proto/recording_folder.pb.h"

namespace omentum {

/// One channel of numbers. Columns are named as in the tables of a recording folder, their unit at
/// the end (docs/formats.md 3), SI, in W, and stand in the order of
/// mismatch/recording/table_columns.h.
struct Series {
  std::vector<std::string> columns;
  std::vector<std::int64_t> time_ns;  ///< strictly increasing
  std::vector<double> values;         ///< row by row; NaN: not known
  std::string path;                   ///< of the table it was read from; empty: of none
  std::vector<std::uint32_t> lines;   ///< of each row in that table; empty: of none

  std::size_t rows() const { return time_ns.size(); }
  double at(std::size_t row, std::size_t column) const {
    return values[row * columns.size() + column];
  }
  /// Index of a column; columns.size() where there is none.
  std::size_t find(std::string_view name) const;
};
/// NaN equals NaN; where it was read from does not count.
bool operator==(const Series& a, const Series& b);

/// Pictures or clouds, which are too large to be held all at once: fetched one by one.
template <typename T>
struct Frames {
  std::vector<std::int64_t> time_ns;    ///< strictly increasing
  std::vector<std::uint32_t> number;    ///< in the name of the file
  std::function<T(std::size_t)> fetch;  ///< throws Error; not thread-safe

  std::size_t size() const { return time_ns.size(); }
};

using Cloud = std::vector<Eigen::Vector3f>;  ///< p_W [m]

/// One experiment: one motion with what was seen of it.
struct Recording {
  pb::RecordingInfo info;
  /// By topic: tool, tool_commanded, tool_setpoint, jaw, joints, joints_commanded, joints_setpoint,
  /// tracker, markers, force, coupon. None is empty.
  std::map<std::string, Series> series;
  Frames<Cloud> clouds;
  Frames<std::string> depth, color;   ///< PNG files
  std::string scene_path;             ///< file that the believed scene was read from; empty: none
  std::vector<std::string> warnings;  ///< of its reading, one line each
  std::vector<std::string> notes;     ///< what became of what in a bag, one line each

  const Series* find(const std::string& topic) const;
};

/// Same statements, numbers, clouds and pictures; warnings and notes apart. Else one line that
/// names the first difference; empty where there is none. Fetches every frame of both.
std::string difference(const Recording& a, const Recording& b);

/// "12.345" <-> ns, exact. A number with an exponent or more digits is rounded to the ns; nothing
/// where the text is no number or beyond 292 years.
std::string print_seconds(std::int64_t time_ns);
bool parse_seconds(std::string_view text, std::int64_t& time_ns);

}  // namespace omentum

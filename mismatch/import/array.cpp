#include "mismatch/import/array.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <memory>
#include <numeric>
#include <optional>
#include <sstream>

#include "core/check.h"
#include "core/csv.h"
#include "core/file_name.h"
#include "core/table.h"
#include "mismatch/import/npy.h"
#include "mismatch/import/source.h"
#include "mismatch/import/units.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

/// An array and what its axes are.
struct NamedArray {
  NpyArray array;
  /// time, column, point (once or more: rows and columns of a picture), xyz, or a whole number: of
  /// that axis one part alone.
  std::vector<std::string> axes;

  std::size_t axis(const std::string& name) const {
    return static_cast<std::size_t>(std::find(axes.begin(), axes.end(), name) - axes.begin());
  }
  /// Of all axes of that name together.
  std::size_t size(const std::string& name) const {
    std::size_t product = 1;
    for (std::size_t k = 0; k < axes.size(); ++k) product *= axes[k] == name ? array.shape()[k] : 1;
    return product;
  }
  /// The value at places by name; one of several axes counts over the last one first.
  double at(std::vector<std::pair<std::string, std::size_t>> places) const {
    std::vector<std::size_t> index(axes.size());
    for (std::size_t k = axes.size(); k-- > 0;) {
      if (const auto fixed = part_of(axes[k])) {
        index[k] = *fixed;
        continue;
      }
      for (auto& [name, place] : places) {
        if (name != axes[k]) continue;
        index[k] = place % array.shape()[k];
        place /= array.shape()[k];
      }
    }
    return array.at(index);
  }
  static std::optional<std::size_t> part_of(const std::string& axis) {
    const auto number = parse_number(axis);
    if (!number || !(*number >= 0 && *number < 1e9) || *number != std::floor(*number))
      return std::nullopt;
    return static_cast<std::size_t>(*number);
  }
};

NamedArray load(const pb::SourceMap& source, const std::string& path) {
  std::string bytes = read_whole_file(path);
  std::string name = path;
  if (has_ending(path, ".npz")) {
    if (source.array().name().empty()) throw_error("source.array.name: needed for {}", path);
    name += ": " + source.array().name();
    Result<std::string> entry = parse_npz_entry(path, bytes, source.array().name());
    if (!entry) throw_error("{}", entry.error());
    bytes = std::move(entry).value();
  }
  Result<NpyArray> array = NpyArray::parse(name, std::move(bytes));
  if (!array) throw_error("{}", array.error());
  std::istringstream words(source.array().axes());
  NamedArray made{std::move(array).value(), {std::istream_iterator<std::string>(words), {}}};
  std::vector<std::string> sorted = made.axes;
  std::erase_if(sorted,
                [](const std::string& axis) { return NamedArray::part_of(axis).has_value(); });
  std::sort(sorted.begin(), sorted.end());
  sorted.erase(std::unique(sorted.begin(), sorted.end(),
                           [](const auto& a, const auto& b) { return a == b && a == "point"; }),
               sorted.end());
  const bool columns = sorted == std::vector<std::string>{"column", "time"};
  const bool points = sorted == std::vector<std::string>{"point", "time", "xyz"};
  if (!columns && !points)
    throw_error(
        "source.array.axes: \"{}\", allowed time and column, or time, point and xyz; point may "
        "stand "
        "for several axes (\"time point point xyz\"), and a number for one part of an axis (\"0 "
        "time "
        "point xyz\")",
        shown(source.array().axes()));
  if (made.array.shape().size() != made.axes.size())
    throw_error(
        "{}: an array of shape ({}), needed one axis each of {}; point may stand for several, and "
        "a "
        "number for one part of an axis",
        name, fmt::join(made.array.shape(), ", "), source.array().axes());
  for (std::size_t k = 0; k < made.axes.size(); ++k) {
    const auto part = NamedArray::part_of(made.axes[k]);
    if (part && *part >= made.array.shape()[k])
      throw_error("{}: an array of shape ({}): no part {} of axis {}", name,
                  fmt::join(made.array.shape(), ", "), *part, k);
  }
  if (points && made.size("xyz") != 3)
    throw_error("{}: an array of shape ({}): axis xyz has {}, needed 3", name,
                fmt::join(made.array.shape(), ", "), made.size("xyz"));
  return made;
}

/// Values of the two last axes at one time, through a map of (time, a, b).
double value_at(const NamedArray& a, std::size_t time, std::size_t point, std::size_t xyz) {
  return a.at({{"time", time}, {"point", point}, {"xyz", xyz}});
}

/// A table of the text of an array, so that columns are mapped in one place.
TextTable as_table(const NamedArray& a, const std::string& path) {
  std::string text;
  for (std::size_t k = 0; k < a.size("column"); ++k)
    text += fmt::format("{}{}", k > 0 ? "," : "", k);
  for (std::size_t row = 0; row < a.size("time"); ++row) {
    text += '\n';
    for (std::size_t k = 0; k < a.size("column"); ++k) {
      const double value = a.at({{"time", row}, {"column", k}});
      text += fmt::format("{}{}", k > 0 ? "," : "",
                          std::isnan(value) ? "nan" : fmt::format("{}", value));
    }
  }
  TextFormat format;
  format.unknown = {"nan"};
  return {path, std::move(text), format};
}

void add_markers(const NamedArray& a, double factor, const std::string& path,
                 const std::vector<std::int64_t>& times, const Eigen::Isometry3d& X_WF,
                 Recording& recording) {
  std::map<std::string, Series> found;
  Series& series = found["markers"];
  series.time_ns = times;
  for (std::size_t k = 0; k < a.size("point"); ++k) {
    for (const char axis : {'x', 'y', 'z'})
      series.columns.push_back(fmt::format("marker{}_{}_m", k, axis));
  }
  for (std::size_t t = 0; t < times.size(); ++t) {
    for (std::size_t k = 0; k < a.size("point"); ++k) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        series.values.push_back(factor * value_at(a, t, k, axis));
    }
  }
  add_series(path, X_WF, std::move(found), recording);
}

}  // namespace

ArrayShape array_shape(const pb::SourceMap& source, const std::string& path) {
  return {load(source, path).size("time")};
}

void add_array(const pb::SourceMap& source, const std::string& path,
               const std::vector<std::int64_t>& times, const Eigen::Isometry3d& X_WF,
               Recording& recording) {
  auto array = std::make_shared<NamedArray>(load(source, path));
  if (array->axis("column") < array->axes.size()) {
    const TextTable table = as_table(*array, path);
    std::vector<std::size_t> rows(times.size());
    std::iota(rows.begin(), rows.end(), std::size_t{0});
    std::map<std::string, Series> found;
    add_columns(source, table, rows, times, {}, found);
    return add_series(path, X_WF, std::move(found), recording);
  }
  const Result<UnitFactor> unit = find_unit(source.array().unit());
  if (!unit || unit.value().si != "m")
    throw_error("source.array.unit: \"{}\", needed a length", shown(source.array().unit()));
  const double factor = source.array().factor() * unit.value().factor;
  if (source.array().to() == "markers")
    return add_markers(*array, factor, path, times, X_WF, recording);
  if (source.array().to() != "clouds")
    throw_error("source.array.to: \"{}\", allowed clouds, markers", shown(source.array().to()));
  if (recording.clouds.size() > 0) throw_error("{}: two sources of clouds", path);
  recording.clouds.time_ns = times;
  recording.clouds.number.resize(times.size());
  std::iota(recording.clouds.number.begin(), recording.clouds.number.end(), 0U);
  recording.clouds.fetch = [array, factor, X_WF](std::size_t k) {
    Cloud cloud;
    for (std::size_t i = 0; i < array->size("point"); ++i) {
      const Eigen::Vector3d p(value_at(*array, k, i, 0), value_at(*array, k, i, 1),
                              value_at(*array, k, i, 2));
      const Eigen::Vector3f point = (X_WF * (factor * p)).cast<float>();
      if (point.allFinite()) cloud.push_back(point);
    }
    return cloud;
  };
}

}  // namespace omentum

#include "mismatch/import/array.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <iterator>
#include <memory>
#include <numeric>
#include <sstream>

#include "core/check.h"
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
  std::vector<std::string> axes;

  std::size_t axis(const std::string& name) const {
    return static_cast<std::size_t>(std::find(axes.begin(), axes.end(), name) - axes.begin());
  }
  std::size_t size(const std::string& name) const { return array.shape()[axis(name)]; }
};

NamedArray load(const pb::SourceMap& source, const std::string& path) {
  std::string bytes = read_whole_file(path);
  std::string name = path;
  if (path.ends_with(".npz")) {
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
  std::sort(sorted.begin(), sorted.end());
  const bool columns = sorted == std::vector<std::string>{"column", "time"};
  const bool points = sorted == std::vector<std::string>{"point", "time", "xyz"};
  if (!columns && !points)
    throw_error("source.array.axes: \"{}\", allowed time and column, or time, point and xyz",
                shown(source.array().axes()));
  if (made.array.shape().size() != made.axes.size())
    throw_error("{}: an array of shape ({}), needed axes {}", name,
                fmt::join(made.array.shape(), ", "), source.array().axes());
  if (points && made.size("xyz") != 3)
    throw_error("{}: an array of shape ({}): axis xyz has {}, needed 3", name,
                fmt::join(made.array.shape(), ", "), made.size("xyz"));
  return made;
}

/// Values of the two last axes at one time, through a map of (time, a, b).
double value_at(const NamedArray& a, std::size_t time, std::size_t point, std::size_t xyz) {
  std::vector<std::size_t> index(3);
  index[a.axis("time")] = time;
  index[a.axis("point")] = point;
  index[a.axis("xyz")] = xyz;
  return a.array.at(index);
}

/// A table of the text of an array, so that columns are mapped in one place.
TextTable as_table(const NamedArray& a, const std::string& path) {
  std::string text;
  for (std::size_t k = 0; k < a.size("column"); ++k)
    text += fmt::format("{}{}", k > 0 ? "," : "", k);
  for (std::size_t row = 0; row < a.size("time"); ++row) {
    text += '\n';
    for (std::size_t k = 0; k < a.size("column"); ++k) {
      std::vector<std::size_t> index(2);
      index[a.axis("time")] = row;
      index[a.axis("column")] = k;
      const double value = a.array.at(index);
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
  if (array->axes.size() == 2) {
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

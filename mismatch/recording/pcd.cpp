#include "mismatch/recording/pcd.h"

#include <fmt/format.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <sstream>

#include "core/csv.h"

namespace omentum {
namespace {

constexpr std::size_t kMostPoints = 10'000'000;
constexpr std::size_t kLongestHeader = 100'000;

struct Field {
  std::string name;
  char type = 'F';
  std::size_t size = 4, count = 1;
};

struct Layout {
  std::vector<Field> fields;
  std::size_t points = 0, body = 0;
  std::string data;
};

template <typename T>
double as_double(const char* bytes) {
  T value{};
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

/// Null for a type that there is not.
double (*reader_of(const Field& field))(const char*) {
  switch (field.type) {
    case 'F':
      return field.size == 4 ? as_double<float> : field.size == 8 ? as_double<double> : nullptr;
    case 'I':
      return field.size == 1   ? as_double<std::int8_t>
             : field.size == 2 ? as_double<std::int16_t>
             : field.size == 4 ? as_double<std::int32_t>
             : field.size == 8 ? as_double<std::int64_t>
                               : nullptr;
    case 'U':
      return field.size == 1   ? as_double<std::uint8_t>
             : field.size == 2 ? as_double<std::uint16_t>
             : field.size == 4 ? as_double<std::uint32_t>
             : field.size == 8 ? as_double<std::uint64_t>
                               : nullptr;
    default:
      return nullptr;
  }
}

Result<Layout> read_header(std::string_view bytes) {
  Layout layout;
  std::size_t at = 0;
  bool begun = false;
  while (layout.data.empty()) {
    const std::size_t end = bytes.substr(0, kLongestHeader).find('\n', at);
    if (end == std::string_view::npos) return Failure{begun ? "a header without DATA" : "no PCD"};
    std::istringstream words{std::string(bytes.substr(at, end - at))};
    at = end + 1;
    std::string key;
    words >> key;
    if (key.empty() || key.front() == '#') continue;
    const auto each = [&](auto&& set) {
      for (Field& field : layout.fields) {
        if (!(words >> set(field))) return false;
      }
      return true;
    };
    bool good = true;
    if (key == "VERSION") {
      begun = true;
    } else if (key == "FIELDS") {
      for (std::string name; words >> name;) layout.fields.push_back({name});
      good = !layout.fields.empty() && layout.fields.size() <= 1000;
    } else if (key == "SIZE") {
      good = each([](Field& f) -> std::size_t& { return f.size; });
    } else if (key == "TYPE") {
      good = each([](Field& f) -> char& { return f.type; });
    } else if (key == "COUNT") {
      good = each([](Field& f) -> std::size_t& { return f.count; });
    } else if (key == "POINTS") {
      good = static_cast<bool>(words >> layout.points);
    } else if (key == "DATA") {
      good = static_cast<bool>(words >> layout.data);
    } else if (key != "WIDTH" && key != "HEIGHT" && key != "VIEWPOINT") {
      return Failure{begun ? "a line of the header that is not known" : "no PCD"};
    }
    if (!good) return Failure{fmt::format("a header whose {} cannot be read", key)};
  }
  layout.body = at;
  if (layout.data != "ascii" && layout.data != "binary")
    return Failure{"its data are neither ascii nor binary"};
  if (layout.points < 1 || layout.points > kMostPoints)
    return Failure{fmt::format("{} points, allowed 1 ... {}", layout.points, kMostPoints)};
  for (const Field& field : layout.fields) {
    if (field.count < 1 || field.count > 10'000 || reader_of(field) == nullptr)
      return Failure{"a field of a type that is not known"};
  }
  return layout;
}

}  // namespace

Result<std::vector<Eigen::Vector3f>> parse_pcd(const std::string& name, std::string_view bytes) {
  const auto wrong = [&name](const std::string& what) {
    return Failure{fmt::format("{}: {}", name, what)};
  };
  const Result<Layout> header = read_header(bytes);
  if (!header) return wrong(header.error());
  const Layout& layout = header.value();
  struct Axis {
    std::size_t offset = 0, word = 0;
    double (*read)(const char*) = nullptr;
  };
  std::array<std::optional<Axis>, 3> axes;
  std::size_t stride = 0, words = 0;
  for (const Field& field : layout.fields) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (field.name == std::string(1, "xyz"[k]) && field.count == 1)
        axes[k] = {stride, words, reader_of(field)};
    }
    stride += field.size * field.count;
    words += field.count;
  }
  if (!axes[0] || !axes[1] || !axes[2]) return wrong("no x, y or z");
  std::string_view rest = bytes.substr(layout.body);
  std::vector<Eigen::Vector3f> points;
  const auto add = [&points](const Eigen::Vector3d& p) {
    const Eigen::Vector3f point = p.cast<float>();
    if (point.allFinite()) points.push_back(point);
  };
  if (layout.data == "binary") {
    if (rest.size() / stride < layout.points)
      return wrong(fmt::format("ends in point {} of {}", rest.size() / stride, layout.points));
    for (std::size_t i = 0; i < layout.points; ++i) {
      const char* point = rest.data() + i * stride;
      add({axes[0]->read(point + axes[0]->offset), axes[1]->read(point + axes[1]->offset),
           axes[2]->read(point + axes[2]->offset)});
    }
  } else {
    std::vector<std::string_view> cells;
    for (std::size_t i = 0; i < layout.points; ++i) {
      cells.clear();
      for (std::size_t k = 0; k < words; ++k) {
        rest.remove_prefix(std::min(rest.find_first_not_of(" \t\r\n"), rest.size()));
        const std::string_view word = rest.substr(0, rest.find_first_of(" \t\r\n"));
        rest.remove_prefix(word.size());
        cells.push_back(word);
      }
      Eigen::Vector3d p;
      for (std::size_t k = 0; k < 3; ++k) {
        const std::string_view word = cells[axes[k]->word];
        const std::optional<double> value =
            word == "nan" ? std::numeric_limits<double>::quiet_NaN() : parse_number(word);
        if (!value) return wrong(fmt::format("ends in point {} of {}", i, layout.points));
        p[static_cast<int>(k)] = *value;
      }
      add(p);
    }
  }
  if (points.empty()) return wrong("no point that is finite");
  return points;
}

}  // namespace omentum

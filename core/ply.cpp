#include "core/ply.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <limits>
#include <optional>
#include <sstream>

#include "core/csv.h"

namespace omentum {
namespace {

static_assert(std::endian::native == std::endian::little,
              "bytes of a PLY are those of the memory, or reversed");

constexpr std::size_t kMostVertices = 10'000'000;
constexpr std::size_t kLongestHeader = 100'000;

template <typename T>
double as_double(const char* bytes) {
  T value{};
  std::memcpy(&value, bytes, sizeof value);
  return static_cast<double>(value);
}

struct Scalar {
  std::string_view name, other_name;
  std::size_t size;
  double (*read)(const char*);
};
constexpr std::array<Scalar, 8> kScalars = {{{"char", "int8", 1, as_double<std::int8_t>},
                                             {"uchar", "uint8", 1, as_double<std::uint8_t>},
                                             {"short", "int16", 2, as_double<std::int16_t>},
                                             {"ushort", "uint16", 2, as_double<std::uint16_t>},
                                             {"int", "int32", 4, as_double<std::int32_t>},
                                             {"uint", "uint32", 4, as_double<std::uint32_t>},
                                             {"float", "float32", 4, as_double<float>},
                                             {"double", "float64", 8, as_double<double>}}};

struct Layout {
  bool ascii = false, big_endian = false;
  std::size_t vertices = 0;
  std::vector<const Scalar*> properties;          ///< of a vertex, in order
  std::array<std::optional<std::size_t>, 3> xyz;  ///< which of them
  std::size_t body = 0;                           ///< where the numbers begin
};

Result<void> add_property(std::istringstream& words, Layout& layout) {
  std::string type, name;
  words >> type >> name;
  const Scalar* found = nullptr;
  for (const Scalar& scalar : kScalars) {
    if (type == scalar.name || type == scalar.other_name) found = &scalar;
  }
  if (found == nullptr || !words) return Failure{"a property of a vertex that is no scalar"};
  for (std::size_t axis = 0; axis < 3; ++axis) {
    if (name == std::string(1, "xyz"[axis])) layout.xyz[axis] = layout.properties.size();
  }
  layout.properties.push_back(found);
  return {};
}

Result<Layout> read_header(std::string_view bytes) {
  if (!bytes.starts_with("ply")) return Failure{"no PLY"};
  constexpr std::string_view kEnd = "end_header";
  const std::string_view head = bytes.substr(0, kLongestHeader);
  const std::size_t end = head.find(kEnd);
  const std::size_t line_end = end == head.npos ? end : head.find('\n', end);
  if (line_end == head.npos) return Failure{"a header without end_header"};
  Layout layout;
  layout.body = line_end + 1;
  std::istringstream lines{std::string(head.substr(0, end))};
  bool format = false;
  int elements = 0;
  for (std::string line; std::getline(lines, line);) {
    std::istringstream words(line);
    std::string word;
    words >> word;
    if (word == "format") {
      words >> word;
      layout.ascii = word == "ascii";
      layout.big_endian = word == "binary_big_endian";
      if (!layout.ascii && !layout.big_endian && word != "binary_little_endian")
        return Failure{"its format is none of ascii, binary_little_endian and binary_big_endian"};
      format = true;
    } else if (word == "element") {
      if (++elements > 1) break;  // what stands behind the vertices does not matter
      words >> word >> layout.vertices;
      if (word != "vertex" || !words) return Failure{"its first element is not vertex"};
      if (layout.vertices > kMostVertices)
        return Failure{
            fmt::format("{} vertices, allowed up to {}", layout.vertices, kMostVertices)};
    } else if (word == "property") {
      if (Result<void> added = add_property(words, layout); !added) return Failure{added.error()};
    }
  }
  if (!format || elements == 0) return Failure{"a header without format or vertices"};
  if (!layout.xyz[0] || !layout.xyz[1] || !layout.xyz[2]) return Failure{"no x, y or z"};
  return layout;
}

/// The next word; empty at the end.
std::string_view take_word(std::string_view& rest) {
  const std::size_t begin = std::min(rest.find_first_not_of(" \t\r\n"), rest.size());
  rest.remove_prefix(begin);
  const std::string_view word = rest.substr(0, rest.find_first_of(" \t\r\n"));
  rest.remove_prefix(word.size());
  return word;
}

/// Of a word of text; not a number where a camera saw nothing ("nan", "-nan(ind)", "inf").
std::optional<double> ascii_number(std::string_view word) {
  std::string_view bare = word;
  if (bare.starts_with('-') || bare.starts_with('+')) bare.remove_prefix(1);
  for (const std::string_view none : {"nan", "NaN", "NAN", "inf", "Inf", "INF"}) {
    if (bare.starts_with(none)) return std::numeric_limits<double>::quiet_NaN();
  }
  return parse_number(word);
}

bool read_ascii(std::string_view& rest, const Layout& layout, std::vector<double>& values) {
  for (std::size_t k = 0; k < layout.properties.size(); ++k) {
    const std::optional<double> value = ascii_number(take_word(rest));
    if (!value) return false;
    values[k] = *value;
  }
  return true;
}

bool read_binary(std::string_view& rest, const Layout& layout, std::vector<double>& values) {
  for (std::size_t k = 0; k < layout.properties.size(); ++k) {
    const Scalar& scalar = *layout.properties[k];
    if (rest.size() < scalar.size) return false;
    std::array<char, sizeof(double)> raw{};
    for (std::size_t i = 0; i < scalar.size; ++i)
      raw[i] = rest[layout.big_endian ? scalar.size - 1 - i : i];
    values[k] = scalar.read(raw.data());
    rest.remove_prefix(scalar.size);
  }
  return true;
}

}  // namespace

std::string encode_ply(const std::vector<Eigen::Vector3f>& points) {
  std::string ply = fmt::format(
      "ply\nformat binary_little_endian 1.0\ncomment metres, frame W\nelement vertex {}\n"
      "property float x\nproperty float y\nproperty float z\nend_header\n",
      points.size());
  for (const Eigen::Vector3f& p : points)
    ply.append(reinterpret_cast<const char*>(p.data()), 3 * sizeof(float));
  return ply;
}

Result<std::vector<Eigen::Vector3f>> parse_ply(const std::string& name, std::string_view bytes) {
  const Result<Layout> header = read_header(bytes);
  if (!header) return Failure{fmt::format("{}: {}", name, header.error())};
  const Layout& layout = header.value();
  std::string_view rest = bytes.substr(layout.body);
  std::vector<double> values(layout.properties.size());
  std::vector<Eigen::Vector3f> points;
  points.reserve(std::min(layout.vertices, rest.size()));
  for (std::size_t k = 0; k < layout.vertices; ++k) {
    const bool read =
        layout.ascii ? read_ascii(rest, layout, values) : read_binary(rest, layout, values);
    if (!read) return Failure{fmt::format("{}: ends in vertex {} of {}", name, k, layout.vertices)};
    const Eigen::Vector3d p(values[*layout.xyz[0]], values[*layout.xyz[1]], values[*layout.xyz[2]]);
    const Eigen::Vector3f point = p.cast<float>();
    if (point.allFinite()) points.push_back(point);
  }
  return points;
}

}  // namespace omentum

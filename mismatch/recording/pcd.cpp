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
  bool posed = false;  ///< VIEWPOINT is a pose other than the identity
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
    } else if (key == "VIEWPOINT") {
      std::array<double, 7> pose{};
      bool whole = true;
      for (double& value : pose) whole = whole && static_cast<bool>(words >> value);
      layout.posed = whole && pose != std::array<double, 7>{0, 0, 0, 1, 0, 0, 0};
    } else if (key != "WIDTH" && key != "HEIGHT") {
      return Failure{begun ? "a line of the header that is not known" : "no PCD"};
    }
    if (!good) return Failure{fmt::format("a header whose {} cannot be read", key)};
  }
  layout.body = at;
  if (layout.data != "ascii" && layout.data != "binary" && layout.data != "binary_compressed")
    return Failure{"its data are neither ascii, binary nor binary_compressed"};
  if (layout.points > kMostPoints)
    return Failure{fmt::format("{} points, allowed up to {}", layout.points, kMostPoints)};
  for (const Field& field : layout.fields) {
    if (field.count < 1 || field.count > 10'000 || reader_of(field) == nullptr)
      return Failure{"a field of a type that is not known"};
  }
  return layout;
}

/// What LZF packed: runs of bytes as they are, and references back to bytes already there. False
/// where the bytes are no such, or give another number than `size`.
bool unpack_lzf(std::string_view packed, std::size_t size, std::string& unpacked) {
  unpacked.clear();
  // No reference gives more than 264 bytes of 2.
  if (size / 264 > packed.size()) return false;
  unpacked.reserve(size);
  const auto next = [&packed] {
    const auto byte = static_cast<unsigned char>(packed.front());
    packed.remove_prefix(1);
    return static_cast<std::size_t>(byte);
  };
  while (!packed.empty()) {
    const std::size_t control = next();
    if (control < 32) {
      const std::size_t run = control + 1;
      if (run > packed.size() || run > size - unpacked.size()) return false;
      unpacked.append(packed.substr(0, run));
      packed.remove_prefix(run);
      continue;
    }
    std::size_t length = control >> 5;
    if (packed.size() < (length == 7 ? 2U : 1U)) return false;
    if (length == 7) length += next();
    length += 2;
    const std::size_t back = ((control & 31) << 8) + next() + 1;
    if (back > unpacked.size() || length > size - unpacked.size()) return false;
    // Byte by byte: what is repeated may be what this very reference gives.
    for (std::size_t k = 0; k < length; ++k) unpacked.push_back(unpacked[unpacked.size() - back]);
  }
  return unpacked.size() == size;
}

/// Body of binary_compressed: sizes, then the packed fields one behind the other, each of all
/// points.
Result<std::string> unpack_body(std::string_view body) {
  std::array<std::uint32_t, 2> sizes{};
  if (body.size() < sizeof sizes) return Failure{"ends before the sizes of its packed data"};
  std::memcpy(sizes.data(), body.data(), sizeof sizes);
  body.remove_prefix(sizeof sizes);
  if (sizes[0] > body.size())
    return Failure{fmt::format("ends in byte {} of {} packed ones", body.size(), sizes[0])};
  std::string unpacked;
  if (!unpack_lzf(body.substr(0, sizes[0]), sizes[1], unpacked))
    return Failure{"its packed data are damaged"};
  return unpacked;
}

}  // namespace

bool has_viewpoint(std::string_view pcd) {
  const Result<Layout> header = read_header(pcd);
  return header && header.value().posed;
}

Result<std::vector<Eigen::Vector3f>> parse_pcd(const std::string& name, std::string_view bytes) {
  const auto wrong = [&name](const std::string& what) {
    return Failure{fmt::format("{}: {}", name, what)};
  };
  const Result<Layout> header = read_header(bytes);
  if (!header) return wrong(header.error());
  const Layout& layout = header.value();
  struct Axis {
    std::size_t offset = 0, word = 0, size = 0;
    double (*read)(const char*) = nullptr;
  };
  std::array<std::optional<Axis>, 3> axes;
  std::size_t stride = 0, words = 0;
  for (const Field& field : layout.fields) {
    for (std::size_t k = 0; k < 3; ++k) {
      if (field.name == std::string(1, "xyz"[k]) && field.count == 1)
        axes[k] = {stride, words, field.size, reader_of(field)};
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
  } else if (layout.data == "binary_compressed") {
    const Result<std::string> unpacked = unpack_body(rest);
    if (!unpacked) return wrong(unpacked.error());
    const std::string& fields = unpacked.value();
    if (fields.size() / stride < layout.points)
      return wrong(fmt::format("holds {} points of {}", fields.size() / stride, layout.points));
    for (std::size_t i = 0; i < layout.points; ++i) {
      Eigen::Vector3d p;
      for (std::size_t k = 0; k < 3; ++k)
        p[static_cast<int>(k)] =
            axes[k]->read(fields.data() + axes[k]->offset * layout.points + i * axes[k]->size);
      add(p);
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
        const std::optional<double> value = word.ends_with("nan") || word.ends_with("inf")
                                                ? std::numeric_limits<double>::quiet_NaN()
                                                : parse_number(word);
        if (!value) return wrong(fmt::format("ends in point {} of {}", i, layout.points));
        p[static_cast<int>(k)] = *value;
      }
      add(p);
    }
  }
  return points;
}

}  // namespace omentum

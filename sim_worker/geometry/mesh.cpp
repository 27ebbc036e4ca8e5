#include "sim_worker/geometry/mesh.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <string_view>
#include <unordered_map>

#include "core/check.h"
#include "core/file_name.h"
#include "core/hash.h"
#include "core/log.h"
#include "core/regular_file.h"

namespace omentum {
namespace {

constexpr std::int64_t kMaxFileBytes = 256 << 20;  // bounds memory for hostile input
constexpr double kMaxExtent = 10;                  // [m]; beyond it the unit is wrong
constexpr double kMinExtent = 1e-4;                // [m]; below it the unit is wrong
constexpr std::size_t kManyTriangles = 500'000;    // told
constexpr std::size_t kStlHeaderBytes = 84;
constexpr std::size_t kStlTriangleBytes = 50;

bool is_space(char c) { return c == ' ' || c == '\t' || c == '\r' || c == '\v' || c == '\f'; }

/// Splits off the next word; empty at the end of the line.
std::string_view next_word(std::string_view& rest) {
  while (!rest.empty() && is_space(rest.front())) rest.remove_prefix(1);
  std::size_t length = 0;
  while (length < rest.size() && !is_space(rest[length])) ++length;
  const std::string_view word = rest.substr(0, length);
  rest.remove_prefix(length);
  return word;
}

/// A word of the file for a message: short and printable.
std::string quote(std::string_view word) {
  std::string text;
  for (const char c : word.substr(0, 24)) text += (c >= 32 && c < 127) ? c : '?';
  return "\"" + text + (word.size() > 24 ? "...\"" : "\"");
}

/// Calls function(number from 1, line) for every line.
template <typename Function>
void for_each_line(std::string_view content, Function function) {
  std::size_t line = 1;
  while (!content.empty()) {
    const std::size_t end = std::min(content.find('\n'), content.size());
    function(line++, content.substr(0, end));
    content.remove_prefix(std::min(end + 1, content.size()));
  }
}

double parse_coordinate(const std::string& name, std::size_t line, std::string_view word) {
  if (word.empty()) throw_error("{}:{}: vertex with fewer than three coordinates", name, line);
  const std::string_view digits = word.front() == '+' ? word.substr(1) : word;
  double value = 0;
  const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (code != std::errc() || end != digits.data() + digits.size()) {
    throw_error("{}:{}: coordinate {} is not a number", name, line, quote(word));
  }
  if (!std::isfinite(value)) {
    throw_error("{}:{}: coordinate {} is not finite", name, line, quote(word));
  }
  return value;
}

Eigen::Vector3d parse_point(const std::string& name, std::size_t line, std::string_view& rest) {
  Eigen::Vector3d point;
  for (int axis = 0; axis < 3; ++axis) point[axis] = parse_coordinate(name, line, next_word(rest));
  return point;
}

/// "7", "7/1", "7/1/3", "7//3" or negative (counted back from the last vertex) to an index from 0.
int parse_corner(const std::string& name, std::size_t line, std::string_view word,
                 std::size_t vertex_count) {
  const std::string_view digits = word.substr(0, word.find('/'));
  std::int64_t index = 0;
  const auto [end, code] = std::from_chars(digits.data(), digits.data() + digits.size(), index);
  if (code != std::errc() || end != digits.data() + digits.size() || index == 0) {
    throw_error("{}:{}: face corner {} is not a vertex index", name, line, quote(word));
  }
  const std::int64_t count = static_cast<std::int64_t>(vertex_count);
  const std::int64_t absolute = index > 0 ? index - 1 : count + index;
  if (absolute < 0 || absolute >= count) {
    throw_error("{}:{}: face corner {} is outside the {} vertices read so far", name, line,
                quote(word), vertex_count);
  }
  return static_cast<int>(absolute);
}

std::string in_small_letters(std::string_view word) {
  std::string small(word);
  for (char& c : small) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  return small;
}

/// Statements that hold surfaces of other kinds, or name a file that does: without them the mesh
/// would be another one.
bool is_other_surface(std::string_view word) {
  constexpr std::array<std::string_view, 6> kSurfaces = {"surf", "curv", "curv2",
                                                         "bmat", "call", "csh"};
  return std::find(kSurfaces.begin(), kSurfaces.end(), word) != kSurfaces.end();
}

/// What may begin a line of an OBJ file of any program.
bool may_be_keyword(std::string_view word) {
  return word.size() <= 32 && std::all_of(word.begin(), word.end(), [](char c) {
           return (c >= 'a' && c <= 'z') || (c >= '0' && c <= '9') || c == '_' || c == '.';
         });
}

/// Calls function(number from 1 of its first part, line) for every line; one whose last character
/// is a backslash goes on in the next.
template <typename Function>
void for_each_joined_line(std::string_view content, Function function) {
  std::string joined;
  std::size_t first = 0;
  for_each_line(content, [&](std::size_t line, std::string_view rest) {
    while (!rest.empty() && is_space(rest.back())) rest.remove_suffix(1);
    const bool goes_on = rest.ends_with('\\');
    if (goes_on) rest.remove_suffix(1);
    if (first == 0 && !goes_on) return function(line, rest);
    if (first == 0) first = line;
    joined.append(rest).push_back(' ');
    if (goes_on) return;
    function(first, std::string_view(joined));
    joined.clear();
    first = 0;
  });
  if (first > 0) function(first, std::string_view(joined));
}

void require_size(const std::string& name, std::int64_t bytes) {
  if (bytes > kMaxFileBytes)
    throw_error("{}: {} bytes, allowed up to {}", name, bytes, kMaxFileBytes);
}

TriangleMesh parse_obj(const std::string& name, std::string_view content) {
  TriangleMesh mesh;
  std::string odd;  // the first line of a kind that is not known
  for_each_joined_line(content, [&](std::size_t line, std::string_view rest) {
    const std::string_view written = next_word(rest);
    if (written.empty() || written.front() == '#') return;
    const std::string keyword = in_small_letters(written);
    if (keyword == "v") {
      mesh.vertices.push_back(parse_point(name, line, rest));
    } else if (keyword == "f" || keyword == "fo") {
      std::vector<int> corners;
      for (std::string_view word = next_word(rest); !word.empty() && word.front() != '#';
           word = next_word(rest)) {
        corners.push_back(parse_corner(name, line, word, mesh.vertices.size()));
      }
      if (corners.size() < 3) throw_error("{}:{}: face with fewer than three corners", name, line);
      for (std::size_t k = 2; k < corners.size(); ++k) {
        mesh.triangles.emplace_back(corners[0], corners[k - 1], corners[k]);
      }
    } else if (is_other_surface(keyword)) {
      throw_error("{}:{}: {}: surfaces that are no polygons are not read: export triangles", name,
                  line, quote(written));
    } else if (!may_be_keyword(keyword)) {
      throw_error("{}:{}: {} is not a line of an OBJ file", name, line, quote(written));
    } else if (constexpr std::array<std::string_view, 10> kCommon = {"vn", "vt", "vp", "o", "g",
                                                                     "s", "usemtl", "mtllib", "l",
                                                                     "p"};
               odd.empty() && std::find(kCommon.begin(), kCommon.end(), keyword) == kCommon.end()) {
      odd = fmt::format("{}:{}: {} is not a line of an OBJ file", name, line, quote(written));
    }
  });
  // Programs write statements of their own between the polygons; without polygons it is no OBJ.
  if (mesh.triangles.empty() && !odd.empty()) throw_error("{}", odd);
  return mesh;
}

/// Collects triangles given by corner coordinates and merges corners with equal coordinates.
class CornerMerger {
 public:
  explicit CornerMerger(TriangleMesh& mesh) : mesh_(mesh) {}

  void add(const Eigen::Vector3d& corner) {
    corners_[count_++] = index_of(corner);
    if (count_ < 3) return;
    mesh_.triangles.emplace_back(corners_[0], corners_[1], corners_[2]);
    count_ = 0;
  }

 private:
  int index_of(const Eigen::Vector3d& corner) {
    std::array<double, 3> key{};
    for (int axis = 0; axis < 3; ++axis) key[axis] = corner[axis] + 0.0;  // -0 becomes +0
    const std::string bytes(reinterpret_cast<const char*>(key.data()), sizeof(key));
    const auto [found, added] = index_.try_emplace(bytes, static_cast<int>(mesh_.vertices.size()));
    if (added) mesh_.vertices.push_back(corner);
    return found->second;
  }

  TriangleMesh& mesh_;
  std::unordered_map<std::string, int> index_;  // never iterated
  std::array<int, 3> corners_{};
  int count_ = 0;
};

TriangleMesh parse_ascii_stl(const std::string& name, std::string_view content) {
  TriangleMesh mesh;
  CornerMerger merger(mesh);
  std::size_t last_line = 0;
  int corners = 0;
  bool in_loop = false;
  bool ended = false;
  for_each_line(content, [&](std::size_t line, std::string_view rest) {
    last_line = line;
    const std::string_view written = next_word(rest);
    std::string keyword = in_small_letters(written);
    // "end loop" of some programs.
    if (keyword == "end") keyword += in_small_letters(next_word(rest));
    if (keyword == "vertex") {
      if (!in_loop || ++corners > 3) {
        throw_error("{}:{}: vertex outside a loop of three", name, line);
      }
      merger.add(parse_point(name, line, rest));
    } else if (keyword == "outer") {
      if (in_loop) throw_error("{}:{}: loop inside a loop", name, line);
      in_loop = true;
      corners = 0;
    } else if (keyword == "endloop") {
      if (!in_loop || corners != 3) {
        throw_error("{}:{}: facet with {} corners, not three", name, line, corners);
      }
      in_loop = false;
    } else if (keyword == "endsolid") {
      ended = true;
    } else if (!keyword.empty() && keyword != "solid" && keyword != "facet" &&
               keyword != "endfacet") {
      throw_error("{}:{}: {} is not a line of an STL file", name, line, quote(written));
    }
  });
  if (in_loop || !ended) throw_error("{}:{}: file ends before endsolid", name, last_line);
  return mesh;
}

std::uint32_t stl_triangle_count(std::string_view content) {
  std::uint32_t count = 0;
  std::memcpy(&count, content.data() + 80, sizeof(count));
  return count;
}

TriangleMesh parse_binary_stl(const std::string& name, std::string_view content) {
  if (content.size() < kStlHeaderBytes) {
    throw_error("{}: byte {}: file ends inside the STL header of {} bytes", name, content.size(),
                kStlHeaderBytes);
  }
  const std::size_t count = stl_triangle_count(content);
  const std::size_t expected = kStlHeaderBytes + kStlTriangleBytes * count;
  if (content.size() < expected) {
    throw_error("{}: byte {}: file ends early, {} triangles need {} bytes", name, content.size(),
                count, expected);
  }
  TriangleMesh mesh;
  CornerMerger merger(mesh);
  for (std::size_t triangle = 0; triangle < count; ++triangle) {
    const std::size_t start = kStlHeaderBytes + kStlTriangleBytes * triangle + 12;  // skip normal
    for (std::size_t corner = 0; corner < 3; ++corner) {
      std::array<float, 3> p{};
      std::memcpy(p.data(), content.data() + start + 12 * corner, sizeof(p));
      if (!std::isfinite(p[0]) || !std::isfinite(p[1]) || !std::isfinite(p[2])) {
        throw_error("{}: byte {}: corner of triangle {} is not finite", name, start + 12 * corner,
                    triangle);
      }
      merger.add(Eigen::Vector3f(p[0], p[1], p[2]).cast<double>());
    }
  }
  return mesh;
}

/// The ending decides; a file without one of the two is judged by its first bytes.
TriangleMesh parse_any(const std::string& name, std::string_view content) {
  if (content.starts_with("\xef\xbb\xbf")) content.remove_prefix(3);  // a byte order mark
  const bool binary_size =
      content.size() >= kStlHeaderBytes &&
      content.size() == kStlHeaderBytes + kStlTriangleBytes * stl_triangle_count(content);
  // Many programs write "solid" into the header of a binary file as well; text has no zeros.
  const bool text =
      content.substr(0, kStlHeaderBytes + kStlTriangleBytes).find('\0') == std::string_view::npos;
  std::string_view begin = content.substr(0, 1000);
  while (!begin.empty() && (is_space(begin.front()) || begin.front() == '\n'))
    begin.remove_prefix(1);
  const std::string first = in_small_letters(next_word(begin).substr(0, 5));
  const bool solid = text && (first == "solid" || first == "facet");
  if (has_ending(name, ".obj")) return parse_obj(name, content);
  if (binary_size) return parse_binary_stl(name, content);
  if (solid) return parse_ascii_stl(name, content);
  if (has_ending(name, ".stl") && text && content.size() >= kStlHeaderBytes)
    throw_error("{}:1: text that begins with {}, needed \"solid\", or a binary STL", name,
                quote(first));
  if (has_ending(name, ".stl")) return parse_binary_stl(name, content);
  return parse_obj(name, content);
}

/// Drops triangles with a repeated corner (they change neither surface nor closedness) and vertices
/// that no triangle uses (they would change the extent).
void drop_unused(TriangleMesh& mesh) {
  std::erase_if(mesh.triangles, [](const Eigen::Vector3i& t) {
    return t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
  });
  std::vector<int> renamed(mesh.vertices.size(), -1);
  std::vector<Eigen::Vector3d> kept;
  for (Eigen::Vector3i& triangle : mesh.triangles) {
    for (int& corner : triangle) {
      int& name = renamed[corner];
      if (name < 0) {
        name = static_cast<int>(kept.size());
        kept.push_back(mesh.vertices[corner]);
      }
      corner = name;
    }
  }
  mesh.vertices = std::move(kept);
}

void scale_to_metres(const std::string& name, TriangleMesh& mesh, double unit_m) {
  Eigen::AlignedBox3d box;
  for (Eigen::Vector3d& vertex : mesh.vertices) {
    vertex *= unit_m;
    box.extend(vertex);
  }
  const double largest = std::max(box.max().maxCoeff(), -box.min().minCoeff());
  const double extent = box.sizes().maxCoeff();
  if (!(largest <= kMaxExtent)) {
    throw_error("{}: reaches {:.4g} m with unit_m {:g}, allowed up to {:g} m: wrong unit_m?", name,
                largest, unit_m, kMaxExtent);
  }
  if (!(extent >= kMinExtent)) {
    throw_error("{}: is {:.4g} m long with unit_m {:g}, allowed from {:g} m: wrong unit_m?", name,
                extent, unit_m, kMinExtent);
  }
}

}  // namespace

TriangleMesh parse_mesh(const std::string& name, const std::string& content, double unit_m) {
  if (!(unit_m > 0) || !std::isfinite(unit_m)) {
    throw_error("{}: unit_m {:g} is not a positive length", name, unit_m);
  }
  if (content.empty()) throw_error("{}: file is empty", name);
  require_size(name, static_cast<std::int64_t>(content.size()));
  TriangleMesh mesh = parse_any(name, content);
  drop_unused(mesh);
  if (mesh.triangles.empty()) throw_error("{}: no triangles", name);
  scale_to_metres(name, mesh, unit_m);
  return mesh;
}

TriangleMesh load_mesh(const std::string& path, double unit_m, const std::string& wanted) {
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::ifstream file(path, std::ios::binary | std::ios::ate);
  if (!file) throw_error("{}: cannot be opened", path);
  const auto size = static_cast<std::int64_t>(file.tellg());
  if (size >= 0) require_size(path, size);
  std::string content(std::max<std::int64_t>(size, 0), '\0');
  file.seekg(0);
  if (!file.read(content.data(), size)) throw_error("{}: cannot be read", path);
  if (const std::string found = hex(sha256(std::as_bytes(std::span(content))));
      !wanted.empty() && found != wanted) {
    throw_error("{}: not the file that the run was begun with, sha256 {:.16} instead of {:.16}",
                path, found, wanted);
  }
  TriangleMesh mesh = parse_mesh(path, content, unit_m);
  if (mesh.triangles.size() > kManyTriangles) {
    log().warn(
        "event=large_mesh file={} triangles={} what is made of it takes long: tools for meshes "
        "thin it out",
        path, mesh.triangles.size());
  }
  return mesh;
}

TriangleMesh load_closed_mesh(const std::string& path, double unit_m) {
  TriangleMesh mesh = load_mesh(path, unit_m);
  require_closed(path, mesh);
  return mesh;
}

}  // namespace omentum

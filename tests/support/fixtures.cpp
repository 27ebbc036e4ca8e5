#include "tests/support/fixtures.h"

#include <fmt/core.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <fstream>
#include <iterator>
#include <map>
#include <numbers>
#include <stdexcept>

namespace omentum::test {
namespace {

constexpr double kPi = std::numbers::pi;

/// Distance of the outline from the middle, as a factor of the ellipse of 36 x 32 mm.
double outline(double angle) {
  return 1 + 0.10 * std::cos(2 * angle + 0.7) + 0.07 * std::cos(3 * angle - 1.1) +
         0.04 * std::sin(5 * angle);
}

Eigen::Vector3d pad_point(double angle, double radius, int side) {
  const double x = 35.7 * radius * outline(angle) * std::cos(angle);
  const double y = 32 * radius * outline(angle) * std::sin(angle);
  const double middle = 3.5 * (x / 40) * (x / 40) - 2.0 * y / 30 + 0.8 * std::sin(0.15 * x);
  const double half = std::sqrt(std::max(0.0, 1 - radius * radius)) *
                      (3.0 + (side > 0 ? 0.5 * std::sin(0.2 * x + 0.1 * y) : 0.0));
  return {12 + x, -7 + y, 3 + middle + side * half};
}

}  // namespace

TriangleMesh make_fat_pad_mm() {
  constexpr int kSectors = 40;
  constexpr int kRings = 9;  // of each side; the last one is the shared rim
  TriangleMesh mesh;
  // Index of a vertex: ring 0 is the middle point of a side, ring kRings the rim.
  const auto start = [&](int side) { return side > 0 ? 0 : 1 + (kRings - 1) * kSectors; };
  const int rim = 2 * (1 + (kRings - 1) * kSectors);
  const auto at = [&](int side, int ring, int sector) {
    if (ring == 0) return start(side);
    if (ring == kRings) return rim + sector % kSectors;
    return start(side) + 1 + (ring - 1) * kSectors + sector % kSectors;
  };
  const auto radius_of = [&](int ring) { return std::sin(0.5 * kPi * ring / kRings); };
  for (const int side : {1, -1}) {
    mesh.vertices.push_back(pad_point(0, 0, side));
    for (int ring = 1; ring < kRings; ++ring) {
      for (int k = 0; k < kSectors; ++k) {
        mesh.vertices.push_back(pad_point(2 * kPi * k / kSectors, radius_of(ring), side));
      }
    }
  }
  for (int k = 0; k < kSectors; ++k) {
    mesh.vertices.push_back(pad_point(2 * kPi * k / kSectors, 1, 1));
  }
  const auto add = [&](int side, int a, int b, int c) {
    if (side > 0) mesh.triangles.emplace_back(a, b, c);
    if (side < 0) mesh.triangles.emplace_back(a, c, b);
  };
  for (const int side : {1, -1}) {
    for (int k = 0; k < kSectors; ++k) {
      add(side, at(side, 0, 0), at(side, 1, k), at(side, 1, k + 1));
      for (int ring = 1; ring < kRings; ++ring) {
        add(side, at(side, ring, k), at(side, ring + 1, k), at(side, ring + 1, k + 1));
        add(side, at(side, ring, k), at(side, ring + 1, k + 1), at(side, ring, k + 1));
      }
    }
  }
  return mesh;
}

TriangleMesh make_organ_mm() {
  TriangleMesh mesh = make_ellipsoid_mesh({24, 31, 54}, 16, 32);
  for (Eigen::Vector3d& p : mesh.vertices) {
    // The dent: vertices around (-24, 0, 0) move inwards, at most 9 mm, without crossing the axis.
    const Eigen::Vector3d from_dent = p - Eigen::Vector3d(-24, 0, 0);
    p.x() += 9 * std::exp(-from_dent.squaredNorm() / (18.0 * 18.0));
  }
  return mesh;
}

TriangleMesh make_leaf_mm() {
  constexpr double kPitch = 4;
  constexpr int kRows = 15;
  TriangleMesh mesh;
  std::map<std::array<int, 2>, int> index;
  const auto place = [](const std::array<int, 2>& at) {
    const auto [i, j] = at;
    return Eigen::Vector2d(kPitch * (i + 0.5 * (j & 1)), kPitch * std::sqrt(0.75) * j);
  };
  const auto inside = [&](const std::array<int, 2>& at) {
    const Eigen::Vector2d p = place(at);
    const double oval = std::hypot(p.x() / 42, p.y() / 35);
    return oval <= 1 && std::hypot(p.x() - 16, p.y() - 8) >= 6;
  };
  const auto vertex = [&](const std::array<int, 2>& at) {
    const auto [found, fresh] = index.try_emplace(at, static_cast<int>(mesh.vertices.size()));
    if (fresh) {
      const Eigen::Vector2d p = place(at);
      const double height = 4 * (1 - std::pow(p.x() / 42, 2) - std::pow(p.y() / 35, 2));
      mesh.vertices.emplace_back(p.x() + 5, p.y() - 3, height);
    }
    return found->second;
  };
  for (int j = -kRows; j < kRows; ++j) {
    for (int i = -kRows; i < kRows; ++i) {
      const int up = i + (j & 1);  // right of (i, j) in the row above
      using Corner = std::array<int, 2>;
      for (const auto& corners :
           {std::array{Corner{i, j}, Corner{i + 1, j}, Corner{up, j + 1}},
            std::array{Corner{i, j}, Corner{up, j + 1}, Corner{up - 1, j + 1}}}) {
        if (!std::all_of(corners.begin(), corners.end(), inside)) continue;
        mesh.triangles.emplace_back(vertex(corners[0]), vertex(corners[1]), vertex(corners[2]));
      }
    }
  }
  return mesh;
}

std::string print_obj(const TriangleMesh& mesh, const std::string& comment) {
  std::string text = "# " + comment + "\n";
  for (const Eigen::Vector3d& p : mesh.vertices) {
    text += fmt::format("v {:.4f} {:.4f} {:.4f}\n", p.x(), p.y(), p.z());
  }
  for (const Eigen::Vector3i& t : mesh.triangles) {
    text += fmt::format("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
  }
  return text;
}

std::string print_binary_stl(const TriangleMesh& mesh) {
  std::string bytes = "binary STL made by make_fixtures";
  bytes.resize(80, ' ');
  const auto append = [&](const auto& value) {
    std::array<char, sizeof(value)> raw{};
    std::memcpy(raw.data(), &value, sizeof(value));
    bytes.append(raw.data(), raw.size());
  };
  append(static_cast<std::uint32_t>(mesh.triangles.size()));
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const auto vertex = [&](int k) { return mesh.vertices[static_cast<std::size_t>(t[k])]; };
    const Eigen::Vector3d normal =
        (vertex(1) - vertex(0)).cross(vertex(2) - vertex(0)).normalized();
    for (const double value : normal) append(static_cast<float>(value));
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d p = vertex(k);
      for (const double value : p) append(static_cast<float>(value));
    }
    append(std::uint16_t{0});
  }
  return bytes;
}

std::string print_ascii_stl(const TriangleMesh& mesh) {
  std::string text = "solid fixture\n";
  for (const Eigen::Vector3i& t : mesh.triangles) {
    text += "facet normal 0 0 0\nouter loop\n";
    for (int k = 0; k < 3; ++k) {
      const Eigen::Vector3d& p = mesh.vertices[static_cast<std::size_t>(t[k])];
      text += fmt::format("vertex {:.6g} {:.6g} {:.6g}\n", p.x(), p.y(), p.z());
    }
    text += "endloop\nendfacet\n";
  }
  return text + "endsolid fixture\n";
}

std::string read_bytes(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw std::runtime_error("cannot read " + path);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void write_bytes(const std::string& path, const std::string& content) {
  std::ofstream file(path, std::ios::binary);
  file.write(content.data(), static_cast<std::streamsize>(content.size()));
  if (!file) throw std::runtime_error("cannot write " + path);
}

}  // namespace omentum::test

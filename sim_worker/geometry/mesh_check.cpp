#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numeric>

#include "core/check.h"
#include "sim_worker/geometry/mesh.h"

namespace omentum {
namespace {

constexpr double kMinSliver = 0.02;  // height over longest edge

struct DirectedEdge {
  int from, to;
  std::size_t triangle;
  auto operator<=>(const DirectedEdge&) const = default;
};

std::string place(const TriangleMesh& mesh, int vertex) {
  const Eigen::Vector3d& p = mesh.vertices[vertex];
  return fmt::format("({:.5g}, {:.5g}, {:.5g}) m", p.x(), p.y(), p.z());
}

Eigen::Vector3d normal_of(const TriangleMesh& mesh, std::size_t triangle) {
  const Eigen::Vector3i& c = mesh.triangles[triangle];
  const Eigen::Vector3d& a = mesh.vertices[c[0]];
  return (mesh.vertices[c[1]] - a).cross(mesh.vertices[c[2]] - a).normalized();
}

/// The first of these sorted edges that leads so; null if none does.
const DirectedEdge* find_edge(const std::vector<DirectedEdge>& edges, int from, int to) {
  const auto found = std::lower_bound(edges.begin(), edges.end(), DirectedEdge{from, to, 0});
  return found != edges.end() && found->from == from && found->to == to ? &*found : nullptr;
}

/// Directed edges of all triangles, ascending; throws Error for one that two triangles have.
std::vector<DirectedEdge> sort_edges(const std::string& name, const TriangleMesh& mesh) {
  std::vector<DirectedEdge> edges;
  edges.reserve(3 * mesh.triangles.size());
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3i& c = mesh.triangles[t];
    for (int k = 0; k < 3; ++k) edges.push_back({c[k], c[(k + 1) % 3], t});
  }
  std::sort(edges.begin(), edges.end());
  for (std::size_t k = 1; k < edges.size(); ++k) {
    const DirectedEdge& edge = edges[k];
    if (edges[k - 1].from != edge.from || edges[k - 1].to != edge.to) continue;
    const std::string where =
        fmt::format("{}: edge from {} to {}", name, place(mesh, edge.from), place(mesh, edge.to));
    if (find_edge(edges, edge.to, edge.from) != nullptr) {
      throw_error(
          "{} belongs to more than two triangles, {} and {} among them: the surface is "
          "folded onto itself or given twice",
          where, edges[k - 1].triangle, edge.triangle);
    }
    throw_error("{} is used twice in the same direction by triangles {} and {}", where,
                edges[k - 1].triangle, edge.triangle);
  }
  return edges;
}

}  // namespace

namespace {

/// Vertices of equal coordinates become one; false where there are none. Triangles that shrink to
/// an edge go.
bool merge_equal_vertices(TriangleMesh& mesh) {
  std::map<std::array<double, 3>, int> places;
  std::vector<int> renamed;
  std::vector<Eigen::Vector3d> kept;
  for (const Eigen::Vector3d& p : mesh.vertices) {
    const std::array<double, 3> key = {p.x() + 0.0, p.y() + 0.0, p.z() + 0.0};  // -0 becomes +0
    const auto [found, added] = places.try_emplace(key, static_cast<int>(kept.size()));
    if (added) kept.push_back(p);
    renamed.push_back(found->second);
  }
  if (kept.size() == mesh.vertices.size()) return false;
  for (Eigen::Vector3i& t : mesh.triangles) t = {renamed[t[0]], renamed[t[1]], renamed[t[2]]};
  std::erase_if(mesh.triangles, [](const Eigen::Vector3i& t) {
    return t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
  });
  mesh.vertices = std::move(kept);
  return true;
}

/// Checks a mesh as it is, and where that fails once more with equal vertices merged. A cut whose
/// sides touch stays a cut where the mesh is good with it.
template <typename Check>
void check_also_merged(TriangleMesh& mesh, Check check) {
  try {
    return check(mesh);
  } catch (const Error&) {
    TriangleMesh merged = mesh;
    if (!merge_equal_vertices(merged) || merged.triangles.empty()) throw;
    try {
      check(merged);
    } catch (const Error& error) {
      throw_error("{} (vertices that stand several times at one place count as one)", error.what());
    }
    mesh = std::move(merged);
  }
}

void check_closed(const std::string& name, const TriangleMesh& mesh) {
  const std::vector<DirectedEdge> edges = sort_edges(name, mesh);
  for (const DirectedEdge& edge : edges) {
    if (find_edge(edges, edge.to, edge.from) == nullptr) {
      throw_error("{}: not closed, triangle {} has no neighbour at the edge from {} to {}", name,
                  edge.triangle, place(mesh, edge.from), place(mesh, edge.to));
    }
  }
  if (!(std::abs(signed_volume(mesh)) > 0)) throw_error("{}: encloses no volume", name);
}

void check_sheet(const std::string& name, const TriangleMesh& mesh) {
  const std::vector<DirectedEdge> edges = sort_edges(name, mesh);
  for (std::size_t t = 0; t < mesh.triangles.size(); ++t) {
    const Eigen::Vector3i& c = mesh.triangles[t];
    const Eigen::Vector3d& a = mesh.vertices[c[0]];
    const Eigen::Vector3d b = mesh.vertices[c[1]] - a;
    const Eigen::Vector3d d = mesh.vertices[c[2]] - a;
    const double longest = std::max({b.squaredNorm(), d.squaredNorm(), (b - d).squaredNorm()});
    if (!(b.cross(d).norm() >= kMinSliver * longest)) {
      throw_error("{}: triangle {} at {} is a sliver, allowed from {} of its longest edge high",
                  name, t, place(mesh, c[0]), kMinSliver);
    }
  }
  // Folded by more than a right angle it has no tangent plane there, in which it could bend.
  for (const DirectedEdge& edge : edges) {
    const DirectedEdge* other = find_edge(edges, edge.to, edge.from);
    if (other == nullptr) continue;
    if (normal_of(mesh, edge.triangle).dot(normal_of(mesh, other->triangle)) >= 0) continue;
    throw_error("{}: folded by more than 90 deg along the edge from {} to {}", name,
                place(mesh, edge.from), place(mesh, edge.to));
  }
  // A vertex on the rim of one fan of triangles starts one edge of a rim, not two.
  std::vector<int> rims(mesh.vertices.size(), 0);
  for (const DirectedEdge& edge : edges) {
    if (find_edge(edges, edge.to, edge.from) != nullptr) continue;
    if (++rims[edge.from] > 1) {
      throw_error("{}: parts of the sheet meet in the single vertex {}", name,
                  place(mesh, edge.from));
    }
  }
  std::vector<int> parent(mesh.vertices.size());  // towards one vertex of each piece
  std::iota(parent.begin(), parent.end(), 0);
  const auto piece_of = [&parent](int vertex) {
    while (parent[vertex] != vertex) vertex = parent[vertex] = parent[parent[vertex]];
    return vertex;
  };
  for (const DirectedEdge& edge : edges) parent[piece_of(edge.from)] = piece_of(edge.to);
  const int first = mesh.triangles.front()[0];
  for (int i = 0; i < static_cast<int>(parent.size()); ++i) {
    if (piece_of(i) == piece_of(first)) continue;
    throw_error("{}: {} does not hang together with {}, allowed one piece", name, place(mesh, i),
                place(mesh, first));
  }
}

}  // namespace

void require_closed(const std::string& name, TriangleMesh& mesh) {
  check_also_merged(mesh, [&name](const TriangleMesh& m) { check_closed(name, m); });
  if (signed_volume(mesh) > 0) return;
  for (Eigen::Vector3i& triangle : mesh.triangles) std::swap(triangle[1], triangle[2]);
}

void require_sheet(const std::string& name, TriangleMesh& mesh) {
  check_also_merged(mesh, [&name](const TriangleMesh& m) { check_sheet(name, m); });
}

double signed_volume(const TriangleMesh& mesh) {
  // Divergence theorem, relative to the first vertex so that a far-off mesh loses no digits.
  if (mesh.vertices.empty()) return 0;
  const Eigen::Vector3d origin = mesh.vertices.front();
  double sum = 0;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[t[0]] - origin;
    sum += a.dot((mesh.vertices[t[1]] - origin).cross(mesh.vertices[t[2]] - origin));
  }
  return sum / 6;
}

}  // namespace omentum

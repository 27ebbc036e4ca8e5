#include "sim_worker/geometry/solid_mesh.h"

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "core/check.h"
#include "core/scratch_folder.h"

namespace omentum {
namespace {

using Eigen::Vector3d;
using Eigen::Vector3i;
namespace fs = std::filesystem;

constexpr int kMaxNodes = 200'000;

void write_obj(const TriangleMesh& mesh, const fs::path& path) {
  std::ofstream out(path);
  out.precision(17);
  for (const Vector3d& v : mesh.vertices) {
    out << "v " << v.x() << " " << v.y() << " " << v.z() << "\n";
  }
  for (const Vector3i& t : mesh.triangles) {
    out << "f " << t.x() + 1 << " " << t.y() + 1 << " " << t.z() + 1 << "\n";
  }
  out.flush();
  if (!out) throw_error("{}: cannot be written", path.string());
}

/// Runs the mesher and waits for it; false where it failed, with a message on stderr.
bool run_mesher(const fs::path& input, const fs::path& output, double edge_length) {
  const fs::path program = fs::read_symlink("/proc/self/exe").parent_path() / "solid_mesher";
  if (!fs::exists(program)) throw_error("{}: not built", program.string());
  std::vector<std::string> words = {
      program.string(), input.string(),  "-o",
      output.string(),  "--edge-length", fmt::format("{:.17g}", edge_length)};
  std::vector<char*> arguments;
  for (std::string& word : words) arguments.push_back(word.data());
  arguments.push_back(nullptr);
  pid_t child = 0;
  if (posix_spawn(&child, program.c_str(), nullptr, nullptr, arguments.data(), environ) != 0) {
    throw_error("{}: cannot be started", program.string());
  }
  int status = 0;
  while (waitpid(child, &status, 0) < 0 && errno == EINTR) {
  }
  return WIFEXITED(status) && WEXITSTATUS(status) == 0;
}

void add_middles(SolidMesh& mesh) {
  std::map<std::array<std::int32_t, 2>, std::int32_t> middle_of;
  for (auto& tetrahedron : mesh.tetrahedra) {
    for (std::size_t k = 0; k < 6; ++k) {
      const auto [a, b] =
          std::minmax({tetrahedron[kSolidEdge[k][0]], tetrahedron[kSolidEdge[k][1]]});
      const auto [at, added] =
          middle_of.try_emplace({a, b}, static_cast<std::int32_t>(mesh.nodes.size()));
      if (added) mesh.nodes.push_back(0.5 * (mesh.nodes[a] + mesh.nodes[b]));
      tetrahedron[4 + k] = at->second;
    }
  }
}

/// Fills mesh.surface.
void add_surface(SolidMesh& mesh) {
  // Corners of the four faces, then the middles of their edges 0-1, 1-2, 2-0.
  constexpr std::size_t kFace[4][6] = {
      {0, 2, 1, 6, 5, 4}, {0, 1, 3, 4, 8, 7}, {1, 2, 3, 5, 9, 8}, {0, 3, 2, 7, 9, 6}};
  std::map<std::array<std::int32_t, 3>, int> seen;
  const auto key = [](const std::array<std::int32_t, 10>& t, const std::size_t* face) {
    std::array<std::int32_t, 3> corners = {t[face[0]], t[face[1]], t[face[2]]};
    std::sort(corners.begin(), corners.end());
    return corners;
  };
  for (const auto& t : mesh.tetrahedra) {
    for (const auto& face : kFace) ++seen[key(t, face)];
  }
  for (const auto& t : mesh.tetrahedra) {
    for (const auto& face : kFace) {
      if (seen[key(t, face)] != 1) continue;
      std::array<std::int32_t, 6> n{};
      for (std::size_t k = 0; k < 6; ++k) n[k] = t[face[k]];
      mesh.surface.emplace_back(n[0], n[3], n[5]);
      mesh.surface.emplace_back(n[3], n[1], n[4]);
      mesh.surface.emplace_back(n[5], n[4], n[2]);
      mesh.surface.emplace_back(n[3], n[4], n[5]);
    }
  }
}

}  // namespace

double tetrahedron_volume(const SolidMesh& mesh, const std::array<std::int32_t, 10>& t) {
  const auto node = [&](std::size_t k) { return mesh.nodes[t[k]]; };
  return (node(1) - node(0)).cross(node(2) - node(0)).dot(node(3) - node(0)) / 6;
}

SolidMesh parse_solid_mesh(const std::string& name, const std::string& content) {
  std::istringstream in(content);
  std::string word_nodes;
  std::string word_tetrahedra;
  int nodes = 0;
  int tetrahedra = 0;
  if (!(in >> word_nodes >> nodes >> word_tetrahedra >> tetrahedra) || word_nodes != "nodes" ||
      word_tetrahedra != "tetrahedra") {
    throw_error("{}:1: no line 'nodes N tetrahedra M'", name);
  }
  if (nodes < 4 || nodes > kMaxNodes || tetrahedra < 1 || tetrahedra > 10 * kMaxNodes) {
    throw_error("{}:1: {} nodes and {} tetrahedra, allowed 4 ... {} and 1 ... {}", name, nodes,
                tetrahedra, kMaxNodes, 10 * kMaxNodes);
  }
  SolidMesh mesh;
  for (int i = 0; i < nodes; ++i) {
    Vector3d p;
    if (!(in >> p.x() >> p.y() >> p.z()) || !p.allFinite()) {
      throw_error("{}:{}: no position of node {}", name, i + 2, i);
    }
    mesh.nodes.push_back(p);
  }
  for (int t = 0; t < tetrahedra; ++t) {
    std::array<std::int32_t, 10> corners{};
    for (std::size_t k = 0; k < 4; ++k) {
      if (!(in >> corners[k]) || corners[k] < 0 || corners[k] >= nodes) {
        throw_error("{}:{}: no four nodes of 0 ... {}", name, nodes + t + 2, nodes - 1);
      }
    }
    const double volume = tetrahedron_volume(mesh, corners);
    if (volume < 0) std::swap(corners[2], corners[3]);
    double longest = 0;
    for (const auto& edge : kSolidEdge) {
      const Vector3d& a = mesh.nodes[corners[edge[0]]];
      longest = std::max(longest, (mesh.nodes[corners[edge[1]]] - a).norm());
    }
    constexpr double kFlat = 1e-9;  // of the cube of its longest edge: rounding has either sign
    if (!(std::abs(volume) > kFlat * longest * longest * longest))
      throw_error("{}:{}: a tetrahedron without volume", name, nodes + t + 2);
    mesh.tetrahedra.push_back(corners);
  }
  add_middles(mesh);
  add_surface(mesh);
  return mesh;
}

SolidMesh fill_mesh(const TriangleMesh& surface, const std::string& name, double edge_length) {
  const ScratchFolder scratch;
  const fs::path input = scratch.path() / "surface.obj";
  const fs::path output = scratch.path() / "solid.txt";
  write_obj(surface, input);
  if (!run_mesher(input, output, edge_length)) {
    throw_error("{}: cannot be filled with tetrahedra of {} m", name, edge_length);
  }
  std::ifstream file(output, std::ios::binary);
  std::ostringstream text;
  text << file.rdbuf();
  return parse_solid_mesh(output.string(), text.str());
}

}  // namespace omentum

// solid_mesher: fills a closed triangle mesh with tetrahedra. A program of its own, so that the
// mesh generator (Netgen [Schoeberl97], LGPL) stays out of the workers and cannot take one down.
#include <fcntl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <fstream>
#include <string>

#include "core/command_line.h"
#include "core/printable.h"
#include "sim_worker/geometry/mesh.h"

namespace nglib {
#include <nglib.h>
}

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

/// Netgen merges points by absolute distances made for millimetres.
constexpr double kMillimetre = 1000;

/// Netgen logs on stdout.
void silence_stdout() {
  std::fflush(stdout);
  const int null = open("/dev/null", O_WRONLY | O_CLOEXEC);
  if (null >= 0) dup2(null, STDOUT_FILENO);
}

void write_mesh(nglib::Ng_Mesh* mesh, const std::string& path) {
  std::ofstream out(path);
  out.precision(17);
  out << "nodes " << nglib::Ng_GetNP(mesh) << " tetrahedra " << nglib::Ng_GetNE(mesh) << "\n";
  for (int i = 1; i <= nglib::Ng_GetNP(mesh); ++i) {
    double p[3];
    nglib::Ng_GetPoint(mesh, i, p);
    out << p[0] / kMillimetre << " " << p[1] / kMillimetre << " " << p[2] / kMillimetre << "\n";
  }
  for (int t = 1; t <= nglib::Ng_GetNE(mesh); ++t) {
    int node[10];
    if (nglib::Ng_GetVolumeElement(mesh, t, node) != nglib::NG_TET) {
      throw_error("{}: the mesher made an element that is no tetrahedron", path);
    }
    out << node[0] - 1 << " " << node[1] - 1 << " " << node[2] - 1 << " " << node[3] - 1 << "\n";
  }
  out.flush();
  if (!out) throw_error("{}: cannot be written", path);
}

void fill(const TriangleMesh& surface, const std::string& name, double edge_length,
          const std::string& output) {
  silence_stdout();
  nglib::Ng_Init();
  nglib::Ng_STL_Geometry* geometry = nglib::Ng_STL_NewGeometry();
  for (const Eigen::Vector3i& t : surface.triangles) {
    Eigen::Vector3d corner[3];
    for (int k = 0; k < 3; ++k) {
      corner[k] = kMillimetre * surface.vertices[t[k]];
    }
    nglib::Ng_STL_AddTriangle(geometry, corner[0].data(), corner[1].data(), corner[2].data());
  }
  nglib::Ng_Meshing_Parameters parameters;
  parameters.maxh = kMillimetre * edge_length;
  parameters.second_order = 0;
  nglib::Ng_Mesh* mesh = nglib::Ng_NewMesh();
  if (nglib::Ng_STL_InitSTLGeometry(geometry) != nglib::NG_OK ||
      nglib::Ng_STL_MakeEdges(geometry, mesh, &parameters) != nglib::NG_OK ||
      nglib::Ng_STL_GenerateSurfaceMesh(geometry, mesh, &parameters) != nglib::NG_OK ||
      nglib::Ng_GenerateVolumeMesh(mesh, &parameters) != nglib::NG_OK ||
      nglib::Ng_GetNE(mesh) == 0) {
    throw_error("{}: cannot be filled with tetrahedra of {} m", name, edge_length);
  }
  write_mesh(mesh, output);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    CLI::App app{
        "Fills a closed triangle mesh with tetrahedra.\n"
        "Exit codes: 0 done, 2 wrong option or a mesh that cannot be filled."};
    std::string input;
    std::string output;
    double edge_length = 0.005;
    double unit = 1;
    app.add_option("mesh", input, "OBJ or STL, closed")->required();
    app.add_option("-o,--output", output, "text: nodes [m], then four nodes per tetrahedron")
        ->required();
    app.add_option("--edge-length", edge_length, "largest edge [m]")
        ->check(CLI::Range(1e-4, 1.0))
        ->capture_default_str();
    app.add_option("--unit", unit, "metres per unit of the file")
        ->check(CLI::Range(1e-6, 1e3))
        ->capture_default_str();
    if (const std::optional<int> code = parse_command_line(app, argc, argv)) return *code;
    fill(load_closed_mesh(input, unit), input, edge_length, output);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "solid_mesher: %s\n", omentum::printable(error.what()).c_str());
    return 2;
  }
  return 0;
}

#include <cstddef>
#include <cstdint>
#include <string>

#include "core/check.h"
#include "sim_worker/geometry/mesh.h"
#include "sim_worker/geometry/sheet_mesh.h"
#include "sim_worker/geometry/solid_mesh.h"

// Any bytes give a mesh or an Error, under every reader: nothing else may leave parse_mesh,
// measure_sheet and parse_solid_mesh.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string content(reinterpret_cast<const char*>(data), size);
  for (const char* name : {"fuzz", "fuzz.obj", "fuzz.stl"}) {
    try {
      omentum::TriangleMesh mesh = omentum::parse_mesh(name, content, 1);
      omentum::require_sheet(name, mesh);
      omentum::measure_sheet(name, mesh.vertices, mesh.triangles);
    } catch (const omentum::Error&) {
    }
    try {
      omentum::TriangleMesh mesh = omentum::parse_mesh(name, content, 1);
      omentum::require_closed(name, mesh);
      if (!(omentum::signed_volume(mesh) > 0)) __builtin_trap();
    } catch (const omentum::Error&) {
    }
  }
  try {
    const omentum::SolidMesh solid = omentum::parse_solid_mesh("fuzz", content);
    for (const auto& tetrahedron : solid.tetrahedra) {
      if (!(omentum::tetrahedron_volume(solid, tetrahedron) > 0)) __builtin_trap();
    }
  } catch (const omentum::Error&) {
  }
  return 0;
}

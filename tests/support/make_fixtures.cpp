// Writes the meshes of tests/fixtures/ and the seeds of tests/fuzz/corpus/mesh/. Usage:
// make_fixtures <tests folder>

#include <fmt/core.h>

#include <cstdio>
#include <string>

#include "tests/support/fixtures.h"

namespace {

using omentum::TriangleMesh;
using omentum::test::print_obj;
using omentum::test::write_bytes;

void write_mesh_corpus(const std::string& folder) {
  TriangleMesh box = omentum::make_box_mesh({0.01, 0.02, 0.03});
  const std::string closed = print_obj(box, "closed box, metres");
  write_bytes(folder + "/closed.obj", closed);
  write_bytes(folder + "/truncated.obj", closed.substr(0, closed.size() * 2 / 3));
  write_bytes(folder + "/nan.obj", "v 0 0 0\nv nan 1 0\nv 0 1 inf\nf 1 2 3\n");
  write_bytes(folder + "/huge.obj", "v 0 0 0\nv 1e300 0 0\nv 0 1e300 0\nf 1 2 3\n");
  write_bytes(folder + "/index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n");
  write_bytes(
      folder + "/polygon.obj",
      "o quad\nv 0 0 0\nv .1 0 0\nv .1 .1 0\nv 0 .1 0\nvt 0 0\nvn 0 0 1\nf -4/1/1 -3//1 -2 -1\n");
  write_bytes(folder + "/empty.obj", "");
  write_bytes(folder + "/stl_truncated.stl", omentum::test::print_binary_stl(box).substr(0, 200));
  write_bytes(folder + "/stl_binary.stl", omentum::test::print_binary_stl(box));
  write_bytes(folder + "/stl_ascii.stl", omentum::test::print_ascii_stl(box));
  TriangleMesh turned = box;
  for (Eigen::Vector3i& t : turned.triangles) std::swap(t[0], t[1]);
  write_bytes(folder + "/inside_out.obj", print_obj(turned, "faces inside"));
  TriangleMesh open = box;
  open.triangles.pop_back();
  write_bytes(folder + "/open.obj", print_obj(open, "one triangle missing"));
  for (Eigen::Vector3d& p : box.vertices) p *= 1000;
  write_bytes(folder + "/wrong_unit.obj", print_obj(box, "millimetres read as metres"));
}

}  // namespace

int main(int count, char** arguments) {
  if (count != 2) {
    fmt::print(stderr, "usage: make_fixtures <tests folder>\n");
    return 2;
  }
  const std::string folder = arguments[1];
  write_bytes(folder + "/fixtures/fat_pad.obj",
              print_obj(omentum::test::make_fat_pad_mm(),
                        "fat pad, millimetres, made by tests/support/make_fixtures.cpp"));
  write_bytes(folder + "/fixtures/organ.stl",
              omentum::test::print_binary_stl(omentum::test::make_organ_mm()));
  write_bytes(folder + "/fixtures/leaf.obj",
              print_obj(omentum::test::make_leaf_mm(),
                        "leaf of omentum, millimetres, made by tests/support/make_fixtures.cpp"));
  write_mesh_corpus(folder + "/fuzz/corpus/mesh");
  return 0;
}

#pragma once

#include <string>

#include "sim_worker/geometry/mesh.h"

// Meshes made by our own formulas for tests. The files under tests/fixtures/ are printed from here
// by the program make_fixtures; the test Fixtures.AreWhatTheGeneratorMakes compares the two.

namespace omentum::test {

/// A fat pad that is neither flat nor square nor centred: a lens with a lobed outline and a bent
/// middle surface, about 80 x 60 mm and 6 mm thick, closed, 1,360 triangles, centre near (12, -7,
/// 3) mm. In millimetres.
TriangleMesh make_fat_pad_mm();

/// An organ: an ellipsoid of 48 x 62 x 108 mm with a dent on one side, 1,024 triangles, centred. In
/// millimetres.
TriangleMesh make_organ_mm();

/// The middle surface of a leaf of omentum: an oval of 84 x 70 mm around (5, -3) mm with a hole of
/// 12 mm, 4 mm high in the middle, on a lattice of equilateral triangles of 4 mm. In millimetres.
TriangleMesh make_leaf_mm();

std::string print_obj(const TriangleMesh& mesh, const std::string& comment);
std::string print_binary_stl(const TriangleMesh& mesh);
std::string print_ascii_stl(const TriangleMesh& mesh);

/// Whole content of a file; fails the test (through an exception) if it cannot be read.
std::string read_bytes(const std::string& path);
void write_bytes(const std::string& path, const std::string& content);

}  // namespace omentum::test

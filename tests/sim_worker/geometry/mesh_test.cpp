#include "sim_worker/geometry/mesh.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <numbers>
#include <random>

#include "core/check.h"
#include "tests/support/fixtures.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace omentum {
namespace {

using test::make_fat_pad_mm;
using test::make_leaf_mm;
using test::make_organ_mm;
using testing::HasSubstr;

const std::string kTests = OMENTUM_TESTS_DIR;

std::string error_of(const std::string& name, const std::string& content, double unit_m = 1) {
  try {
    TriangleMesh mesh = parse_mesh(name, content, unit_m);
    require_closed(name, mesh);
  } catch (const Error& error) {
    return error.what();
  }
  return "";
}

TriangleMesh scaled(TriangleMesh mesh, double factor) {
  for (Eigen::Vector3d& p : mesh.vertices) p *= factor;
  return mesh;
}

/// Distance by looking at every triangle, by least squares on each triangle: the oracle of the
/// tree.
double brute_force_distance(const TriangleMesh& mesh, const Eigen::Vector3d& p) {
  double best = 1e300;
  for (const Eigen::Vector3i& t : mesh.triangles) {
    const Eigen::Vector3d a = mesh.vertices[static_cast<std::size_t>(t[0])];
    const Eigen::Vector3d u = mesh.vertices[static_cast<std::size_t>(t[1])] - a;
    const Eigen::Vector3d v = mesh.vertices[static_cast<std::size_t>(t[2])] - a;
    // Minimise |a + s u + r v - p| over the triangle: interior first, then the three edges.
    Eigen::Matrix2d gram;
    gram << u.dot(u), u.dot(v), u.dot(v), v.dot(v);
    const Eigen::Vector2d solution = gram.inverse() * Eigen::Vector2d(u.dot(p - a), v.dot(p - a));
    if (solution.minCoeff() >= 0 && solution.sum() <= 1) {
      best = std::min(best, (a + solution[0] * u + solution[1] * v - p).norm());
    }
    for (const auto& [from, to] :
         {std::pair<Eigen::Vector3d, Eigen::Vector3d>{a, a + u}, {a + u, a + v}, {a + v, a}}) {
      const Eigen::Vector3d edge = to - from;
      const double s = std::clamp(edge.dot(p - from) / edge.squaredNorm(), 0.0, 1.0);
      best = std::min(best, (from + s * edge - p).norm());
    }
  }
  return best;
}

TEST(Mesh, VolumesOfKnownShapes) {
  EXPECT_DOUBLE_EQ(signed_volume(make_box_mesh({0.01, 0.02, 0.03})), 8 * 6e-6);
  // Inscribed: 1.4 % small at 32 x 64.
  const double ball = 4.0 / 3 * std::numbers::pi * 1e-6;
  EXPECT_NEAR(signed_volume(make_ellipsoid_mesh({0.01, 0.01, 0.01}, 32, 64)) / ball, 1, 0.015);
  const double capsule = ball + std::numbers::pi * 1e-4 * 0.05;
  EXPECT_NEAR(signed_volume(make_capsule_mesh({0, 0, 0}, {0.03, 0.04, 0}, 0.01, 64)) / capsule, 1,
              0.01);  // inscribed
}

TEST(Mesh, TessellationsAreClosed) {
  for (TriangleMesh mesh :
       {make_box_mesh({1, 2, 3}), make_ellipsoid_mesh({1, 2, 3}, 7, 9),
        make_capsule_mesh({0, 0, 0}, {1, 1, 1}, 0.2, 12),
        make_capsule_mesh({1, 0, 0}, {1, 0, 0}, 1, 3), make_fat_pad_mm(), make_organ_mm()}) {
    const TriangleMesh before = mesh;
    EXPECT_NO_THROW(require_closed("shape", mesh));
    EXPECT_EQ(mesh.triangles, before.triangles) << "was inside out";
  }
}

TEST(Mesh, VolumeDoesNotDependOnPlace) {
  TriangleMesh mesh = make_organ_mm();
  const double volume = signed_volume(mesh);
  for (Eigen::Vector3d& p : mesh.vertices) p += Eigen::Vector3d(1e5, -2e5, 3e5);
  EXPECT_NEAR(signed_volume(mesh) / volume, 1, 1e-9);  // coordinates keep 11 digits after the shift
}

TEST(Mesh, ObjRoundTripInMillimetres) {
  const TriangleMesh pad = make_fat_pad_mm();
  const TriangleMesh read = parse_mesh("pad.obj", test::print_obj(pad, "test"), 0.001);
  ASSERT_EQ(read.triangles.size(), pad.triangles.size());
  EXPECT_NEAR(signed_volume(read) * 1e9 / signed_volume(pad), 1, 1e-4);  // four decimals of a mm
}

TEST(Mesh, StlMergesCorners) {
  const TriangleMesh organ = make_organ_mm();
  for (const std::string& bytes : {test::print_binary_stl(organ), test::print_ascii_stl(organ)}) {
    TriangleMesh read = parse_mesh("organ.stl", bytes, 0.001);
    EXPECT_EQ(read.vertices.size(), organ.vertices.size());
    EXPECT_EQ(read.triangles.size(), organ.triangles.size());
    EXPECT_NO_THROW(require_closed("organ", read));
  }
}

TEST(Mesh, PolygonsAreFannedAndNegativeIndicesCountBack) {
  const TriangleMesh mesh = parse_mesh(
      "quad.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 5 5 5\nf -5/1/1 -4//1 -3 4 # quad\n", 0.1);
  EXPECT_EQ(mesh.triangles.size(), 2);
  EXPECT_EQ(mesh.vertices.size(), 4) << "the vertex without a triangle is dropped";
  EXPECT_NEAR(mesh.vertices[2].x(), 0.1, 1e-15);
}

TEST(Mesh, InsideOutIsTurned) {
  TriangleMesh mesh = make_box_mesh({1, 1, 1});
  for (Eigen::Vector3i& t : mesh.triangles) std::swap(t[0], t[1]);
  EXPECT_LT(signed_volume(mesh), 0);
  require_closed("box", mesh);
  EXPECT_DOUBLE_EQ(signed_volume(mesh), 8);
}

TEST(Mesh, ErrorsNameFileAndLine) {
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\nv 0 x 0\n"),
              HasSubstr("a.obj:2: coordinate \"x\" is not a number"));
  EXPECT_THAT(error_of("a.obj", "v 0 0 nan\n"),
              HasSubstr("a.obj:1: coordinate \"nan\" is not finite"));
  EXPECT_THAT(error_of("a.obj", "v 0 0\n"), HasSubstr("a.obj:1: vertex with fewer than three"));
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\nf 1 2 3\n"),
              HasSubstr("a.obj:2: face corner \"2\" is outside the 1"));
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\nf 1 0 1\n"),
              HasSubstr("face corner \"0\" is not a vertex index"));
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\nf 1 1\n"),
              HasSubstr("a.obj:2: face with fewer than three"));
  EXPECT_THAT(error_of("a.obj", "hello\n"),
              HasSubstr("a.obj:1: \"hello\" is not a line of an OBJ file"));
  EXPECT_THAT(error_of("a.obj", ""), HasSubstr("a.obj: file is empty"));
  EXPECT_THAT(error_of("a.obj", "v 0 0 0\n"), HasSubstr("a.obj: no triangles"));
  EXPECT_THAT(error_of("a.stl", "short"),
              HasSubstr("a.stl: byte 5: file ends inside the STL header"));
  const std::string stl = test::print_binary_stl(make_box_mesh({1, 1, 1}));
  EXPECT_THAT(error_of("a.stl", stl.substr(0, 300)),
              HasSubstr("byte 300: file ends early, 12 triangles need 684"));
  std::string solid = stl;  // many programs begin the header of a binary file like that
  solid.replace(0, 5, "solid");
  EXPECT_THAT(error_of("a.stl", solid.substr(0, 300)),
              HasSubstr("byte 300: file ends early, 12 triangles need 684"));
  const std::string ascii = test::print_ascii_stl(make_box_mesh({1, 1, 1}));
  EXPECT_THAT(error_of("a.stl", ascii.substr(0, ascii.find("endfacet"))),
              HasSubstr("file ends before endsolid"));
}

TEST(Mesh, VerticesOfEachFaceAreOneWhereTheyStandAtOnePlace) {
  const TriangleMesh box = make_box_mesh({1, 1, 1});
  std::string obj;
  for (const Eigen::Vector3i& t : box.triangles) {
    for (const int corner : t) {
      const Eigen::Vector3d& p = box.vertices[static_cast<std::size_t>(corner)];
      obj += fmt::format("v {} {} {}\n", p.x(), p.y(), p.z());
    }
    obj += "f -3 -2 -1\n";
  }
  EXPECT_EQ(error_of("a.obj", obj), "");
  obj.resize(obj.size() - 11);  // the last face
  EXPECT_THAT(error_of("a.obj", obj),
              AllOf(HasSubstr("not closed"), HasSubstr("stand several times at one place")));
}

TEST(Mesh, LinesGoOnBehindABackslashAndOthersStatementsArePassedOver) {
  const std::string box = test::print_obj(make_box_mesh({1, 1, 1}), "");
  std::string continued;
  for (const char c : box) continued += c == ' ' ? std::string(" \\\r\n") : std::string(1, c);
  EXPECT_EQ(error_of("a.obj", continued), "");
  EXPECT_EQ(error_of("a.obj", "lod 3\nx_my_program 1 2\n" + box), "");
  EXPECT_THAT(error_of("a.obj", box + "surf 0 1 0 1 1 2\n"), HasSubstr("no polygons"));
  EXPECT_THAT(error_of("a.obj", box + "\x01\x02\n"), HasSubstr("is not a line of an OBJ file"));
}

TEST(Mesh, StlOfOtherDialectsIsRead) {
  std::string ascii = test::print_ascii_stl(make_box_mesh({1, 1, 1}));
  std::string upper, parted = "\n \n";
  for (const char c : ascii) upper += c >= 'a' && c <= 'z' ? static_cast<char>(c - 'a' + 'A') : c;
  EXPECT_EQ(error_of("a.stl", upper), "");
  parted += ascii;
  for (std::size_t at = 0; (at = parted.find("endloop", at)) != std::string::npos; at += 8)
    parted.replace(at, 7, "end loop");
  EXPECT_EQ(error_of("a.stl", parted), "");
  EXPECT_THAT(error_of("a.stl", "not a mesh but a long text " + ascii),
              HasSubstr("text that begins with \"not\""));
}

TEST(Mesh, AByteOrderMarkIsNoPartOfATextFile) {
  const std::string mark = "\xef\xbb\xbf";
  EXPECT_EQ(error_of("a.obj", mark + test::print_obj(make_box_mesh({1, 1, 1}), "")), "");
  EXPECT_EQ(error_of("a.stl", mark + test::print_ascii_stl(make_box_mesh({1, 1, 1}))), "");
}

TEST(Mesh, WrongUnitIsRefused) {
  const std::string pad = test::print_obj(make_fat_pad_mm(), "mm");
  EXPECT_THAT(error_of("pad.obj", pad, 1), HasSubstr("wrong unit_m?"));
  EXPECT_THAT(error_of("pad.obj", pad, 1e-6), HasSubstr("wrong unit_m?"));
  EXPECT_EQ(error_of("pad.obj", pad, 0.001), "");
  EXPECT_THAT(error_of("pad.obj", pad, -1), HasSubstr("is not a positive length"));
}

TEST(Mesh, OpenAndTornSurfacesNameAnEdge) {
  TriangleMesh open = make_box_mesh({1, 1, 1});
  open.triangles.pop_back();
  EXPECT_THAT(error_of("open.obj", test::print_obj(open, "")),
              HasSubstr("open.obj: not closed, triangle"));
  TriangleMesh torn = make_box_mesh({1, 1, 1});
  std::swap(torn.triangles[3][0], torn.triangles[3][1]);
  EXPECT_THAT(error_of("torn.obj", test::print_obj(torn, "")),
              HasSubstr("used twice in the same direction"));
  TriangleMesh doubled = make_box_mesh({1, 1, 1});
  doubled.triangles.push_back(doubled.triangles.front());
  EXPECT_THAT(error_of("twice.obj", test::print_obj(doubled, "")),
              HasSubstr("belongs to more than two triangles, 0 and 12 among them: the surface is "
                        "folded onto itself or given twice"));
}

TEST(Mesh, InsideAgreesWithWindingNumber) {
  std::mt19937 random(1);
  for (const TriangleMesh& mesh :
       {make_fat_pad_mm(), make_organ_mm(), make_box_mesh({20, 20, 20})}) {
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& p : mesh.vertices) box.extend(p);
    std::vector<Eigen::Vector3d> points;
    std::uniform_real_distribution<double> uniform(-0.05, 1.05);
    for (int k = 0; k < 2000; ++k) {
      points.push_back(box.min() +
                       Eigen::Vector3d(uniform(random), uniform(random), uniform(random))
                           .cwiseProduct(box.sizes()));
    }
    // Lines exactly through vertices and edges, where a naive count fails; heights off the surface.
    for (std::size_t k = 0; k < mesh.vertices.size(); k += 3) {
      const Eigen::Vector3d& p = mesh.vertices[k];
      points.emplace_back(p.x(), p.y(), p.z() + 0.123);
      points.emplace_back(p.x(), p.y(), p.z() - 0.123);
    }
    const std::vector<bool> inside = points_inside(mesh, points);
    for (std::size_t k = 0; k < points.size(); ++k) {
      if (brute_force_distance(mesh, points[k]) < 1e-9)
        continue;  // on a vertical edge: either side
      EXPECT_EQ(inside[k], winding_number(mesh, points[k]) > 0.5) << points[k].transpose();
    }
  }
}

TEST(Mesh, InsideHoldsWithinRoundingOfVerticesAndEdges) {
  // Lines that pass a vertex or the middle of an edge exactly or by the last bit of a coordinate:
  // there the sign of a rounded orientation says nothing.
  const auto nudged = [](double value, int bits) {
    return bits == 0 ? value : std::nextafter(value, bits < 0 ? -1e300 : 1e300);
  };
  for (const TriangleMesh& mesh :
       {make_organ_mm(), make_box_mesh({20, 20, 20}), make_ellipsoid_mesh({20, 15, 10}, 9, 16),
        make_capsule_mesh({1, 2, 3}, {1, 2, 23}, 7, 12)}) {
    Eigen::AlignedBox3d box;
    for (const Eigen::Vector3d& p : mesh.vertices) box.extend(p);
    std::vector<Eigen::Vector3d> lines = mesh.vertices;
    for (const Eigen::Vector3i& t : mesh.triangles)
      lines.push_back((mesh.vertices[t[0]] + mesh.vertices[t[1]]) / 2);
    for (const Eigen::Vector3d& p : lines) {
      for (const double z : {box.min().z() - 0.1, p.z() - 0.1, p.z() + 0.1, box.max().z() + 0.1}) {
        const Eigen::Vector3d point(p.x(), p.y(), z);
        if (brute_force_distance(mesh, point) < 1e-9) continue;  // on an upright face: either side
        std::vector<Eigen::Vector3d> points;
        for (int k = 0; k < 9; ++k)
          points.emplace_back(nudged(p.x(), k % 3 - 1), nudged(p.y(), k / 3 - 1), z);
        EXPECT_EQ(points_inside(mesh, points),
                  std::vector<bool>(9, winding_number(mesh, point) > 0.5))
            << point.transpose();
      }
    }
  }
}

TEST(Mesh, WindingNumberIsOneInsideAndZeroOutside) {
  const TriangleMesh mesh = make_organ_mm();
  EXPECT_NEAR(winding_number(mesh, {0, 0, 0}), 1, 1e-12);  // sum of 1,024 angles in double
  EXPECT_NEAR(winding_number(mesh, {0, 0, 100}), 0, 1e-12);
}

TEST(Mesh, HundredThousandPointsAreFast) {
  const TriangleMesh mesh = make_fat_pad_mm();
  std::vector<Eigen::Vector3d> points;
  for (int k = 0; k < 100'000; ++k) {
    points.emplace_back(-30 + 84.0 * (k % 100) / 100, -38 + 62.0 * (k / 100 % 100) / 100,
                        k / 10000);
  }
  const auto start = std::chrono::steady_clock::now();
  const std::vector<bool> inside = points_inside(mesh, points);
  const std::chrono::duration<double> elapsed = std::chrono::steady_clock::now() - start;
  EXPECT_GT(std::count(inside.begin(), inside.end(), true), 10'000);
  EXPECT_LT(elapsed.count(),
            2.0);  // takes 0.02 s; a loaded machine under sanitizers is 50 x slower
}

TEST(SdfGrid, IsTheExactDistanceAtTheNodes) {
  const TriangleMesh mesh = scaled(make_fat_pad_mm(), 0.001);
  const SdfGrid grid = make_sdf_grid(mesh, 24, 0.005);
  ASSERT_EQ(grid.value.size(), static_cast<std::size_t>(grid.count.prod()));
  EXPECT_EQ(grid.count.maxCoeff(), 24);
  std::mt19937 random(2);
  for (int trial = 0; trial < 300; ++trial) {
    const Eigen::Vector3i node(static_cast<int>(random() % static_cast<unsigned>(grid.count.x())),
                               static_cast<int>(random() % static_cast<unsigned>(grid.count.y())),
                               static_cast<int>(random() % static_cast<unsigned>(grid.count.z())));
    const Eigen::Vector3d p = grid.origin + grid.pitch * node.cast<double>();
    const double sign = winding_number(mesh, p) > 0.5 ? -1 : 1;
    const auto index = static_cast<std::size_t>(
        node.x() + grid.count.x() * (node.y() + grid.count.y() * node.z()));
    // 1 nm: single precision of a distance below 0.1 m is 7 nm / 2.
    EXPECT_NEAR(static_cast<double>(grid.value[index]), sign * brute_force_distance(mesh, p), 8e-9);
  }
}

TEST(SdfGrid, OfABallIsRadiusMinusDistance) {
  const SdfGrid grid = make_sdf_grid(make_ellipsoid_mesh({0.02, 0.02, 0.02}, 60, 120), 32, 0.004);
  for (int k = 0; k < grid.count.z(); ++k) {
    const Eigen::Vector3d p = grid.origin + grid.pitch * Eigen::Vector3d(16, 16, k);
    const auto index = static_cast<std::size_t>(16 + grid.count.x() * (16 + grid.count.y() * k));
    // 30 um: depth of the facets of the tessellation, r (1 - cos(pi / 61)) = 27 um.
    EXPECT_NEAR(static_cast<double>(grid.value[index]), p.norm() - 0.02, 30e-6);
  }
}

TEST(Fixtures, AreWhatTheGeneratorMakes) {
  const TriangleMesh pad = load_closed_mesh(kTests + "/fixtures/fat_pad.obj", 0.001);
  const TriangleMesh made = parse_mesh("pad.obj", test::print_obj(make_fat_pad_mm(), ""), 0.001);
  ASSERT_EQ(pad.triangles, made.triangles);
  for (std::size_t k = 0; k < pad.vertices.size(); ++k) {
    EXPECT_LT((pad.vertices[k] - made.vertices[k]).norm(), 1e-6);  // last printed digit, other libm
  }
  const TriangleMesh leaf = load_mesh(kTests + "/fixtures/leaf.obj", 0.001);
  EXPECT_EQ(leaf.triangles,
            parse_mesh("leaf.obj", test::print_obj(make_leaf_mm(), ""), 0.001).triangles);
  const TriangleMesh organ = load_closed_mesh(kTests + "/fixtures/organ.stl", 0.001);
  EXPECT_NEAR(signed_volume(organ) * 1e9 / signed_volume(make_organ_mm()), 1, 1e-5);
}

TEST(Fixtures, FatPadIsNeitherFlatNorSquareNorCentred) {
  const TriangleMesh pad = load_closed_mesh(kTests + "/fixtures/fat_pad.obj", 0.001);
  Eigen::AlignedBox3d box;
  for (const Eigen::Vector3d& p : pad.vertices) box.extend(p);
  EXPECT_NEAR(box.sizes().x(), 0.080, 0.003);
  EXPECT_NEAR(box.sizes().y(), 0.060, 0.003);
  EXPECT_GT(box.center().norm(), 0.010);
  EXPECT_GT(pad.triangles.size(), 1000);
  EXPECT_LT(pad.triangles.size(), 2000);
  EXPECT_GT(signed_volume(pad), 0.5 * 0.08 * 0.06 * 0.006 * 0.6);
}

void feed(const std::string& content) {
  LLVMFuzzerTestOneInput(reinterpret_cast<const std::uint8_t*>(content.data()), content.size());
}

TEST(MeshFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  int files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(kTests + "/fuzz/corpus/mesh")) {
    ++files;
    const std::string content = test::read_bytes(entry.path().string());
    feed(content);
    for (std::size_t size = 0; size < content.size(); ++size) feed(content.substr(0, size));
    std::string flipped = content;
    for (char& byte : flipped) {
      const char original = byte;
      for (const char mask : {'\x01', '\x10', '\x80', '\xff'}) {
        byte = static_cast<char>(original ^ mask);
        feed(flipped);
      }
      byte = original;
    }
  }
  EXPECT_GE(files, 12);
}

}  // namespace
}  // namespace omentum

// Environment steps per second of the elastic shell on one core and its error at that speed. One
// environment step is 20 ms simulated. Lift case of docs/tissue.md 11.1: 31 x 31
// nodes, 90 x 90 x 3 mm, edge pinned, a corner patch moved on an arc about that edge at 25 mm/s up
// to 60 mm, E 100 kPa; the same on a mesh of as many nodes without order; the same sheet falling
// onto a sphere (section 9, E 30 kPa); and an organ like that of omentum_soft alone, its top moved
// up and down by 5 mm at 25 mm/s. Best of several chunks, thread CPU time; physics only: no robot,
// observation or reward. Static error: rms over all nodes against the same model in double
// precision, finely stepped. `bench_elastic [WIDTH [SURFACE]]` also writes that converged surface
// of the lift, for the peers.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <exception>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "core/check.h"
#include "core/clock.h"
#include "core/rng.h"
#include "sim_worker/models.h"
#include "sim_worker/scene/particles.h"
#include "sim_worker/shell/shell_tissue.h"
#include "sim_worker/solid/solid_tissue.h"

namespace {

using namespace omentum;  // NOLINT
using Eigen::Vector3d;

constexpr int kSide = 31;
constexpr int kCorner = kSide * 1 + kSide - 2;  // middle of the 3 x 3 nodes at a free corner
constexpr double kPinned = -0.045;              // y of the pinned edge [m]

struct Case {
  double young = 100e3, poisson = 0, damping = 3, friction = 0;
  double anchor_max_y = kPinned + 1e-4;
  double height = 0;  ///< of the sheet at the start [m]
  std::vector<RigidShape> bodies;
  bool is_mesh = false;
};

/// The grid as a mesh: inner nodes moved by up to a quarter of the pitch, diagonals by chance.
void disorder(Scene& scene) {
  const auto chance = [](std::size_t i, std::uint32_t k) {
    return static_cast<double>(
        uniform_24(philox({static_cast<std::uint32_t>(i), k, 0, 0}, {3, 5})[0]));
  };
  std::vector<Vector3d>& nodes = scene.tissue.particles;
  const double pitch = scene.config.tissue().grid().pitch_m();
  for (int ix = 0; ix < kSide; ++ix) {
    for (int iy = 0; iy < kSide; ++iy) {
      const int a = kSide * ix + iy;
      const auto i = static_cast<std::size_t>(a);
      const bool inside = ix > 0 && ix + 1 < kSide && iy > 0 && iy + 1 < kSide;
      for (std::uint32_t axis = 0; axis < 2 && inside; ++axis)
        nodes[i][axis] += 0.25 * pitch * (2 * chance(i, axis) - 1);
      if (ix + 1 == kSide || iy + 1 == kSide) continue;
      const bool rising = chance(i, 2) < 0.5;
      scene.tissue.surface_triangles.emplace_back(a, a + kSide, rising ? a + kSide + 1 : a + 1);
      scene.tissue.surface_triangles.emplace_back(rising ? a : a + kSide, a + kSide + 1, a + 1);
    }
  }
  scene.config.mutable_tissue()->mutable_sheet();
  scene.sheet = measure_sheet("mesh", nodes, scene.tissue.surface_triangles);
}

std::shared_ptr<const ShellTissueModel> make_sheet(const Case& c, unsigned substeps,
                                                   unsigned iterations) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_grid()->set_count_x(kSide);
  tissue.mutable_grid()->set_count_y(kSide);
  tissue.mutable_material()->set_young_modulus_pa(c.young);
  tissue.mutable_material()->set_poisson_ratio(c.poisson);
  tissue.mutable_material()->set_damping_per_s(c.damping);
  tissue.mutable_elastic()->set_substeps(substeps);
  tissue.mutable_elastic()->set_iterations(iterations);
  tissue.set_static_friction(c.friction);
  tissue.set_dynamic_friction(c.friction);
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = Vector3d(0, 0, -9.81);
  scene.tissue.X_WB.translation().z() = c.height;
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const Vector3d& p : scene.tissue.particles) {
    scene.tissue.fixed.push_back(p.y() < c.anchor_max_y ? 1 : 0);
  }
  scene.tissue.particle_radius = 0.0015;
  scene.tissue.thickness = 0.003;
  scene.bodies = c.bodies;
  if (c.is_mesh) disorder(scene);
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

Case over_sphere() {
  Case c;
  c.young = 30e3;
  c.damping = 5;
  RigidShape sphere;
  sphere.kind = RigidShape::Kind::kSphere;
  sphere.X_WS.translation() = Vector3d(0, -0.010, -0.043);
  sphere.size = Vector3d::Constant(0.0385);
  c.bodies = {sphere};
  return c;
}

Case onto_board() {
  Case c;
  c.young = 5e3;
  c.poisson = 0.45;
  c.damping = 5;
  c.friction = 0.3;
  c.anchor_max_y = -1;
  c.height = 0.0025;
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  c.bodies = {board};
  return c;
}

/// Tip of the tool at a time [s]: an arc about the pinned edge at 25 mm/s, 60 mm long, then still.
Vector3d tip_at(double time) {
  const double radius = 0.042 - kPinned;
  const double angle = std::min(0.025 * time, 0.060) / radius;
  return {-0.042, kPinned + radius * std::cos(angle), radius * std::sin(angle)};
}

template <typename Real>
void step_lift(ShellTissue<Real>& tissue, int& step) {
  const ToolMotion motion{tip_at(0.02 * step), tip_at(0.02 * (step + 1))};
  tissue.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue.lanes()), motion));
  ++step;
}

template <typename Real>
void hold_corner(ShellTissue<Real>& tissue) {
  for (int lane = 0; lane < tissue.lanes(); ++lane) tissue.hold(lane, tip_at(0), 0.0045, false);
}

template <typename Real>
void step_free(ShellTissue<Real>& tissue, int steps) {
  const ToolMotion away{Vector3d(0, 0, 1), Vector3d(0, 0, 1)};
  for (int k = 0; k < steps; ++k) {
    tissue.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue.lanes()), away));
  }
}

double rms_mm(const ShellTissue<float>& a, const ShellTissue<double>& b) {
  double sum = 0;
  for (int i = 0; i < a.particles(); ++i)
    sum += (a.position(0, i) - b.position(0, i)).squaredNorm();
  return 1e3 * std::sqrt(sum / a.particles());
}

/// Seconds of CPU per environment step of the lift, best of ten chunks of 20 steps after 25.
double lift_cost(ShellTissue<float>& tissue, int& step) {
  hold_corner(tissue);
  while (step < 25) step_lift(tissue, step);
  double best = 1e9;
  for (int chunk = 0; chunk < 10; ++chunk) {
    const double begin = thread_seconds();
    for (int k = 0; k < 20; ++k) step_lift(tissue, step);
    best = std::min(best, (thread_seconds() - begin) / (20 * tissue.lanes()));
  }
  return best;
}

/// Places of the nodes [m], one line each: what the peers are compared with.
void write_surface(const std::string& path, const ShellTissue<double>& tissue) {
  std::ofstream file(path);
  for (int i = 0; i < tissue.particles(); ++i) {
    const Vector3d p = tissue.position(0, i);
    file << fmt::format("{} {} {}\n", p.x(), p.y(), p.z());
  }
  if (!file.flush()) throw_error("{}: cannot be written", path);
}

void measure_mesh(const LaneKernel<float>& kernel, unsigned substeps) {
  Case c;
  c.is_mesh = true;
  const auto model = make_sheet(c, substeps, 1);
  ShellTissue<float> tissue(model, kernel);
  int step = 0;
  const double cost = lift_cost(tissue, step);
  std::printf("tissue.elastic_mesh.env_steps_per_s %.0f steps/s\n", 1 / cost);
  std::fprintf(stderr, "# elastic_mesh: %s, %d nodes, %u x 1, %zu held nodes, %.2f us/step\n",
               kernel.name, tissue.particles(), substeps, tissue.held(0).size(), 1e6 * cost);
}

std::shared_ptr<const SolidTissueModel> make_organ() {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_volume()->set_edge_length_m(0.016);
  tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
  tissue.mutable_material()->set_young_modulus_pa(3000);
  tissue.mutable_material()->set_poisson_ratio(0.45);
  tissue.mutable_material()->set_damping_per_s(5);
  tissue.set_density_kg_per_m3(1050);
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = Vector3d(0, 0, -9.81);
  scene.solid =
      fill_mesh(make_ellipsoid_mesh(Vector3d(0.022, 0.032, 0.014), 23, 48), "organ", 0.016);
  scene.tissue.particles = scene.solid.nodes;
  scene.tissue.surface_triangles = scene.solid.surface;
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.z() <= -0.009 ? 1 : 0);
  scene.tissue.particle_radius = 0.0015;
  return make_solid_model(scene, 0.02);
}

/// Mean over 6 s.
void measure_solid(const LaneKernel<float>& kernel) {
  const auto model = make_organ();
  SolidTissue<float> tissue(model, kernel);
  const auto tip = [](int step) {  // ten steps up, ten down
    const int phase = step % 20;
    return Vector3d(0, 0, 0.014 + 0.0005 * (phase < 10 ? phase : 20 - phase));
  };
  for (int lane = 0; lane < tissue.lanes(); ++lane) tissue.hold(lane, tip(0), 0.008, false);
  constexpr int kSteps = 300;
  const double begin = thread_seconds();
  for (int step = 0; step < kSteps; ++step) {
    const ToolMotion motion{tip(step), tip(step + 1)};
    tissue.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue.lanes()), motion));
  }
  const double cost = (thread_seconds() - begin) / (kSteps * tissue.lanes());
  std::printf("tissue.solid.env_steps_per_s %.0f steps/s\n", 1 / cost);
  std::fprintf(stderr,
               "# solid: %s, %d nodes, %zu tetrahedra, %u substeps, %zu held nodes, %.2f us/step, "
               "hash %016lx\n",
               kernel.name, tissue.particles(), model->mesh.tetrahedra.size(), model->substeps(),
               tissue.held(0).size(), 1e6 * cost, tissue.hash(0));
}

void measure_lift(const LaneKernel<float>& kernel, unsigned substeps, const std::string& surface) {
  const auto model = make_sheet({}, substeps, 1);
  ShellTissue<float> tissue(model, kernel);
  ShellTissue<double> fine(make_sheet({}, 100, 8), f64x1());
  int step = 0;
  const double cost = lift_cost(tissue, step);
  hold_corner(fine);
  int fine_step = 0;
  double moving = 0;
  // 2.4 s of lift and 2 s of hold: errors while moving (1.2 s) and at rest (4.4 s).
  ShellTissue<float> again(model, f32x1());
  hold_corner(again);
  for (int again_step = 0; again_step < 220;) {
    step_lift(again, again_step);
    step_lift(fine, fine_step);
    if (again_step == 60) moving = rms_mm(again, fine);
  }
  if (!surface.empty()) write_surface(surface, fine);
  std::printf("tissue.elastic.env_steps_per_s %.0f steps/s\n", 1 / cost);
  std::printf("tissue.elastic.static_error_mm %.4f mm\n", rms_mm(again, fine));
  std::fprintf(
      stderr,
      "# elastic lift: %s, %u x 1, %zu held nodes, mid-lift error %.3f mm, centre z %.2f mm, "
      "free corner z %.2f mm, %.2f us/step, hash %016lx\n",
      kernel.name, substeps, tissue.held(0).size(), moving, 1e3 * again.position(0, 480).z(),
      1e3 * again.position(0, 960).z(), 1e6 * cost, tissue.hash(0));

  // Every second lane 30 % stiffer: two factor keys in one batch.
  ShellTissue<float> mixed(model, kernel);
  for (int lane = 1; lane < mixed.lanes(); lane += 2) {
    mixed.set_parameters(lane, {.stiffness_scale = 1.3});
  }
  int mixed_step = 0;
  const double mixed_cost = lift_cost(mixed, mixed_step);
  std::printf("tissue.elastic.lanes_mixed_slowdown %.2f x\n", mixed_cost / cost);
}

void measure_contact(const std::string& name, const Case& c, const LaneKernel<float>& kernel,
                     unsigned substeps) {
  ShellTissue<float> tissue(make_sheet(c, substeps, 1), kernel);
  ShellTissue<double> fine(make_sheet(c, 50, 4), f64x1());
  // The mean over the whole life counts: landing costs more sweeps than lying.
  const double begin = thread_seconds();
  step_free(tissue, 50);
  const double landing = (thread_seconds() - begin) / (50 * tissue.lanes());
  step_free(tissue, 250);
  const double cost = (thread_seconds() - begin) / (300 * tissue.lanes());
  step_free(fine, 300);
  double force = 0;
  double fastest = 0;
  int contacts = 0;
  for (int i = 0; i < tissue.particles(); ++i) {
    force += tissue.contact_force(0, i).z();
    contacts += tissue.contact_force(0, i).norm() > 0 ? 1 : 0;
    fastest = std::max(fastest, tissue.velocity(0, i).norm());
  }
  std::printf("%s.env_steps_per_s %.0f steps/s\n", name.c_str(), 1 / cost);
  std::printf("%s.static_error_mm %.4f mm\n", name.c_str(), rms_mm(tissue, fine));
  std::fprintf(
      stderr,
      "# %s: %s, %u x 1, first second %.0f steps/s, %d contacts, force %.1f mN, at the end up to "
      "%.3f mm/s, %.2f us/step, hash %016lx\n",
      name.c_str(), kernel.name, substeps, 1 / landing, contacts, 1e3 * force, 1e3 * fastest,
      1e6 * cost, tissue.hash(0));
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const unsigned width = argc > 1 ? static_cast<unsigned>(std::stoul(argv[1])) : 0;
    const LaneKernel<float>& kernel = choose_kernel(width);
    measure_lift(kernel, 5, argc > 2 ? argv[2] : "");
    measure_mesh(kernel, 5);
    measure_contact("tissue.elastic_contact", over_sphere(), kernel, 5);
    measure_contact("tissue.elastic_board", onto_board(), kernel, 5);
    measure_solid(kernel);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_elastic: %s\n", error.what());
    return 2;
  }
  return 0;
}

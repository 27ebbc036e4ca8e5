// Cost and convergence of the reference model: a recording of 300 control steps of 20 ms in which a
// clamped sheet is lifted from a board and held. Thread CPU time; the end state hash tells whether
// two figures are of the same physics. The error is the difference to a finer mesh of the same
// model, over frames every 100 ms and in the hold alone.
#include <time.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "sim_worker/cooker.h"
#include "sim_worker/reference_tissue.h"

namespace {

using Eigen::Vector3d;
using namespace omentum;  // NOLINT

const Vector3d kPinch(0.025, 0.035, 0.0015);  // tip at the grasp, mid-surface of the sheet [m]
constexpr double kPatchRadius = 0.005;        // [m]

struct Case {
  double young = 6e4, poisson = 0.45;
  unsigned elements = 24;  ///< of the production mesh, scene.proto
  unsigned layers = 1, substeps = 1;
  pb::ElasticLaw law = pb::LAW_NEO_HOOKE;
};

struct Recording {
  std::vector<std::vector<Vector3d>> frames;  ///< every 100 ms [m]
  double seconds = 0;                         ///< CPU time of the steps
  double newton_per_step = 0, factors_per_step = 0, halved_steps = 0, force = 0, deepest = 0;
  std::uint64_t hash = 0;
  std::string failure;
};

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

std::shared_ptr<const ReferenceTissueModel> make_sheet(const Case& c) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.set_model(pb::TISSUE_REFERENCE);
  tissue.mutable_material()->set_young_modulus_pa(c.young);
  tissue.mutable_material()->set_poisson_ratio(c.poisson);
  tissue.mutable_material()->set_law(c.law);
  tissue.mutable_reference()->set_elements_x(c.elements);
  tissue.mutable_reference()->set_elements_y(c.elements);
  tissue.mutable_reference()->set_elements_z(c.layers);
  tissue.mutable_reference()->set_substeps(c.substeps);
  scene.gravity = Vector3d(0, 0, -9.80665);
  scene.tissue.X_WB.translation().z() = 0.5 * tissue.thickness_m();
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() <= tissue.anchor_max_y_m() + 1e-9 ? 1 : 0);
  scene.tissue.particle_radius = tissue.particle_radius_m();
  scene.tissue.thickness = tissue.thickness_m();
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  board.role = pb::ROLE_BOARD;
  scene.bodies = {board};
  std::vector<std::string> warnings;
  const std::array<PinchCircle, 1> pinches = {{{kPinch.head<2>(), kPatchRadius}}};
  return make_reference_model(scene, 0.02, warnings, pinches);
}

/// Rests 0.2 s, is pinched near a free corner, lifted by 40 mm and inwards at 25 mm/s, held.
Recording record(const Case& c) {
  constexpr int kSteps = 300;
  constexpr int kRest = 10;
  constexpr int kLift = 82;
  ReferenceTissue tissue(make_sheet(c));
  const Vector3d lift(-0.005, -0.008, 0.04);
  Recording recording;
  const double begin = thread_seconds();
  for (int step = 0; step < kSteps && tissue.healthy(0); ++step) {
    if (step == kRest) tissue.hold(0, kPinch, kPatchRadius, false);
    const auto tip = [&](int at) {
      return Vector3d(kPinch + std::clamp((at - kRest) / double{kLift}, 0.0, 1.0) * lift);
    };
    const ToolMotion motion{tip(step), tip(step + 1)};
    tissue.step({&motion, 1});
    recording.deepest = std::max(recording.deepest, tissue.penetration());
    if (step % 5 != 4) continue;
    std::vector<Vector3d> frame;
    for (int i = 0; i < tissue.particles(); ++i) frame.push_back(tissue.position(0, i));
    recording.frames.push_back(frame);
  }
  recording.seconds = thread_seconds() - begin;
  recording.newton_per_step = static_cast<double>(tissue.newton_iterations()) / kSteps;
  recording.factors_per_step = static_cast<double>(tissue.factorisations()) / kSteps;
  recording.halved_steps = static_cast<double>(tissue.implicit_steps()) - kSteps * c.substeps;
  recording.force = tissue.held_force(0).norm();
  recording.hash = tissue.hash(0);
  recording.failure = tissue.failure();
  return recording;
}

/// rms over the particles of frames [from, to) [mm].
double rms_mm(const Recording& a, const Recording& b, std::size_t from, std::size_t to) {
  double sum = 0;
  std::size_t count = 0;
  for (std::size_t f = from; f < std::min({to, a.frames.size(), b.frames.size()}); ++f) {
    for (std::size_t i = 0; i < a.frames[f].size(); ++i) {
      sum += (a.frames[f][i] - b.frames[f][i]).squaredNorm();
      ++count;
    }
  }
  return 1e3 * std::sqrt(sum / static_cast<double>(std::max<std::size_t>(count, 1)));
}

void print(const std::string& name, const Case& c, const Recording& r) {
  std::fprintf(stderr,
               "# %s: E %.0f Pa, %u x %u x %u, %u steps per 20 ms, %.2f s, %.2f Newton iterations "
               "and %.2f factorisations per control step, %.0f extra steps, held force %.3f mN, "
               "deepest %.4f mm, hash %016lx %s\n",
               name.c_str(), c.young, c.elements, c.elements, c.layers, c.substeps, r.seconds,
               r.newton_per_step, r.factors_per_step, r.halved_steps, 1e3 * r.force,
               1e3 * r.deepest, r.hash, r.failure.c_str());
}

void compare(const std::string& name, const Recording& base, const Case& other) {
  const Recording finer = record(other);
  print(name, other, finer);
  std::fprintf(stderr, "# %s: changes the recording by %.4f mm rms, the last 3 s by %.4f mm\n",
               name.c_str(), rms_mm(base, finer, 0, 60), rms_mm(base, finer, 30, 60));
}

}  // namespace

int main(int argc, char** argv) {
  const bool refine = argc > 1 && std::string(argv[1]) == "refine";
  Case base;
  if (argc > 2) base.elements = static_cast<unsigned>(std::stoul(argv[2]));
  const Recording recording = record(base);
  std::printf("tissue.reference.recording_s %.2f s\n", recording.seconds);
  print("recording", base, recording);
  Case soft = base;
  soft.young = 6e3;
  soft.law = pb::LAW_COROTATED;
  print("soft", soft, record(soft));
  if (!refine) return 0;
  Case half = base;
  half.substeps = 2;
  compare("half the step", recording, half);
  Case mesh = base;
  mesh.elements = base.elements * 3 / 2;
  compare("finer mesh", recording, mesh);
  Case layers = base;
  layers.layers = 2;
  compare("two layers", recording, layers);
  return 0;
}

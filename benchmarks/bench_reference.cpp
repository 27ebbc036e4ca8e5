// Cost and convergence of the reference model: a recording of 300 control steps of 20 ms in which a
// clamped sheet rests on a board, is lifted by a corner and held, or laid back and released. Thread
// CPU time; the end state hash tells whether two figures are of the same physics.
//
//   bench_reference [ELEMENTS]          cost
//   bench_reference columns [ELEMENTS]  cost of 60 columns beside a recording, of 290 at 16 x 16
//   bench_reference refine [ELEMENTS]   what a finer mesh, two layers and half the step change:
//                                       rms over the particles, of static lifts in air and of whole
//                                       recordings (frames every 100 ms)

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <string>
#include <vector>

#include "core/clock.h"
#include "core/constants.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/scene/particles.h"

namespace {

using Eigen::Vector3d;
using namespace omentum;  // NOLINT

const Vector3d kPinch(0.025, 0.035, 0.0015);  // tip at the grasp, mid-surface of the sheet [m]
constexpr double kPatchRadius = 0.005;        // [m]

struct Case {
  double young = 6e4, poisson = 0.45;
  unsigned elements = 24;  ///< of the production mesh
  unsigned layers = 1, substeps = 1;
  bool air = false;        ///< no board, statics
  bool laid_back = false;  ///< else held to the end
  pb::ElasticLaw law = pb::LAW_NEO_HOOKE;
};

struct Recording {
  std::vector<std::vector<Vector3d>> frames;  ///< every 100 ms [m]
  double seconds = 0;                         ///< CPU time of the steps
  double newton_per_step = 0, factors_per_step = 0, halved_steps = 0, force = 0, deepest = 0;
  std::uint64_t hash = 0;
  std::string failure;
};

std::vector<Vector3d> positions(const ReferenceTissue& tissue) {
  std::vector<Vector3d> frame;
  for (int i = 0; i < tissue.particles(); ++i) frame.push_back(tissue.position(0, i));
  return frame;
}

std::shared_ptr<const ReferenceTissueModel> make_sheet(
    const Case& c, const pb::TissueEffects& effects = {},
    const ReferenceTissueModel* mesh_of = nullptr) {
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
  scene.gravity = Vector3d(0, 0, -kStandardGravity);
  scene.tissue.X_WB.translation().z() = 0.5 * tissue.thickness_m();
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() <= tissue.anchor_max_y_m() + 1e-9 ? 1 : 0);
  scene.tissue.particle_radius = tissue.particle_radius_m();
  scene.tissue.thickness = tissue.thickness_m();
  RigidShape board;
  board.kind = RigidShape::Kind::kHalfSpace;
  board.role = pb::ROLE_BOARD;
  if (c.air) {
    tissue.mutable_material()->set_damping_per_s(20);
    tissue.mutable_reference()->set_integrator(pb::INTEGRATOR_BACKWARD_EULER);
  } else {
    scene.bodies = {board};
  }
  std::vector<std::string> warnings;
  const std::array<PinchCircle, 1> pinches = {{{kPinch.head<2>(), kPatchRadius}}};
  *tissue.mutable_effects() = effects;
  return make_reference_model(scene, c.air ? 0.2 : 0.02, warnings, pinches, mesh_of);
}

/// Sites of stiffness on a grid of the sheet, and as many more columns of forces there.
std::vector<ColumnParameter> columns_of_sites(int count) {
  std::vector<ColumnParameter> list;
  for (int k = 0; k < count; ++k) {
    ColumnParameter p;
    p.kind = k % 2 == 0 ? ColumnKind::kStiffnessSite : ColumnKind::kForceSite;
    p.place = {-0.036 + 0.012 * (k / 2 % 7), -0.036 + 0.012 * (k / 14 % 7)};
    p.radius = 0.01;
    p.axis = k / 2 % 3;
    list.push_back(p);
  }
  return list;
}

/// Of the first `count` effects of the catalogue that have one.
std::vector<ColumnParameter> columns_of_effects(const Case& c, const ReferenceTissueModel& base,
                                                int count) {
  std::vector<ColumnParameter> list;
  for (const EffectRow& row : effect_catalogue()) {
    if (static_cast<int>(list.size()) == count) break;
    if ((row.models & kReferenceModel) == 0 || row.of != nullptr || row.member == nullptr ||
        row.part == EffectPart::kAnchor)
      continue;
    ColumnParameter p;
    p.step = 1e-6;
    pb::TissueEffects effects;
    set_effect(effects, row.path, p.step);
    p.changed = make_sheet(c, effects, &base);
    list.push_back(p);
  }
  return list;
}

constexpr int kSteps = 300;

/// Rests 0.2 s, is pinched near a free corner, lifted by 40 mm and inwards at 25 mm/s, held; where
/// it is laid back that begins after 1.8 s, goes the same way, and the sheet is released and left
/// alone for 0.72 s. Carries columns by effects of the catalogue and by sites.
Recording record(const Case& c, int effects = 0, int sites = 0) {
  constexpr int kRest = 10;
  constexpr int kWay = 82;
  constexpr int kBack = 182;
  const auto model = make_sheet(c);
  ReferenceTissue tissue(model);
  std::vector<ColumnParameter> columns = columns_of_sites(sites);
  for (const ColumnParameter& column : columns_of_effects(c, *model, effects))
    columns.push_back(column);
  if (!columns.empty()) tissue.carry_columns(columns);
  const Vector3d lift(-0.005, -0.008, 0.04);
  Recording recording;
  const double begin = thread_seconds();
  for (int step = 0; step < kSteps && tissue.healthy(0); ++step) {
    if (step == kRest) tissue.hold(0, kPinch, kPatchRadius, false);
    if (c.laid_back && step == kBack + kWay) tissue.release(0);
    const auto tip = [&](int at) {
      const double up = std::clamp((at - kRest) / double{kWay}, 0.0, 1.0);
      const double back = c.laid_back ? std::clamp((at - kBack) / double{kWay}, 0.0, 1.0) : 0;
      return Vector3d(kPinch + (up - back) * lift);
    };
    const ToolMotion motion{tip(step), tip(step + 1)};
    tissue.step({&motion, 1});
    recording.deepest = std::max(recording.deepest, tissue.penetration());
    if (step == kBack - 1) recording.force = tissue.held_force(0).norm();
    if (step % 5 == 4) recording.frames.push_back(positions(tissue));
  }
  recording.seconds = thread_seconds() - begin;
  recording.newton_per_step = static_cast<double>(tissue.newton_iterations()) / kSteps;
  recording.factors_per_step = static_cast<double>(tissue.factorisations()) / kSteps;
  recording.halved_steps = static_cast<double>(tissue.implicit_steps()) - kSteps * c.substeps;
  recording.hash = tissue.hash(0);
  recording.failure = tissue.failure(0);
  if (tissue.columns() != nullptr && !tissue.columns()->valid) recording.failure = "no columns";
  return recording;
}

/// The lift in air, at rest: large steps of backward Euler with strong damping.
std::vector<Vector3d> lift_in_air(const Case& c) {
  Case still = c;
  still.air = true;
  ReferenceTissue tissue(make_sheet(still));
  const Vector3d lift(-0.005, -0.008, 0.04);
  tissue.hold(0, kPinch, kPatchRadius, false);
  for (int step = 0; step < 60; ++step) {
    const auto tip = [&](int at) { return Vector3d(kPinch + std::min(1.0, at / 10.0) * lift); };
    const ToolMotion motion{tip(step), tip(step + 1)};
    tissue.step({&motion, 1});
  }
  return positions(tissue);
}

double rms_mm(const std::vector<Vector3d>& a, const std::vector<Vector3d>& b) {
  double sum = 0;
  for (std::size_t i = 0; i < a.size(); ++i) sum += (a[i] - b[i]).squaredNorm();
  return 1e3 * std::sqrt(sum / static_cast<double>(a.size()));
}

/// Over all frames.
double rms_mm(const Recording& a, const Recording& b) {
  double squares = 0;
  const std::size_t count = std::min(a.frames.size(), b.frames.size());
  for (std::size_t f = 0; f < count; ++f) {
    const double rms = rms_mm(a.frames[f], b.frames[f]);
    squares += rms * rms / static_cast<double>(count);
  }
  return std::sqrt(squares);
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
  double worst = 0;
  for (std::size_t f = 0; f < std::min(base.frames.size(), finer.frames.size()); ++f)
    worst = std::max(worst, rms_mm(base.frames[f], finer.frames[f]));
  std::fprintf(stderr, "# %s: changes the recording by %.4f mm rms, its worst frame by %.4f mm\n",
               name.c_str(), rms_mm(base, finer), worst);
}

void refine(const Case& base) {
  Case finer = base;
  finer.elements = base.elements * 3 / 2;
  Case layers = base;
  layers.layers = 2;
  for (const double young : {2e4, 6e4, 2e5}) {
    Case c = base;
    c.young = finer.young = layers.young = young;
    const std::vector<Vector3d> at = lift_in_air(c);
    std::fprintf(stderr,
                 "# lift in air, E %.0f Pa: %u x %u elements change it by %.4f mm rms, two layers "
                 "by %.4f mm\n",
                 young, finer.elements, finer.elements, rms_mm(at, lift_in_air(finer)),
                 rms_mm(at, lift_in_air(layers)));
  }
  const Recording recording = record(base);
  print("laid back", base, recording);
  Case half = base;
  half.substeps = 2;
  compare("half the step", recording, half);
  finer.young = layers.young = base.young;
  compare("finer mesh", recording, finer);
  compare("two layers", recording, layers);
}

/// Of a factor [ms], and of one column of a solve of 60 [us], by the thread's clock.
void time_columns(unsigned elements) {
  constexpr int kEffects = 24;
  Case c;
  c.elements = elements;
  Case coarse = c;
  coarse.elements = 16;
  const Recording plain = record(c);
  const Recording one = record(c, 0, 1);
  const Recording forty = record(c, 0, 40);
  const Recording sixty = record(c, kEffects, 60 - kEffects);
  const Recording many = record(coarse, 0, 290);
  print("plain", c, plain);
  print("one column", c, one);
  print("40 sites", c, forty);
  print("24 effects, 36 sites", c, sixty);
  print("290 columns", coarse, many);
  std::printf("columns.factor_ms %.3f ms\n", 1e3 * (one.seconds - plain.seconds) / kSteps);
  std::printf("columns.solve_us_per_column %.2f us\n",
              1e6 * (forty.seconds - one.seconds) / (39.0 * kSteps));
  std::printf("columns.case10_60_columns_s %.1f s\n", 10 * sixty.seconds);
  std::printf("columns.case10_sites_s %.1f s\n", 10 * many.seconds);
  std::printf("columns.overhead_ratio_60 %.3f ratio\n",
              (sixty.seconds - plain.seconds) / plain.seconds);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc > 1 && std::string(argv[1]) == "columns") {
    time_columns(argc > 2 ? static_cast<unsigned>(std::stoul(argv[2])) : 24);
    return 0;
  }
  const bool refined = argc > 1 && std::string(argv[1]) == "refine";
  Case base;
  if (argc > (refined ? 2 : 1))
    base.elements = static_cast<unsigned>(std::stoul(argv[refined ? 2 : 1]));
  Case back = base;
  back.laid_back = true;
  if (refined) {
    refine(back);
    return 0;
  }
  const Recording recording = record(base);
  std::printf("tissue.reference.recording_s %.2f s\n", recording.seconds);
  print("recording", base, recording);
  Case soft = base;
  soft.young = 6e3;
  soft.law = pb::LAW_COROTATED;
  print("soft", soft, record(soft));
  print("laid back", back, record(back));
  return 0;
}

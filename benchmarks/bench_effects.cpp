// What each tissue effect costs in the elastic shell and in the elastic solid: time of a step with
// the effect over a step without. Shell: lift case of bench_elastic (31 x 31 nodes, 90 x 90 x 3 mm,
// E 100 kPa, a corner held and moved). Solid: a pad of 30 x 60 x 20 mm of 5 kPa, clamped at one end
// and lifted and lowered at the other. Every lane of the kernel is under the same effect, given by
// the scene; where an effect needs a body the base has it too, far below, or the tissue lies on it
// (adhesion, friction). Thread CPU time, chunks of both alternate, best of eight each. The last
// figures draw an inclusion per lane: own maps and, in the shell, factors.

#include <algorithm>
#include <cstdio>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "core/clock.h"
#include "sim_worker/models.h"
#include "sim_worker/scene/particles.h"
#include "sim_worker/shell/shell_model.h"
#include "sim_worker/solid/solid_model.h"

namespace {

using namespace omentum;  // NOLINT
using Eigen::Vector3d;

constexpr int kSide = 31;

/// A half-space far below shows what the effect costs, not what contact costs; one that the sheet
/// lies on lets it bond.
enum class Board { kNone, kFar, kUnder };

void add_board(Scene& scene, Board board, double below) {
  if (board == Board::kNone) return;
  RigidShape body;
  body.kind = RigidShape::Kind::kHalfSpace;
  body.X_WS.translation() = Vector3d(0, 0, board == Board::kFar ? -0.2 : -below);
  scene.bodies.push_back(body);
}

std::shared_ptr<const TissueModel> make_sheet(const pb::TissueEffects& effects, Board board) {
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_grid()->set_count_x(kSide);
  tissue.mutable_grid()->set_count_y(kSide);
  tissue.mutable_material()->set_young_modulus_pa(100e3);
  tissue.mutable_material()->set_poisson_ratio(0.4);
  *tissue.mutable_effects() = effects;
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = Vector3d(0, 0, -9.81);
  scene.tissue.particles = make_grid_particles(tissue.grid());
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() < -0.0449 ? 1 : 0);
  scene.tissue.particle_radius = 0.0015;
  scene.tissue.thickness = 0.003;
  add_board(scene, board, 0.0015);
  std::vector<std::string> warnings;
  return make_shell_model(scene, 0.02, warnings);
}

std::shared_ptr<const TissueModel> make_pad(const pb::TissueEffects& effects, Board board) {
  const Vector3d half(0.015, 0.03, 0.01);
  static const SolidMesh mesh = fill_mesh(make_box_mesh(half), "pad", 0.015);
  Scene scene;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.mutable_volume()->set_edge_length_m(0.015);
  tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
  tissue.mutable_material()->set_young_modulus_pa(5e3);
  tissue.mutable_material()->set_poisson_ratio(0.4);
  tissue.mutable_material()->set_damping_per_s(5);
  *tissue.mutable_effects() = effects;
  scene.config.mutable_tool()->set_contact(false);
  scene.gravity = Vector3d(0, 0, -9.81);
  scene.solid = mesh;
  scene.tissue.particles = mesh.nodes;
  scene.tissue.surface_triangles = mesh.surface;
  for (const Vector3d& p : mesh.nodes) scene.tissue.fixed.push_back(p.y() < -0.0299 ? 1 : 0);
  scene.tissue.particle_radius = 0.0015;
  add_board(scene, board, half.z() + 0.0015);
  return make_solid_model(scene, 0.02);
}

/// The tissues of one benchmark and how they are lifted.
struct Bench {
  const char* prefix;  ///< of the figures
  std::shared_ptr<const TissueModel> (*make)(const pb::TissueEffects&, Board);
  Vector3d tip;         ///< where they are taken
  double radius = 0;    ///< of the jaws
  double per_step = 0;  ///< how far they are lifted in a step [m]
  int half_period = 0;  ///< steps up before as many down; a chunk takes one period
};
const Bench kSheet{"", make_sheet, Vector3d(-0.042, 0.042, 0), 0.0045, 0.0003, 1000000};
const Bench kPad{"solid.", make_pad, Vector3d(0, 0.026, 0.01), 0.008, 0.0005, 3};

class Lift {
 public:
  Lift(const Bench& bench, const pb::TissueEffects& effects, Board board,
       const LaneKernel<float>& kernel)
      : bench_(bench), model_(bench.make(effects, board)), tissue_(model_->make_tissue(kernel)) {
    for (int lane = 0; lane < tissue().lanes(); ++lane)
      tissue().hold(lane, tip(), bench_.radius, false);
    run(18);
  }
  Tissue<float>& tissue() { return *tissue_; }
  void run(int steps) {
    for (int k = 0; k < steps; ++k) {
      const Vector3d from = tip();
      const bool up = step_++ % (2 * bench_.half_period) < bench_.half_period;
      height_ += up ? bench_.per_step : -bench_.per_step;
      tissue().step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue().lanes()),
                                            ToolMotion{from, tip()}));
    }
  }
  double chunk() {
    const double begin = thread_seconds();
    run(6);
    return thread_seconds() - begin;
  }

 private:
  Vector3d tip() const { return bench_.tip + height_ * Vector3d::UnitZ(); }
  const Bench& bench_;
  std::shared_ptr<const TissueModel> model_;
  std::unique_ptr<Tissue<float>> tissue_;
  double height_ = 0;
  int step_ = 0;
};

void compare(const std::string& name, Lift& with, Lift& without) {
  double best_with = 1e9;
  double best_without = 1e9;
  for (int k = 0; k < 8; ++k) {
    best_with = std::min(best_with, with.chunk());
    best_without = std::min(best_without, without.chunk());
  }
  std::printf("effect.%s.cost_ratio %.2f ratio\n", name.c_str(), best_with / best_without);
  std::fflush(stdout);
}

struct Effect {
  const char* name;
  void (*set)(pb::TissueEffects&);
  Board board = Board::kNone;
};

using E = pb::TissueEffects;
const Effect kEffects[] = {
    {"strain_stiffening", [](E& e) { e.set_strain_stiffening(0.3); }},
    {"exponential_stiffening", [](E& e) { e.set_exponential_stiffening(5); }},
    {"anisotropy", [](E& e) { e.mutable_anisotropy()->set_fibre_ratio(1); }},
    {"viscoelastic",
     [](E& e) {
       e.add_viscoelastic()->set_share(0.3);
       e.mutable_viscoelastic(0)->set_time_s(0.3);
     }},
    {"structural_damping", [](E& e) { e.set_structural_damping(0.2); }},
    {"plastic_set", [](E& e) { e.mutable_plastic_set()->set_modulus_ratio(0.3); }},
    {"mullins", [](E& e) { e.mutable_mullins()->set_softening(0.3); }},
    {"inclusion", [](E& e) { e.add_inclusion()->set_stiffness_change(3); }},
    {"density", [](E& e) { e.set_density_change(0.2); }},
    {"gravity_tilt", [](E& e) { e.set_gravity_tilt_x_deg(3); }},
    {"poisson", [](E& e) { e.set_poisson_change(0.05); }},
    {"bending_stiffness", [](E& e) { e.set_bending_change(1); }},
    {"rest_shape", [](E& e) { e.mutable_rest_shape()->set_curvature_y_per_m(5); }},
    {"thickness", [](E& e) { e.mutable_thickness()->set_x_per_m(3); }},
    {"adhesion", [](E& e) { e.mutable_adhesion()->set_stiffness_pa_per_m(1e5); }, Board::kUnder},
    {"adhesion_before_touch", [](E& e) { e.mutable_adhesion()->set_stiffness_pa_per_m(1e5); },
     Board::kFar},
    {"suction", [](E& e) { e.mutable_suction()->set_drag_pa_s_per_m(1e4); }, Board::kFar},
    {"obstacle", [](E&) {}, Board::kFar},
    {"board_friction", [](E& e) { e.set_friction_change(1); }, Board::kUnder},
    {"anchor_compliance", [](E& e) { e.mutable_anchor()->set_compliance_m2_per_n(1e-3); }},
    {"anchor_detachment", [](E& e) { e.mutable_anchor()->set_free_to_m(0.02); }},
    {"grasp_offset", [](E& e) { e.mutable_grasp_offset()->set_x_m(0.002); }},
    {"grasp_slip", [](E& e) { e.mutable_grasp_slip()->set_speed_m_per_s(0.001); }},
    {"grasp_compliance", [](E& e) { e.set_grasp_compliance_m_per_n(5e-3); }},
    {"jaw_orientation", [](E& e) { e.set_jaw_roll_deg(20); }},
    {"grasp_turn", [](E& e) { e.set_grasp_turn_rad_per_n_m(100); }},
    {"added_mass", [](E& e) { e.mutable_added_mass()->set_mass_kg(1e-3); }},
    {"local_force",
     [](E& e) {
       e.mutable_local_force()->set_strength(1);
       e.mutable_local_force()->set_stiffness_n_per_m(1);
       e.mutable_local_force()->set_slack_m(0.01);
       e.mutable_local_force()->set_push_z_n(1e-3);
     }},
    {"air_drag", [](E& e) { e.set_air_drag(1); }},
};

void measure(const Bench& bench, const LaneKernel<float>& kernel) {
  Lift plain(bench, {}, Board::kNone, kernel);
  Lift over_board(bench, {}, Board::kFar, kernel);
  Lift on_board(bench, {}, Board::kUnder, kernel);
  for (const Effect& effect : kEffects) {
    pb::TissueEffects effects;
    effect.set(effects);
    if (&bench == &kPad && !has_effects(effects, kSolidModel)) continue;
    Lift with(bench, effects, effect.board, kernel);
    // An obstacle is one more body.
    const bool is_obstacle = std::string(effect.name) == "obstacle";
    Lift& without = effect.board == Board::kUnder                 ? on_board
                    : effect.board == Board::kFar && !is_obstacle ? over_board
                                                                  : plain;
    compare(std::string(bench.prefix) + effect.name, with, without);
  }
  Lift drawn(bench, {}, Board::kNone, kernel);
  for (int lane = 0; lane < drawn.tissue().lanes(); ++lane) {
    LaneParameters parameters;
    parameters.effects = EffectValues{};
    parameters.effects->inclusion_x[0] = 0.001 * lane;
    parameters.effects->inclusion_change[0] = 0.1;
    drawn.tissue().set_parameters(lane, parameters);
  }
  compare(std::string(bench.prefix) + "inclusion_drawn_per_lane", drawn, plain);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const LaneKernel<float>& kernel =
        choose_kernel(argc > 1 ? static_cast<unsigned>(std::stoul(argv[1])) : 0);
    measure(kSheet, kernel);
    measure(kPad, kernel);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_effects: %s\n", error.what());
    return 2;
  }
  return 0;
}

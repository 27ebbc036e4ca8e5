// What each tissue effect costs in the elastic shell: time of a step with the effect over a step
// without. Lift case of bench_elastic (31 x 31 nodes, 90 x 90 x 3 mm, E 100 kPa, a corner held and
// moved) with every lane of the kernel under the same effect, given by the scene; where an effect
// needs a body the base has it too, far below, or the sheet lies on it (adhesion, friction). Thread
// CPU time, chunks of both alternate, best of eight each. The last figure draws an inclusion per
// lane: own maps and factors.
#include <time.h>

#include <algorithm>
#include <cstdio>
#include <exception>
#include <memory>
#include <string>
#include <vector>

#include "sim_worker/cooker.h"
#include "sim_worker/elastic_tissue.h"

namespace {

using namespace omentum;  // NOLINT
using Eigen::Vector3d;

constexpr int kSide = 31;

/// A half-space far below shows what the effect costs, not what contact costs; one that the sheet
/// lies on lets it bond.
enum class Board { kNone, kFar, kUnder };

double thread_seconds() {
  timespec t{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return static_cast<double>(t.tv_sec) + 1e-9 * static_cast<double>(t.tv_nsec);
}

std::shared_ptr<const ElasticTissueModel> make_sheet(const pb::TissueEffects& effects,
                                                     Board board) {
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
  if (board != Board::kNone) {
    RigidShape body;
    body.kind = RigidShape::Kind::kHalfSpace;
    body.X_WS.translation() = Vector3d(0, 0, board == Board::kFar ? -0.2 : -0.0015);
    scene.bodies.push_back(body);
  }
  std::vector<std::string> warnings;
  return make_elastic_model(scene, 0.02, warnings);
}

class Lift {
 public:
  Lift(std::shared_ptr<const ElasticTissueModel> model, const Kernel<float>& kernel)
      : tissue_(std::move(model), kernel) {
    for (int lane = 0; lane < tissue_.lanes(); ++lane) tissue_.hold(lane, tip(), 0.0045, false);
    run(15);
  }
  ElasticTissue<float>& tissue() { return tissue_; }
  void run(int steps) {
    for (int k = 0; k < steps; ++k) {
      const Vector3d from = tip();
      height_ += 0.0003;
      tissue_.step(std::vector<ToolMotion>(static_cast<std::size_t>(tissue_.lanes()),
                                           ToolMotion{from, tip()}));
    }
  }
  double chunk() {
    const double begin = thread_seconds();
    run(6);
    return thread_seconds() - begin;
  }

 private:
  Vector3d tip() const { return {-0.042, 0.042, height_}; }
  ElasticTissue<float> tissue_;
  double height_ = 0;
};

void compare(const char* name, Lift& with, Lift& without) {
  double best_with = 1e9;
  double best_without = 1e9;
  for (int k = 0; k < 8; ++k) {
    best_with = std::min(best_with, with.chunk());
    best_without = std::min(best_without, without.chunk());
  }
  std::printf("effect.%s.cost_ratio %.2f ratio\n", name, best_with / best_without);
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
    {"anisotropy", [](E& e) { e.mutable_anisotropy()->set_fibre_ratio(1); }},
    {"viscoelastic",
     [](E& e) {
       e.add_viscoelastic()->set_share(0.3);
       e.mutable_viscoelastic(0)->set_time_s(0.3);
     }},
    {"structural_damping", [](E& e) { e.set_structural_damping(0.2); }},
    {"plastic_set", [](E& e) { e.mutable_plastic_set()->set_modulus_ratio(0.3); }},
    {"mullins", [](E& e) { e.mutable_mullins()->set_softening(0.3); }},
    {"inclusion", [](E& e) { e.mutable_inclusion()->set_stiffness_change(3); }},
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
    {"air_drag", [](E& e) { e.set_air_drag(1); }},
};

void measure(const Kernel<float>& kernel) {
  Lift plain(make_sheet({}, Board::kNone), kernel);
  Lift over_board(make_sheet({}, Board::kFar), kernel);
  Lift on_board(make_sheet({}, Board::kUnder), kernel);
  for (const Effect& effect : kEffects) {
    pb::TissueEffects effects;
    effect.set(effects);
    Lift with(make_sheet(effects, effect.board), kernel);
    // An obstacle is one more body.
    const bool is_obstacle = std::string(effect.name) == "obstacle";
    Lift& without = effect.board == Board::kUnder                 ? on_board
                    : effect.board == Board::kFar && !is_obstacle ? over_board
                                                                  : plain;
    compare(effect.name, with, without);
  }
  Lift drawn(make_sheet({}, Board::kNone), kernel);
  for (int lane = 0; lane < drawn.tissue().lanes(); ++lane) {
    LaneParameters parameters;
    parameters.effects = EffectValues{};
    parameters.effects->inclusion_x = 0.001 * lane;
    parameters.effects->inclusion_change = 0.1;
    drawn.tissue().set_parameters(lane, parameters);
  }
  compare("inclusion_drawn_per_lane", drawn, plain);
}

}  // namespace

int main(int argc, char** argv) {
  try {
    measure(choose_kernel(argc > 1 ? static_cast<unsigned>(std::stoul(argv[1])) : 0));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_effects: %s\n", error.what());
    return 2;
  }
  return 0;
}

// The bits of every tissue model, at every width, with every effect: 200 control steps of contact,
// grasp, lift, slip and release, against stored hashes. A change here is a change of results:
// CHANGELOG tag [BITS]. OMENTUM_WRITE_GOLDEN=1 writes the file anew.
#include <gtest/gtest.h>

#include <cstdlib>
#include <fstream>
#include <functional>
#include <map>
#include <sstream>

#include "core/hash.h"
#include "sim_worker/models.h"
#include "support/coupled_scene.h"
#include "support/effect_scene.h"
#include "support/solid_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kSteps = 200;
constexpr int kPhases = 8;  // lane k does everything k % 8 steps later, and somewhat aside

/// A scene to grasp in: `grip` is at rest where the jaws close.
struct GoldenCase {
  std::string name;
  std::function<Scene()> scene;
  Vector3d grip;
  double radius;
};

/// Tip of the tool at the start of a step: from above down to the grip, up, down half way, away.
Vector3d tip_at(const GoldenCase& c, int phase, int step) {
  const int t = std::max(0, step - phase);
  const auto between = [t](int from, int to) {
    return std::clamp(static_cast<double>(t - from) / (to - from), 0.0, 1.0);
  };
  const double height = 0.015 * (1 - between(0, 30)) + 0.010 * between(35, 100) -
                        0.006 * between(100, 140) + 0.015 * between(160, 190);
  return c.grip +
         Vector3d(0.0001 * phase + 0.004 * between(40, 120), -0.003 * between(60, 120), height);
}

LaneParameters parameters_of(int phase) {
  LaneParameters parameters;
  if (phase % 3 != 2) return parameters;
  parameters.stiffness_scale = 0.8;
  parameters.gravity_scale = 1.1;
  parameters.damping_scale = 1.3;
  parameters.friction_scale = 1.2;
  return parameters;
}

/// Hash of each lane over positions, velocities and forces of the whole run; lane k has phase
/// phases[k].
template <typename Real>
std::vector<std::uint64_t> run_case(const GoldenCase& c, const TissueModel& model,
                                    const LaneKernel<Real>& kernel,
                                    const std::vector<int>& phases) {
  const auto tissue = model.make_tissue(kernel);
  std::vector<std::uint64_t> hashes(phases.size(), kFnvOffset);
  const auto add = [&](std::size_t k, const Vector3d& v) {
    const std::array<double, 3> numbers = {v.x(), v.y(), v.z()};
    hashes[k] = fnv1a64(bytes_of(std::span<const double>(numbers)), hashes[k]);
  };
  for (std::size_t k = 0; k < phases.size(); ++k) {
    const int lane = static_cast<int>(k);
    tissue->set_parameters(lane, parameters_of(phases[k]));
    tissue->reset(lane, Vector3d::Zero());
  }
  std::vector<ToolMotion> motion(phases.size());
  for (int step = 0; step < kSteps; ++step) {
    for (std::size_t k = 0; k < phases.size(); ++k) {
      const int lane = static_cast<int>(k);
      motion[k] = {tip_at(c, phases[k], step), tip_at(c, phases[k], step + 1)};
      if (step == 32 + phases[k]) {
        tissue->hold(lane, motion[k].from, c.radius, false);
        if (tissue->distance_to_body(lane, motion[k].from) < c.radius)
          tissue->hold_body(lane, motion[k].from, c.radius, false);
      }
      if (step == 110 + phases[k]) tissue->shift_held(lane, Vector3d(0.0002, 0, -0.0001));
      if (step == 155 + phases[k]) tissue->release(lane);
    }
    tissue->step(motion);
    for (std::size_t k = 0; k < phases.size(); ++k) {
      const int lane = static_cast<int>(k);
      add(k, tissue->held_force(lane));
      if (step % 10 != 9) continue;
      for (int i = 0; i < tissue->particles(); ++i) {
        add(k, tissue->position(lane, i));
        add(k, tissue->velocity(lane, i));
      }
    }
  }
  for (std::size_t k = 0; k < phases.size(); ++k)
    EXPECT_EQ(tissue->failure(static_cast<int>(k)), "") << c.name << " phase " << phases[k];
  return hashes;
}

// ---- the file of hashes: "case precision.phase hash" a line, sorted -----------------------------

class GoldenFile {
 public:
  explicit GoldenFile(std::string path) : path_(std::move(path)) {
    std::ifstream file(path_);
    for (std::string key, hash; file >> key >> hash;) hashes_[key] = hash;
  }
  /// Whether the stored hash of a key is this one; writes it instead where that was asked for.
  void check(const std::string& key, std::uint64_t hash) {
    std::ostringstream text;
    text << std::hex << hash;
    const bool write =
        std::getenv("OMENTUM_WRITE_GOLDEN") != nullptr;  // NOLINT(concurrency-mt-unsafe)
    if (write) {
      hashes_[key] = text.str();
      std::ofstream file(path_);
      for (const auto& [k, h] : hashes_) file << k << " " << h << "\n";
      return;
    }
    const auto found = hashes_.find(key);
    ASSERT_NE(found, hashes_.end()) << key << " has no stored hash";
    EXPECT_EQ(text.str(), found->second) << key;
  }

 private:
  std::string path_;
  std::map<std::string, std::string> hashes_;
};

/// Without `every_width` in double precision and at the widest kernel only: of every effect, tests
/// of lanes hold the others against these.
void check_case(const GoldenCase& c, bool every_width = true) {
  GoldenFile golden(OMENTUM_GOLDEN_DIR "/tissue_bits.txt");
  std::vector<std::string> warnings;
  const auto model = make_tissue_model(c.scene(), 0.02, warnings);
  const bool reference = c.scene().config.tissue().model() == pb::TISSUE_REFERENCE;
  golden.check(c.name + ".f64.0", run_case(c, *model, f64x1(), {0})[0]);
  if (every_width || reference)
    golden.check(c.name + ".f64.5", run_case(c, *model, f64x1(), {5})[0]);
  if (reference) return;
  std::vector<int> phases;
  for (int k = 0; k < 16; ++k) phases.push_back(k % kPhases);
  for (const int phase : {0, 5}) {
    if (!every_width) break;
    const std::string key = c.name + ".f32." + std::to_string(phase);
    golden.check(key, run_case(c, *model, f32x1(), {phase})[0]);
  }
  const bool wide = __builtin_cpu_supports("avx512f") != 0;
  if (!wide) std::puts("16 lanes skipped: no AVX-512 on this CPU");
  for (const unsigned width : {8U, 16U}) {
    if (width == 16 ? !wide : wide && !every_width) continue;
    const auto& kernel = choose_kernel(width);
    const auto hashes =
        run_case(c, *model, kernel, {phases.begin(), phases.begin() + static_cast<int>(width)});
    for (std::size_t k = 0; k < width; ++k) {
      if (phases[k] == 0 || phases[k] == 5)
        golden.check(c.name + ".f32." + std::to_string(phases[k]), hashes[k]);
    }
  }
}

// ---- scenes -------------------------------------------------------------------------------------

RigidShape make_body(RigidShape::Kind kind, const Vector3d& place, const Vector3d& size) {
  RigidShape body;
  body.kind = kind;
  body.X_WS.linear() = Eigen::AngleAxisd(0.4, Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  body.X_WS.translation() = place;
  body.size = size;
  if (kind == RigidShape::Kind::kMesh) {
    body.surface = make_ellipsoid_mesh(size, 7, 12);
    body.sdf = std::make_shared<SdfGrid>(make_sdf_grid(body.surface, 24, 0.006));
  }
  return body;
}

/// Every kind of body under a sheet of 24 mm, and the tool's shaft.
void add_every_body(Scene& scene) {
  using Kind = RigidShape::Kind;
  scene.bodies = {make_body(Kind::kSphere, {-0.005, 0.004, -0.0066}, Vector3d::Constant(0.005)),
                  make_body(Kind::kEllipsoid, {0.006, 0.003, -0.0068}, {0.006, 0.004, 0.005}),
                  make_body(Kind::kBox, {-0.004, -0.005, -0.0095}, {0.004, 0.005, 0.003}),
                  make_body(Kind::kMesh, {0.006, -0.006, -0.0075}, {0.005, 0.004, 0.005})};
  RigidShape board = test::make_board(0.0035);
  scene.bodies.push_back(board);
  scene.config.mutable_tool()->set_contact(true);
  scene.config.mutable_tool()->set_shaft_radius_m(0.002);
  scene.config.mutable_tool()->set_shaft_start_m(0.002);
}

GoldenCase cluster_case(const std::string& name, const std::function<void(test::SheetCase&)>& set,
                        bool bodies = false, const pb::TissueEffects& effects = {}) {
  return {"cluster." + name,
          [=] {
            test::SheetCase c;
            c.nx = c.ny = 9;
            c.anchor_max_y = -0.012;
            set(c);
            Scene scene = test::make_sheet_scene(c);
            *scene.config.mutable_tissue()->mutable_effects() = effects;
            scene.config.mutable_tissue()->set_static_friction(0.3);
            scene.config.mutable_tissue()->set_dynamic_friction(0.2);
            if (bodies) {
              add_every_body(scene);
            } else {
              scene.bodies = {test::make_board(0.00352)};
            }
            return scene;
          },
          Vector3d(0.001, 0.0095, 0), 0.0045};
}

/// Small steps, hence few effects per step: the solvers of the models, not their accuracy.
GoldenCase sheet_case(test::Model model, const std::string& name,
                      const std::function<void(test::EffectCase&)>& set, bool bodies = false) {
  return {(model == test::Model::kElastic ? "shell." : "reference.") + name,
          [=] {
            test::EffectCase c = test::lift_case(true);
            set(c);
            Scene scene = test::make_effect_scene(c, model);
            if (bodies) add_every_body(scene);
            return scene;
          },
          Vector3d(0.001, 0.0095, 0), 0.0045};
}

GoldenCase solid_case(const std::string& name, const std::function<void(test::SolidCase&)>& set,
                      bool bodies = false) {
  return {"solid." + name,
          [=] {
            test::SolidCase c;
            c.size = {0.024, 0.024, 0.008};
            c.edge_length = 0.014;
            static const SolidMesh mesh =
                fill_mesh(make_box_mesh(0.5 * c.size), "box", c.edge_length);
            c.mesh = mesh;
            c.anchor_max_y = -0.012 + 1e-9;
            c.young = 5e3;
            c.poisson = 0.4;
            c.substeps = 2;
            c.static_friction = c.dynamic_friction = 0.3;
            c.bodies = {test::make_board(0.00552)};
            set(c);
            Scene scene = test::make_solid_scene(c);
            if (bodies) {
              add_every_body(scene);
              for (RigidShape& body : scene.bodies) body.X_WS.translation().z() -= 0.004;
            }
            return scene;
          },
          Vector3d(0.001, 0.0095, 0.0005), 0.0045};
}

GoldenCase coupled_case(const std::string& name, const test::CoupledCase& c, const Vector3d& grip,
                        const pb::TissueEffects& effects = {}) {
  return {"coupled." + name,
          [=] {
            Scene scene = test::make_coupled_scene(c);
            *scene.config.mutable_tissue()->mutable_effects() = effects;
            return scene;
          },
          grip, 0.004};
}

// ---- tests --------------------------------------------------------------------------------------

TEST(GoldenBits, OfClustersHold) {
  check_case(cluster_case("plain", [](auto&) {}));
  check_case(cluster_case(
      "bodies", [](auto&) {}, true));
  check_case(cluster_case("iterated", [](auto& c) {
    c.iterations = 3;
    c.rotation_iterations = 2;
    c.substeps = 4;
  }));
  check_case(cluster_case("plastic", [](auto& c) {
    c.plastic_threshold = 1e-8;
    c.plastic_creep = 0.1;
  }));
  check_case(cluster_case("global", [](auto& c) { c.global_stiffness = 0.2; }));
  check_case(cluster_case("linked", [](auto& c) { c.link_radius = 0.0045; }));
  check_case(cluster_case("self_collision", [](auto& c) { c.self_collision = true; }));
  for (const auto& effect : test::all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    if (!has_effects(effects, kClusterModel)) continue;
    check_case(cluster_case(
        effect.name, [](auto&) {}, false, effects));
  }
}

TEST(GoldenBits, OfTheShellHold) {
  const auto shell = [](const std::string& name, const auto& set, bool bodies = false) {
    check_case(sheet_case(test::Model::kElastic, name, set, bodies));
  };
  shell("plain", [](auto&) {});
  shell(
      "bodies", [](auto&) {}, true);
  shell("bdf2", [](auto& c) { c.integrator = pb::INTEGRATOR_BDF2; });
  shell("iterated", [](auto& c) { c.iterations = 3; });
  for (const auto& effect : test::all_effects())
    shell(effect.name, [&effect](auto& c) { effect.set(c.effects, 1); });
}

TEST(GoldenBits, OfTheShellOnAMeshHold) {
  for (const std::string name : {"plain", "poisson", "viscoelastic", "inclusion"}) {
    check_case({"shell_mesh." + name,
                [name] {
                  test::EffectCase c = test::lift_case(true);
                  for (const auto& effect : test::all_effects())
                    if (name == effect.name) effect.set(c.effects, 1);
                  Scene scene = test::make_mesh_scene(c, test::make_irregular_mesh(c, 0.2));
                  *scene.config.mutable_tissue()->mutable_effects() = c.effects;
                  scene.config.mutable_tissue()->set_anchor_max_y_m(c.anchor_max_y);
                  return scene;
                },
                Vector3d(0.001, 0.0095, 0), 0.0045});
  }
}

TEST(GoldenBits, OfTheSolidHold) {
  check_case(solid_case("plain", [](auto&) {}));
  check_case(solid_case(
      "bodies", [](auto&) {}, true));
  check_case(solid_case("bdf2", [](auto& c) { c.integrator = pb::INTEGRATOR_BDF2; }));
  check_case(solid_case("stiff", [](auto& c) { c.poisson = 0.49; }));
}

void check_solid_with_effects(bool every_width) {
  for (const auto& effect : test::all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    if (!has_effects(effects, kSolidModel)) continue;
    check_case(solid_case(effect.name, [&effects](auto& c) { c.effects = effects; }), every_width);
  }
}

TEST(GoldenBits, OfTheSolidWithEffectsHold) { check_solid_with_effects(false); }

TEST(GoldenBits, OfTheSolidWithEffectsHoldAtEveryWidth) { check_solid_with_effects(true); }

TEST(GoldenBits, OfASheetOnASoftBodyHold) {
  test::CoupledCase cushion = test::on_cushion();
  cushion.sheet.nx = cushion.sheet.ny = 9;
  cushion.shape = make_box_mesh({0.016, 0.016, 0.008});
  cushion.edge_length = 0.014;
  cushion.anchor_max_z = -0.008;
  cushion.sheet.X_WB.translation().z() = 0.008 + 0.002;
  cushion.sheet.substeps = 2;
  const Vector3d grip(0.001, 0.0095, 0.0095);
  check_case(coupled_case("cushion", cushion, grip));
  pb::TissueEffects effects;
  effects.set_grasp_compliance_m_per_n(5e-3);
  effects.set_gravity_tilt_x_deg(3);
  effects.mutable_grasp_slip()->set_speed_m_per_s(0.01);
  effects.mutable_grasp_slip()->set_force_n(0.002);
  check_case(coupled_case("effects", cushion, grip, effects));
  cushion.sheet.integrator = pb::INTEGRATOR_BDF2;
  check_case(coupled_case("bdf2", cushion, grip));
}

TEST(GoldenBits, OfTheReferenceHold) {
  const auto reference = [](const std::string& name, const auto& set, bool bodies = false) {
    check_case(sheet_case(test::Model::kReference, name, set, bodies));
  };
  reference("plain", [](auto&) {});
  reference(
      "bodies", [](auto&) {}, true);
  for (const auto& effect : test::all_effects())
    reference(effect.name, [&effect](auto& c) { effect.set(c.effects, 1); });
}

}  // namespace
}  // namespace omentum

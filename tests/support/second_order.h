#pragma once

// Static states that second-order bricks of another engine found (tests/reference), and the same
// states of the product.

#include <gtest/gtest.h>

#include <cmath>
#include <fstream>
#include <map>
#include <memory>
#include <span>
#include <sstream>
#include <string>
#include <vector>

#include "sim_worker/shell/shell_tissue.h"
#include "support/reference_scene.h"

namespace omentum::test {

/// tests/reference/results/second_order/NAME.txt.
struct SecondOrder {
  std::map<std::string, std::vector<double>> values;  ///< of the lines "# key values"
  std::string law, body;
  std::vector<Vector3d> rest, deformed;  ///< points of the mid-surface [m]

  bool has(const char* key) const { return values.count(key) != 0; }
  Vector3d vector(const char* key) const { return Vector3d::Map(values.at(key).data()); }
};

inline SecondOrder read_second_order(const std::string& path) {
  std::ifstream file(path);
  EXPECT_TRUE(file.is_open()) << path;
  SecondOrder result;
  for (std::string line; std::getline(file, line);) {
    std::istringstream words(line);
    if (line.front() == '#') {
      std::string hash;
      std::string key;
      words >> hash >> key;
      if (key == "law" || key == "body") {
        words >> (key == "law" ? result.law : result.body);
        continue;
      }
      for (double value = 0; words >> value;) result.values[key].push_back(value);
      continue;
    }
    Vector3d a;
    Vector3d b;
    words >> a.x() >> a.y() >> a.z() >> b.x() >> b.y() >> b.z();
    EXPECT_TRUE(words) << path << ": " << line;
    result.rest.push_back(a);
    result.deformed.push_back(b);
  }
  return result;
}

/// Body, material and effects of the case; elements and layers from the default tolerance.
inline Scene make_second_order_scene(const SecondOrder& c) {
  ReferenceCase r;
  r.nx = c.body == "beam" ? 3 : c.body == "stubby" ? 11 : 31;
  r.ny = 31;
  r.thickness = c.body == "stubby" ? 0.027 : 0.003;
  r.anchor = -0.042;
  r.ex = r.ey = r.ez = 0;
  r.young = c.values.at("young")[0];
  r.poisson = 0.45;
  r.gravity = c.values.at("gravity")[0];
  r.damping = 20;
  r.integrator = pb::INTEGRATOR_BACKWARD_EULER;
  r.law = c.law == "neo_hooke"   ? pb::LAW_NEO_HOOKE
          : c.law == "corotated" ? pb::LAW_COROTATED
                                 : pb::LAW_ST_VENANT_KIRCHHOFF;
  Scene scene = make_reference_scene(r);
  pb::TissueEffects& effects = *scene.config.mutable_tissue()->mutable_effects();
  if (c.has("inclusion")) {
    const std::vector<double>& disc = c.values.at("inclusion");
    auto& inclusion = *effects.add_inclusion();
    inclusion.set_x_m(disc[0]);
    inclusion.set_y_m(disc[1]);
    inclusion.set_radius_m(disc[2]);
    inclusion.set_stiffness_change(disc[3]);
  }
  if (c.has("compliance")) effects.set_grasp_compliance_m_per_n(c.values.at("compliance")[0]);
  if (c.has("pad")) {
    const std::vector<double>& pad = c.values.at("pad");
    pb::Grip& grip = *scene.config.mutable_tool()->mutable_grip();
    grip.set_hold(pb::HOLD_PAD);
    grip.set_shape(pb::GRIP_RECTANGLE);
    grip.set_half_x_m(pad[2]);
    grip.set_half_y_m(pad[3]);
    if (c.has("turn_compliance"))
      grip.set_turn_compliance_rad_per_n_m(c.values.at("turn_compliance")[0]);
    scene.config.mutable_tool()->set_roll_deg(90);  // x_C along x_W
  }
  if (c.has("anchor_compliance"))
    effects.mutable_anchor()->set_compliance_m2_per_n(c.values.at("anchor_compliance")[0]);
  return scene;
}

/// Of a pad the radius says nothing.
inline std::vector<PinchCircle> pinches_of(const SecondOrder& c) {
  if (!c.has("disc") && !c.has("pad")) return {};
  const std::vector<double>& grip = c.values.at(c.has("disc") ? "disc" : "pad");
  return {{{grip[0], grip[1]}, grip[2]}};
}

struct StaticState {
  std::vector<Vector3d> points;  ///< those of the case [m]
  Vector3d force = Vector3d::Zero();
  std::string failure;
};

/// The case on a tissue of the scene, lifted and let come to rest in control steps of `period` [s].
template <typename PointOf>
StaticState settle(const SecondOrder& c, double period, Tissue<double>& tissue,
                   const PointOf& point) {
  Vector3d tip(0, 0, 1);
  Vector3d way = Vector3d::Zero();
  for (const PinchCircle& grip : pinches_of(c)) {
    tip = Vector3d(grip.centre.x(), grip.centre.y(), 0);
    way = c.vector("lift");
    tissue.hold(0, tip, grip.radius, false);
  }
  std::vector<Vector3d> last;
  const auto moves = [&] {
    std::vector<Vector3d> now;
    for (const Vector3d& p : c.rest) now.push_back(point(p));
    double most = last.empty() ? 1 : 0;
    for (std::size_t i = 0; i < last.size(); ++i) most = std::max(most, (now[i] - last[i]).norm());
    last = now;
    return most > 1e-7 * period;
  };
  const auto at = [&](int k) { return Vector3d(tip + std::min(1.0, k * period / 2) * way); };
  const int lift = static_cast<int>(std::lround(2 / period));
  int step = 0;
  for (; (step <= lift || moves()) && step * period < 80 && tissue.healthy(0); ++step) {
    const ToolMotion motion{at(step), at(step + 1)};
    tissue.step({&motion, 1});
  }
  StaticState state;
  for (const Vector3d& p : c.rest) state.points.push_back(point(p));
  state.force = tissue.held_force(0);
  state.failure = tissue.failure(0);
  return state;
}

/// Of the model reference; `scene` from make_second_order_scene, its mesh as it says.
inline StaticState settle_reference(const SecondOrder& c, const Scene& scene,
                                    std::array<int, 3>* cells = nullptr) {
  constexpr double kPeriod = 0.2;
  std::vector<std::string> warnings;
  const auto model = make_reference_model(scene, kPeriod, warnings, pinches_of(c));
  if (cells != nullptr) *cells = {model->cells(0), model->free_cells_y(), model->cells(2)};
  ReferenceTissue tissue(model);
  return settle(c, kPeriod, tissue,
                [&](const Vector3d& p) { return tissue.point(model->locate(p)); });
}

/// Of the shell, with `finer` cells per pitch of the scene, so that every point of a case stays a
/// node.
inline StaticState settle_shell(const SecondOrder& c, Scene scene, unsigned finer = 1) {
  constexpr double kPeriod = 0.02;
  pb::Tissue& tissue = *scene.config.mutable_tissue();
  tissue.set_model(pb::TISSUE_ELASTIC);
  auto& grid = *tissue.mutable_grid();
  grid.set_pitch_m(grid.pitch_m() / finer);
  grid.set_count_x((grid.count_x() - 1) * finer + 1);
  grid.set_count_y((grid.count_y() - 1) * finer + 1);
  scene.tissue.particles = make_grid_particles(grid);
  scene.tissue.fixed.clear();
  for (const Vector3d& p : scene.tissue.particles)
    scene.tissue.fixed.push_back(p.y() <= tissue.anchor_max_y_m() + 1e-9 ? 1 : 0);
  std::vector<std::string> warnings;
  const auto model = make_shell_model(scene, kPeriod, warnings);
  ShellTissue<double> sheet(model, f64x1());
  const auto particle = [&](const Vector3d& p) {
    int nearest = 0;
    for (int k = 0; k < sheet.particles(); ++k) {
      if ((model->body.particles[k] - p).norm() < (model->body.particles[nearest] - p).norm())
        nearest = k;
    }
    return nearest;
  };
  return settle(c, kPeriod, sheet,
                [&](const Vector3d& p) { return Vector3d(sheet.position(0, particle(p))); });
}

inline double rms_distance(std::span<const Vector3d> a, std::span<const Vector3d> b) {
  double squares = 0;
  for (std::size_t i = 0; i < a.size(); ++i) squares += (a[i] - b[i]).squaredNorm();
  return std::sqrt(squares / static_cast<double>(a.size()));
}

}  // namespace omentum::test

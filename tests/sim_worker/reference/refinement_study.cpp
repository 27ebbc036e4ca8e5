// Refinement of static states of the reference solid: a level sheet and slender and stubby beams
// that droop, lifts, over laws, stiffness, elements and layers. Prints, per mesh, the tip, the
// force and the distance to the finest mesh of its row; run by hand (decision 0013).
//
//   refinement_study [--young PA ...] [--law NAME] [--layers N ...] [--elements N ...] [--body
//   NAME]

#include <cstdio>
#include <string>
#include <vector>

#include "core/command_line.h"
#include "support/reference_scene.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

struct Options {
  std::vector<double> young = {5e3, 1e4, 2e4, 6e4, 1e5, 2e5, 2e6};
  std::vector<unsigned> elements = {12, 24, 36, 48};
  std::vector<unsigned> layers = {1, 2, 3, 4};
  std::vector<std::string> laws = {"neo_hooke", "corotated", "st_venant"};
  std::string body = "sheet", lift;
};

pb::ElasticLaw law_of(const std::string& name) {
  return name == "neo_hooke"   ? pb::LAW_NEO_HOOKE
         : name == "corotated" ? pb::LAW_COROTATED
                               : pb::LAW_ST_VENANT_KIRCHHOFF;
}

test::ReferenceCase make_case(const Options& o, const std::string& law, double young, unsigned n,
                              unsigned layers) {
  test::ReferenceCase c;
  c.nx = c.ny = 31;
  c.anchor = -0.042;
  c.ex = c.ey = n;
  if (o.body == "beam") {  // 6 x 3 x 87 mm
    c.nx = 3;
    c.ex = 4;
  } else if (o.body == "stubby") {  // 30 x 27 x 87 mm
    c.nx = 11;
    c.ex = n / 3;
    c.thickness = 0.027;
  }
  c.ez = layers;
  c.young = young;
  c.poisson = 0.45;
  c.damping = 20;
  c.period = 0.2;
  c.law = law_of(law);
  c.integrator = pb::INTEGRATOR_BACKWARD_EULER;
  const Eigen::Vector2d corner(0.035, 0.035), edge(0, 0.038), middle(0, 0.01);
  if (!o.lift.empty())
    c.pinches.push_back({o.lift == "corner" ? corner : o.lift == "edge" ? edge : middle, 0.005});
  return c;
}

struct StaticState {
  std::vector<Vector3d> points;
  Vector3d force = Vector3d::Zero();
};

/// At rest under its weight, lifted where the case has a pinch.
StaticState settle(const test::ReferenceCase& c, const Vector3d& lift, const char* law) {
  ReferenceTissue tissue(test::make_model(c));
  Vector3d tip(0, 0, 1);
  if (!c.pinches.empty()) {
    tip << c.pinches[0].centre, 0;
    tissue.hold(0, tip, c.pinches[0].radius, false);
  }
  const auto moves = [&tissue] {
    for (const Vector3d& v : tissue.node_velocities()) {
      if (v.norm() > 1e-7) return true;
    }
    return false;
  };
  const auto at = [&](int k) { return Vector3d(tip + std::min(1.0, k / 10.0) * lift); };
  int step = 0;
  for (; (step < 11 || moves()) && step < 400 && tissue.healthy(0); ++step) {
    const ToolMotion motion{at(step), at(step + 1)};
    tissue.step({&motion, 1});
  }
  StaticState state;
  for (int k = 0; k < tissue.particles(); ++k) state.points.push_back(tissue.position(0, k));
  state.force = tissue.held_force(0);
  const Vector3d& p = state.points[(c.nx / 2) * c.ny + c.ny - 1];
  std::printf("%-10s %8.0f Pa %3u x %3u x %u  tip %9.4f %9.4f mm  force %9.4f mN  %3d steps%s%s\n",
              law, c.young, c.ex, c.ey, c.ez, 1e3 * p.y(), 1e3 * p.z(), 1e3 * state.force.norm(),
              step, moves() ? "  still moves" : "",
              tissue.healthy(0) ? "" : ("  " + tissue.failure(0)).c_str());
  std::fflush(stdout);
  return state;
}

/// Of the meshes of a row against its last.
void compare(const std::vector<StaticState>& states) {
  const StaticState& finest = states.back();
  for (const StaticState& state : states) {
    double squares = 0;
    for (std::size_t k = 0; k < state.points.size(); ++k)
      squares += (state.points[k] - finest.points[k]).squaredNorm();
    std::printf("    %8.4f mm rms  %7.3f %% of force\n",
                1e3 * std::sqrt(squares / static_cast<double>(state.points.size())),
                100 * (state.force - finest.force).norm() / std::max(1e-12, finest.force.norm()));
  }
}

}  // namespace
}  // namespace omentum

int main(int argc, char** argv) {
  omentum::Options o;
  CLI::App app{"Refinement of static states of the reference solid."};
  app.add_option("--young", o.young, "[Pa]");
  app.add_option("--elements", o.elements, "Along the sheet");
  app.add_option("--layers", o.layers, "Through the thickness");
  app.add_option("--law", o.laws, "neo_hooke, corotated, st_venant");
  app.add_option("--body", o.body, "sheet, beam, stubby");
  app.add_option("--lift", o.lift, "corner, edge, middle; otherwise it droops");
  CLI11_PARSE(app, argc, argv);
  for (const std::string& law : o.laws) {
    for (const double young : o.young) {
      std::vector<omentum::StaticState> states;
      for (const unsigned layers : o.layers) {
        for (const unsigned n : o.elements) {
          states.push_back(omentum::settle(omentum::make_case(o, law, young, n, layers),
                                           omentum::Vector3d(-0.003, -0.006, 0.03), law.c_str()));
        }
      }
      omentum::compare(states);
    }
  }
  return 0;
}

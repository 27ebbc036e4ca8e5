// The matrix A of the elastic shell (docs/tissue.md 8): what of the stiffness is in it, its
// factors and the keys by which lanes share them.
#include <Eigen/SparseCore>
#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/trig.h"
#include "sim_worker/shell/shell_model.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

constexpr double kKeyRatio = 1.25;  // E/E0 in (0.8, 1]: settles and follows (docs/tissue.md 8)
constexpr int kDensityKeys = 1024;  // key = kDensityKeys x key of density + key of stiffness

struct KeyParts {
  int stiffness = 0, density = 0;
};

KeyParts split_key(int key) {
  KeyParts parts;
  for (; key > kDensityKeys / 2; key -= kDensityKeys) ++parts.density;
  for (; key < -kDensityKeys / 2; key += kDensityKeys) --parts.density;
  parts.stiffness = key;
  return parts;
}

double grid_value(int steps) {
  double value = 1;
  for (int k = 0; k < steps; ++k) value *= kKeyRatio;
  for (int k = 0; k > steps; --k) value /= kKeyRatio;
  return value;
}

/// Largest stiffness of a triangle against a change of F, per nominal stretch stiffness: 2 mu + 2
/// lambda = E / (1 - nu) for the area mode; the preconditioner must not be softer than the
/// material.
double preconditioner_modulus(const ShellStructure& structure) {
  return structure.shear + 2 * structure.area;
}

/// E t / 2: stiffness of one fibre direction per ratio [N/m].
double fibre_unit(const ShellTissueModel& model) {
  return model.material.young_modulus_pa() * model.thickness / 2;
}

/// d F / d x_i of the three corners, times the pitch.
using ShapeGradients = std::array<Eigen::Vector2d, 3>;

ShapeGradients shape_gradients(const SheetTriangle& triangle, double pitch) {
  const Eigen::Vector2d one = pitch * triangle.inverse.row(0).transpose();
  const Eigen::Vector2d two = pitch * triangle.inverse.row(1).transpose();
  return {-(one + two), one, two};
}

using SparseMatrix = Eigen::SparseMatrix<double>;

/// A on the free nodes; `free_index` is -1 for fixed nodes.
SparseMatrix assemble(const ShellTissueModel& model, double stiffness, double density,
                      const std::vector<int>& free_index, int free_count) {
  const ShellStructure& structure = model.structure;
  std::vector<Eigen::Triplet<double>> entries;
  const auto add = [&](int i, int j, double value) {
    const int row = free_index[i];
    const int column = free_index[j];
    if (row >= 0 && column >= 0) entries.emplace_back(row, column, value);
  };
  const double inverse_step2 = 1 / (model.effective_step() * model.effective_step());
  for (int i = 0; i < model.nodes(); ++i) {
    add(i, i, model.mass_at(i, density) * inverse_step2 + stiffness * model.anchor[i]);
    for (int m = structure.bending.begin[i]; m < structure.bending.begin[i + 1]; ++m) {
      const double value = stiffness * structure.bending.value[m];
      add(i, structure.bending.node[m], value);
      add(i, i, -value);
    }
    if (model.anchor_turn[i] == 0) continue;
    const double turn = stiffness * model.anchor_turn[i];
    add(i, i, turn);
    add(i + 1, i + 1, turn);
    add(i, i + 1, -turn);
    add(i + 1, i, -turn);
  }
  const auto add_leg = [&](int i, int j, double leg) {
    add(i, i, leg);
    add(j, j, leg);
    add(i, j, -leg);
    add(j, i, -leg);
  };
  // Fibres along a: |a_x f_x + a_y f_y|^2 <= (a_x^2 + |a_x a_y|) |f_x|^2 + ...
  const trig::SinCos a = trig::sin_cos(model.effects.fibre_angle);
  const double fibre = model.effects.fibre_ratio * fibre_unit(model);
  const double both = std::fabs(a.sin * a.cos);
  const double along_x = preconditioner_modulus(structure) + fibre * (a.cos * a.cos + both);
  const double along_y = preconditioner_modulus(structure) + fibre * (a.sin * a.sin + both);
  int triangle = 0;
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    const double cell = stiffness * structure.cell[triangle++ / 2];
    add_leg(x0, x1, cell * along_x);
    add_leg(y0, y1, cell * along_y);
  });
  for (std::size_t t = 0; t < model.mesh.triangles.size(); ++t) {
    const SheetTriangle& of_mesh = model.mesh.triangles[t];
    const double cell = stiffness * structure.cell[t];
    const ShapeGradients g = shape_gradients(of_mesh, model.pitch);
    for (std::size_t i = 0; i < 3; ++i) {
      for (std::size_t j = 0; j < 3; ++j) {
        add(of_mesh.node[i], of_mesh.node[j],
            cell * (along_x * g[i].x() * g[j].x() + along_y * g[i].y() * g[j].y()));
      }
    }
  }
  SparseMatrix matrix(free_count, free_count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

/// How much steeper unloading may be than the factor knows. Only what was just at its peak is so
/// steep, yet the factor slows the whole sheet. Times the kSlack of a drawn lane this must stay
/// below 1.7, from where on a lifted sheet of nu 0 shivers at rest
/// (tests/sim_worker/tissue/mullins_test.cpp).
constexpr double kUnloadingSlack = 1.4;

/// Stiffness of the step with memory over that without: Prony branches, slider, and the steepest
/// unloading of softened material, 1 + 3 softening, less its slack.
double memory_tangent(const EffectValues& effects, double step) {
  const double unloading = std::max(1.0, (1 + 3 * effects.softening) / kUnloadingSlack);
  return unloading * (1 + make_prony(effects, step).gains) + effects.slider_ratio;
}

/// Rows of A: -1 for fixed nodes, and the node of each row.
struct FreeNodes {
  explicit FreeNodes(const ShellTissueModel& model) {
    for (int i = 0; i < model.nodes(); ++i) {
      const bool fixed = model.body.fixed[i] != 0;
      row.push_back(fixed ? -1 : count());
      if (!fixed) node.push_back(i);
    }
  }
  int count() const { return static_cast<int>(node.size()); }
  std::vector<int> row, node;
};

PanelFactor make_factor(const ShellTissueModel& model, double stiffness, double density) {
  const FreeNodes free(model);
  const SparseMatrix matrix = assemble(model, stiffness, density, free.row, free.count());
  return factorize(matrix, free.node);
}

}  // namespace

void ShellTissueModel::make_preconditioner() {
  const FreeNodes free(*this);
  const SparseMatrix matrix =
      assemble(*this, memory_tangent(effects, substep()), 1, free.row, free.count());
  const double inverse_step2 = 1 / (effective_step() * effective_step());
  const auto entry = [&](int i, int j) {
    const int row = free.row[i];
    const int column = free.row[j];
    return row < 0 || column < 0 ? 0.0 : matrix.coeff(row, column);
  };
  for (int i = 0; i < nodes(); ++i) {
    preconditioner_diagonal.push_back(
        free.row[i] < 0 ? 0.0 : entry(i, i) - mass_at(i, 1) * inverse_step2);
    const NodeMatrix& bending = structure.bending;
    for (int m = bending.begin[i]; m < bending.begin[i + 1]; ++m) {
      preconditioner.push_back(entry(i, bending.node[m]));
    }
  }
}

int ShellTissueModel::factor_key(double stiffness_scale) {
  // 1e-9: a scale that lies on the grid belongs to its own step whatever its rounding.
  int key = 0;
  double step = 1;
  while (step < stiffness_scale * (1 - 1e-9)) {
    step *= kKeyRatio;
    ++key;
  }
  while (step / kKeyRatio >= stiffness_scale * (1 - 1e-9)) {
    step /= kKeyRatio;
    --key;
  }
  return key;
}

int ShellTissueModel::factor_key(double stiffness_scale, const EffectValues& lane,
                                 const ShellStructure& lane_structure, double peak) const {
  // An effect may exceed the factor a little, as the step allows (up to 1.25): a small one then
  // changes the solution smoothly, without a jump to another factor.
  constexpr double kSlack = 1.12;
  double tangent = memory_tangent(lane, substep()) / memory_tangent(effects, substep());
  // In steps: a new factor now and then, not in every step. Steps of two showed as jumps of 0.09 mm
  // in a lift in motion.
  double level = 1;
  while (level * kSlack < peak && level < 4096) level *= kKeyRatio;
  tangent *= level;
  if (lane.fibre_ratio != effects.fibre_ratio || lane.fibre_angle != effects.fibre_angle) {
    tangent += lane.fibre_ratio;
  }
  double ratio = 1;
  if (!lane.same_structure(effects)) {
    const double modulus =
        preconditioner_modulus(lane_structure) / preconditioner_modulus(structure);
    for (std::size_t c = 0; c < structure.cell.size(); ++c) {
      ratio = std::max(ratio, modulus * lane_structure.cell[c] / structure.cell[c]);
    }
    for (std::size_t i = 0; i + 1 < structure.bending.begin.size(); ++i) {
      double own = 0;
      double base = 0;
      for (int m = structure.bending.begin[i]; m < structure.bending.begin[i + 1]; ++m) {
        own += std::fabs(lane_structure.bending.value[m]);
        base += std::fabs(structure.bending.value[m]);
      }
      if (base > 0) ratio = std::max(ratio, own / base);
    }
  }
  const double stretch = 1 / ((1 + lane.stretch) * (1 + lane.stretch));
  ratio *= std::max(1.0, stretch);
  if (lane.anchor_compliance > 0 && effects.anchor_compliance > 0) {
    ratio = std::max(ratio, effects.anchor_compliance / lane.anchor_compliance);
  }
  const double heavier = (1 + lane.density_change) / (1 + effects.density_change);
  const double thicker =
      lane.same_structure(effects)
          ? 1.0
          : *std::max_element(lane_structure.mass.begin(), lane_structure.mass.end()) /
                *std::max_element(structure.mass.begin(), structure.mass.end());
  const auto slack_key = [](double scale) {
    return scale > 1 / kSlack && scale < kSlack ? 0 : factor_key(std::max(1e-3, scale));
  };
  return kDensityKeys * slack_key(heavier * std::max(1.0, thicker)) +
         factor_key(stiffness_scale * std::max(1.0, tangent * ratio / kSlack));
}

double ShellTissueModel::key_stiffness(int key) { return grid_value(split_key(key).stiffness); }

double ShellTissueModel::key_density(int key) const {
  return (1 + effects.density_change) * grid_value(split_key(key).density);
}

std::shared_ptr<const PanelFactor> ShellTissueModel::factor(int key) const {
  const std::lock_guard lock(mutex_);
  auto& factor = factors_[key];
  if (factor == nullptr) {
    const double stiffness = key_stiffness(key) * memory_tangent(effects, substep());
    factor = std::make_shared<const PanelFactor>(make_factor(*this, stiffness, key_density(key)));
  }
  return factor;
}

}  // namespace omentum

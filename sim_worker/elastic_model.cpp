#include "sim_worker/elastic_model.h"

#include <Eigen/SparseCholesky>
#include <algorithm>
#include <array>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "sim_worker/elastic_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kKeyRatio = 1.25;  // E/E0 in (0.8, 1]: settles and follows (tissue.md section 8)
constexpr int kMaxContactNodes = 5000;  // A^-1 is dense: 200 MB per factor key in double

/// One finite-difference stencil of the plate: energy weight/2 |sum c_i x_i|^2.
struct Stencil {
  std::array<std::int32_t, 4> node{};
  std::array<double, 4> c{};
  int size = 0;
};

/// Symmetric matrix under construction, dense rows of few entries kept sorted.
class MatrixBuilder {
 public:
  explicit MatrixBuilder(int nodes) : rows_(static_cast<std::size_t>(nodes)) {}

  /// Adds the product a(x) b(x) of two stencils, symmetrised, times weight.
  void add_product(const Stencil& a, const Stencil& b, double weight) {
    for (std::size_t i = 0; i < static_cast<std::size_t>(a.size); ++i) {
      for (std::size_t j = 0; j < static_cast<std::size_t>(b.size); ++j) {
        const double value = 0.5 * weight * a.c[i] * b.c[j];
        add(a.node[i], b.node[j], value);
        add(b.node[j], a.node[i], value);
      }
    }
  }

  /// Off-diagonal part; the diagonal is what makes the rows sum to zero.
  NodeMatrix finish() const {
    NodeMatrix matrix;
    matrix.begin.push_back(0);
    for (std::size_t i = 0; i < rows_.size(); ++i) {
      for (const auto& [node, value] : rows_[i]) {
        if (node == static_cast<std::int32_t>(i)) continue;
        matrix.node.push_back(node);
        matrix.value.push_back(value);
      }
      matrix.begin.push_back(static_cast<std::int32_t>(matrix.node.size()));
    }
    return matrix;
  }

 private:
  void add(std::int32_t i, std::int32_t j, double value) {
    rows_[static_cast<std::size_t>(i)][j] += value;
  }
  std::vector<std::map<std::int32_t, double>> rows_;
};

/// Plate energy D/2 int (kxx^2 + kyy^2 + 2 nu kxx kyy + 2 (1 - nu) kxy^2) by finite differences
/// (tissue.md section 6). Rows on the rim own half a cell; there the bending moment across the rim
/// is zero, so the other curvature is free and the plate is a beam of E t^3 / 12. A stencil centred
/// on a clamped node bends on its free side only, half a cell long: the same turn there is twice
/// the curvature, which doubles the energy. Counted once, the plate would be clamped half a cell
/// inside the clamp, 1.5 mm at a pitch of 3 mm, the membrane at it
/// (benchmarks/compare_elastic.cpp).
NodeMatrix make_bending(const ElasticTissueModel& model, double thickness) {
  const double nu = model.material.poisson_ratio();
  const double beam = model.material.bending_scale() * model.material.young_modulus_pa() *
                      thickness * thickness * thickness / 12;
  const double plate = beam / (1 - nu * nu);
  const double pitch2 = model.pitch * model.pitch;
  const int nx = model.count_x;
  const int ny = model.count_y;
  MatrixBuilder builder(model.nodes());
  const auto fixed = [&](int i) { return model.body.fixed[static_cast<std::size_t>(i)] != 0; };
  const auto second = [&](int i, int stride) {
    return Stencil{{i - stride, i, i + stride, 0}, {1 / pitch2, -2 / pitch2, 1 / pitch2, 0}, 3};
  };
  for (int ix = 0; ix < nx; ++ix) {
    for (int iy = 0; iy < ny; ++iy) {
      const int i = ny * ix + iy;
      const bool inside_x = ix > 0 && ix + 1 < nx;
      const bool inside_y = iy > 0 && iy + 1 < ny;
      const double stiffness = inside_x && inside_y ? plate : 0.5 * beam;
      const auto add_curvature = [&](int stride) {
        const bool clamp_edge = fixed(i) && fixed(i - stride) != fixed(i + stride);
        builder.add_product(second(i, stride), second(i, stride),
                            (clamp_edge ? 2 : 1) * stiffness * pitch2);
      };
      if (inside_x) add_curvature(ny);
      if (inside_y) add_curvature(1);
      if (inside_x && inside_y && nu > 0) {
        // Energy nu D kxx kyy = weight/2 (kxx kyy) with weight 2 nu D.
        builder.add_product(second(i, ny), second(i, 1), 2 * nu * plate * pitch2);
      }
      if (ix + 1 < nx && iy + 1 < ny) {
        const Stencil twist{
            {i, i + 1, i + ny, i + ny + 1}, {1 / pitch2, -1 / pitch2, -1 / pitch2, 1 / pitch2}, 4};
        builder.add_product(twist, twist, 2 * (1 - nu) * plate * pitch2);
      }
    }
  }
  return builder.finish();
}

/// Calls fn(x-leg tail, x-leg head, y-leg tail, y-leg head) for the two triangles of every cell, in
/// the order of elastic_kernel.inl.
template <typename Function>
void for_each_triangle(const ElasticTissueModel& model, Function&& fn) {
  for (int ix = 0; ix + 1 < model.count_x; ++ix) {
    for (int iy = 0; iy + 1 < model.count_y; ++iy) {
      const int a = model.count_y * ix + iy;
      const int b = a + model.count_y;
      const int c = b + 1;
      const int e = a + 1;
      if ((ix + iy) % 2 == 0) {
        fn(a, b, b, c);
        fn(e, c, a, e);
      } else {
        fn(a, b, a, e);
        fn(e, c, b, c);
      }
    }
  }
}

std::vector<double> lumped_mass(const ElasticTissueModel& model, double density, double thickness) {
  const double third = density * thickness * 0.5 * model.pitch * model.pitch / 3;
  std::vector<double> mass(static_cast<std::size_t>(model.nodes()), 0.0);
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    // The legs share the corner of the right angle: three of the four indices are different.
    mass[static_cast<std::size_t>(x0)] += third;
    mass[static_cast<std::size_t>(x1)] += third;
    mass[static_cast<std::size_t>(y0 == x0 || y0 == x1 ? y1 : y0)] += third;
  });
  return mass;
}

/// Largest stiffness of a triangle against a change of F, per nominal stretch stiffness: 2 mu + 2
/// lambda = E / (1 - nu) for the area mode; the metric must not be softer than the material.
double metric_modulus(const ElasticTissueModel& model) { return model.shear + 2 * model.area; }

using SparseMatrix = Eigen::SparseMatrix<double>;
using Cholesky = Eigen::SimplicialLLT<SparseMatrix, Eigen::Lower,
                                      Eigen::AMDOrdering<SparseMatrix::StorageIndex>>;

/// A on the free nodes; `free_index` is -1 for fixed nodes.
SparseMatrix assemble(const ElasticTissueModel& model, double stiffness,
                      const std::vector<int>& free_index, int free_count) {
  std::vector<Eigen::Triplet<double>> entries;
  const auto add = [&](int i, int j, double value) {
    const int row = free_index[static_cast<std::size_t>(i)];
    const int column = free_index[static_cast<std::size_t>(j)];
    if (row >= 0 && column >= 0) entries.emplace_back(row, column, value);
  };
  const double inverse_step2 = 1 / (model.effective_step() * model.effective_step());
  for (int i = 0; i < model.nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    add(i, i, model.mass[k] * inverse_step2);
    for (int m = model.bending.begin[k]; m < model.bending.begin[k + 1]; ++m) {
      const double value = stiffness * model.bending.value[static_cast<std::size_t>(m)];
      add(i, model.bending.node[static_cast<std::size_t>(m)], value);
      add(i, i, -value);
    }
  }
  const double leg = stiffness * metric_modulus(model);
  const auto add_leg = [&](int i, int j) {
    add(i, i, leg);
    add(j, j, leg);
    add(i, j, -leg);
    add(j, i, -leg);
  };
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    add_leg(x0, x1);
    add_leg(y0, y1);
  });
  SparseMatrix matrix(free_count, free_count);
  matrix.setFromTriplets(entries.begin(), entries.end());
  return matrix;
}

/// Rows below the diagonal of each column of L.
std::vector<std::vector<int>> column_patterns(const SparseMatrix& l) {
  std::vector<std::vector<int>> pattern(static_cast<std::size_t>(l.cols()));
  for (int c = 0; c < l.cols(); ++c) {
    for (SparseMatrix::InnerIterator it(l, c); it; ++it) {
      if (it.row() > c) pattern[static_cast<std::size_t>(c)].push_back(static_cast<int>(it.row()));
    }
  }
  return pattern;
}

/// Last column of the panel that begins at `first`: neighbours that follow each other in the
/// elimination tree, as long as few zeros are stored.
int last_of_panel(const std::vector<std::vector<int>>& pattern, int first) {
  int last = first;
  std::size_t entries = pattern[static_cast<std::size_t>(first)].size();
  while (last + 1 - first < kMaxPanelWidth && last + 1 < static_cast<int>(pattern.size())) {
    const auto& below = pattern[static_cast<std::size_t>(last)];
    if (below.empty() || below.front() != last + 1) break;
    const auto& next = pattern[static_cast<std::size_t>(last + 1)];
    const std::size_t width = static_cast<std::size_t>(last + 2 - first);
    const std::size_t dense = width * next.size() + width * (width - 1) / 2;
    entries += next.size();
    if (dense > entries + entries / 2) break;
    ++last;
  }
  return last;
}

/// Stores L as dense panels whose rows and columns are node indices.
ElasticFactor make_panels(const SparseMatrix& l, const std::vector<int>& node_of) {
  ElasticFactor factor;
  const auto pattern = column_patterns(l);
  for (int first = 0; first < l.cols();) {
    const int last = last_of_panel(pattern, first);
    const auto& below = pattern[static_cast<std::size_t>(last)];
    const int width = last - first + 1;
    const auto rows = static_cast<int>(below.size());
    factor.panels.push_back({width, static_cast<std::int32_t>(factor.panel_node.size()), rows,
                             static_cast<std::int32_t>(factor.panel_value.size())});
    std::vector<int> index;
    for (int c = first; c <= last; ++c) index.push_back(c);
    index.insert(index.end(), below.begin(), below.end());
    for (const int row : index) {
      factor.panel_node.push_back(node_of[static_cast<std::size_t>(row)]);
      for (int c = first; c <= last; ++c) {
        const double value = row < c ? 0.0 : l.coeff(row, c);
        factor.panel_value.push_back(row == c ? 1 / value : value);
      }
    }
    first = last + 1;
  }
  return factor;
}

ElasticFactor make_factor(const ElasticTissueModel& model, double stiffness) {
  std::vector<int> free_index;
  std::vector<int> free_node;
  for (int i = 0; i < model.nodes(); ++i) {
    const bool fixed = model.body.fixed[static_cast<std::size_t>(i)] != 0;
    free_index.push_back(fixed ? -1 : static_cast<int>(free_node.size()));
    if (!fixed) free_node.push_back(i);
  }
  const auto free_count = static_cast<int>(free_node.size());
  const SparseMatrix matrix = assemble(model, stiffness, free_index, free_count);
  const Cholesky cholesky(matrix);
  OMENTUM_CHECK(cholesky.info() == Eigen::Success);
  std::vector<int> node_of(free_node.size());
  for (int k = 0; k < free_count; ++k) {
    node_of[static_cast<std::size_t>(cholesky.permutationP().indices()(k))] =
        free_node[static_cast<std::size_t>(k)];
  }
  ElasticFactor factor = make_panels(SparseMatrix(cholesky.matrixL()), node_of);
  const auto entry = [&](int i, int j) {
    const int row = free_index[static_cast<std::size_t>(i)];
    const int column = free_index[static_cast<std::size_t>(j)];
    return row < 0 || column < 0 ? 0.0 : matrix.coeff(row, column);
  };
  for (int i = 0; i < model.nodes(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    factor.metric_diagonal.push_back(entry(i, i));
    for (int m = model.bending.begin[k]; m < model.bending.begin[k + 1]; ++m) {
      factor.metric.push_back(entry(i, model.bending.node[static_cast<std::size_t>(m)]));
    }
  }
  return factor;
}

}  // namespace

double decay(double x) {
  // exp(-x) = (exp(-x/64))^64; 20 terms leave 1e-20 for x <= 64.
  const double y = x / 64;
  double value = 1;
  for (int k = 20; k >= 1; --k) value = 1 - y / k * value;
  for (int k = 0; k < 6; ++k) value *= value;
  return value;
}

void ElasticFactor::solve(Eigen::MatrixXd& b) const {
  for (const FactorPanel& panel : panels) {
    const std::int32_t* const node = panel_node.data() + panel.node_begin;
    const double* value = panel_value.data() + panel.value_begin;
    for (int k = 0; k < panel.width; ++k, value += panel.width) {
      for (int j = 0; j < k; ++j) b.col(node[k]) -= value[j] * b.col(node[j]);
      b.col(node[k]) *= value[k];
    }
    for (int r = 0; r < panel.rows; ++r, value += panel.width) {
      for (int k = 0; k < panel.width; ++k) {
        b.col(node[panel.width + r]) -= value[k] * b.col(node[k]);
      }
    }
  }
  for (auto panel = panels.rbegin(); panel != panels.rend(); ++panel) {
    const std::int32_t* const node = panel_node.data() + panel->node_begin;
    const double* const block = panel_value.data() + panel->value_begin;
    const double* value = block + panel->width * panel->width;
    for (int r = 0; r < panel->rows; ++r, value += panel->width) {
      for (int k = 0; k < panel->width; ++k) {
        b.col(node[k]) -= value[k] * b.col(node[panel->width + r]);
      }
    }
    for (int k = panel->width - 1; k >= 0; --k) {
      for (int j = k + 1; j < panel->width; ++j) {
        b.col(node[k]) -= block[panel->width * j + k] * b.col(node[j]);
      }
      b.col(node[k]) *= block[panel->width * k + k];
    }
  }
}

double ElasticTissueModel::effective_step() const {
  return parameters.integrator() == pb::INTEGRATOR_BDF2 ? 2 * substep() / 3 : substep();
}

int ElasticTissueModel::factor_key(double stiffness_scale) {
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

std::shared_ptr<const ElasticFactor> ElasticTissueModel::factor(int key) const {
  const std::lock_guard lock(mutex_);
  auto& factor = factors_[key];
  if (factor == nullptr) {
    double stiffness = 1;
    for (int k = 0; k < key; ++k) stiffness *= kKeyRatio;
    for (int k = 0; k > key; --k) stiffness /= kKeyRatio;
    factor = std::make_shared<const ElasticFactor>(make_factor(*this, stiffness));
  }
  return factor;
}

std::shared_ptr<const Eigen::MatrixXd> ElasticTissueModel::inverse(int key) const {
  const auto shared_factor = factor(key);
  const std::lock_guard lock(mutex_);
  auto& inverse = inverses_[key];
  if (inverse == nullptr) {
    auto matrix = std::make_shared<Eigen::MatrixXd>(Eigen::MatrixXd::Zero(nodes(), nodes()));
    for (int i = 0; i < nodes(); ++i) {
      if (body.fixed[static_cast<std::size_t>(i)] == 0) (*matrix)(i, i) = 1;
    }
    shared_factor->solve(*matrix);
    inverse = matrix;
  }
  return inverse;
}

std::shared_ptr<const ElasticTissueModel> make_elastic_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>&) {
  const pb::Tissue& tissue = scene.config.tissue();
  if (tissue.material().law() != pb::LAW_COROTATED) {
    throw_error("scene.tissue.material.law: {}, allowed for the model elastic: LAW_COROTATED",
                pb::ElasticLaw_Name(tissue.material().law()));
  }
  if (!tissue.has_grid()) {
    throw_error("scene.tissue.volume: a solid, allowed for the model elastic: grid");
  }
  if (scene.bodies.size() + 1 > kMaxShapes) {
    throw_error("scene.rigid_body: {} bodies, allowed at most {}", scene.bodies.size(),
                kMaxShapes - 1);
  }
  auto model = std::make_shared<ElasticTissueModel>();
  model->body = scene.tissue;
  model->control_period = control_period;
  model->material = tissue.material();
  model->parameters = tissue.elastic();
  model->count_x = static_cast<int>(tissue.grid().count_x());
  model->count_y = static_cast<int>(tissue.grid().count_y());
  model->pitch = tissue.grid().pitch_m();
  OMENTUM_CHECK(model->nodes() == static_cast<int>(model->body.particles.size()));
  model->gravity = scene.gravity;
  model->static_friction = tissue.static_friction();
  model->dynamic_friction = tissue.dynamic_friction();
  model->contact_bodies = scene.bodies;
  const pb::Tool& tool = scene.config.tool();
  model->tool_contact = tool.contact();
  model->tool_radius = tool.shaft_radius_m();
  model->tool_start = tool.shaft_start_m() + tool.shaft_radius_m();
  model->tool_length = tool.shaft_length_m();
  if (model->has_contact() && model->nodes() > kMaxContactNodes) {
    throw_error("scene.tissue.grid: {} nodes, allowed for the model elastic with contact: {}",
                model->nodes(), kMaxContactNodes);
  }

  const double thickness = model->body.thickness;
  const double e = model->material.young_modulus_pa();
  const double nu = model->material.poisson_ratio();
  // t a_T / pitch^2 = t / 2; mu and lambda of plane stress.
  model->shear = e / (1 + nu) * thickness / 2;
  model->area = e * nu / (1 - nu * nu) * thickness / 2;
  model->grasp_stiffness = e * thickness;
  model->mass = lumped_mass(*model, tissue.density_kg_per_m3(), thickness);
  model->bending = make_bending(*model, thickness);
  return model;
}

std::unique_ptr<Tissue<float>> ElasticTissueModel::make_tissue(const Kernel<float>& kernel) const {
  return std::make_unique<ElasticTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> ElasticTissueModel::make_tissue(
    const Kernel<double>& kernel) const {
  return std::make_unique<ElasticTissue<double>>(shared_from_this(), kernel);
}

ElasticEnergy elastic_energy(const ElasticTissueModel& model, std::span<const Vector3d> p) {
  ElasticEnergy energy;
  for_each_triangle(model, [&](int x0, int x1, int y0, int y1) {
    Eigen::Matrix<double, 3, 2> f;
    f.col(0) = (p[static_cast<std::size_t>(x1)] - p[static_cast<std::size_t>(x0)]) / model.pitch;
    f.col(1) = (p[static_cast<std::size_t>(y1)] - p[static_cast<std::size_t>(y0)]) / model.pitch;
    const Eigen::Matrix2d c = f.transpose() * f;
    const double tau = std::sqrt(c.trace() + 2 * std::sqrt(c.determinant()));
    // |F - R|^2 = tr C - 2 tr S + 2; shear and area carry t a_T / pitch^2.
    const double a = model.pitch * model.pitch;
    energy.membrane += a * (0.5 * model.shear * (c.trace() - 2 * tau + 2) +
                            0.5 * model.area * (tau - 2) * (tau - 2));
  });
  for (std::size_t i = 0; i < p.size(); ++i) {
    for (int k = model.bending.begin[i]; k < model.bending.begin[i + 1]; ++k) {
      const auto m = static_cast<std::size_t>(k);
      const auto j = static_cast<std::size_t>(model.bending.node[m]);
      energy.bending -= 0.25 * model.bending.value[m] * (p[i] - p[j]).squaredNorm();
    }
  }
  return energy;
}

}  // namespace omentum

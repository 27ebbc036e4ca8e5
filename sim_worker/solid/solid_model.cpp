#include "sim_worker/solid/solid_model.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "core/check.h"
#include "sim_worker/geometry/rigid_gap.h"
#include "sim_worker/solid/solid_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Tetrahedron = std::array<std::int32_t, 10>;

// Integration points and edges: solid_kernel.inl.
constexpr double kNear = 0.58541019662496845446;
constexpr double kFar = 0.13819660112501051518;

/// Gradients of the volume coordinates in the rows.
Eigen::Matrix<double, 4, 3> corner_gradients(const SolidMesh& mesh, const Tetrahedron& t) {
  const auto node = [&](std::size_t k) { return mesh.nodes[t[k]]; };
  Matrix3d edges;
  for (int k = 0; k < 3; ++k) edges.col(k) = node(static_cast<std::size_t>(k) + 1) - node(0);
  const Matrix3d inverse = edges.inverse();
  Eigen::Matrix<double, 4, 3> g;
  g.bottomRows<3>() = inverse;
  g.row(0) = -inverse.colwise().sum();
  return g;
}

/// Gradients of the ten shape functions at integration point q in the rows.
Eigen::Matrix<double, 10, 3> shape_gradients(const Eigen::Matrix<double, 4, 3>& g, int q) {
  const auto L = [q](int a) { return a == q ? kNear : kFar; };
  Eigen::Matrix<double, 10, 3> n;
  for (int a = 0; a < 4; ++a) n.row(a) = (4 * L(a) - 1) * g.row(a);
  for (int k = 0; k < 6; ++k) {
    const int a = kSolidEdge[k][0];
    const int b = kSolidEdge[k][1];
    n.row(4 + k) = 4 * (L(a) * g.row(b) + L(b) * g.row(a));
  }
  return n;
}

Eigen::Matrix<double, 4, 3> gradients_of(const SolidTissueModel& model, std::size_t t) {
  return Eigen::Map<const Eigen::Matrix<double, 4, 3, Eigen::RowMajor>>(&model.gradient[12 * t]);
}

void set_geometry(SolidTissueModel& model, double density) {
  const std::size_t nodes = model.mesh.nodes.size();
  model.mass.assign(nodes, 0.0);
  for (const Tetrahedron& t : model.mesh.tetrahedra) {
    const Eigen::Matrix<double, 4, 3> g = corner_gradients(model.mesh, t);
    for (int a = 0; a < 4; ++a) {
      for (int k = 0; k < 3; ++k) model.gradient.push_back(g(a, k));
    }
    const double volume = tetrahedron_volume(model.mesh, t);
    model.volume.push_back(volume);
    // Diagonal of the consistent mass matrix, scaled to the whole [Hinton76]: 1/36 and 4/27.
    for (std::size_t k = 0; k < 10; ++k) {
      model.mass[t[k]] += density * volume * (k < 4 ? 1.0 / 36 : 4.0 / 27);
    }
  }
  if (const EffectValues& v = model.effects; v.added_mass > 0) {
    model.added_mass =
        disc_shares(model.body.particles, model.mass, {v.added_x, v.added_y}, v.added_radius);
    for (double& m : model.added_mass) m *= v.added_mass;
  }
  model.on_surface.assign(nodes, 0);
  for (const Eigen::Vector3i& triangle : model.mesh.surface) {
    for (int k = 0; k < 3; ++k) model.on_surface[triangle[k]] = 1;
  }
}

/// The matrix whose factor preconditions: entries by rows and columns of the free nodes.
class FactorMatrix {
 public:
  /// `width`: unknowns per node, 1 or 3.
  FactorMatrix(const SolidTissueModel& model, int width) : width_(width) {
    for (int i = 0; i < model.nodes(); ++i) {
      const bool fixed = model.body.fixed[i] != 0;
      row_of_.push_back(fixed ? -1 : static_cast<int>(unknown_.size()));
      for (int axis = 0; axis < width && !fixed; ++axis) unknown_.push_back(width * i + axis);
    }
  }
  void add(int node, int axis, int other, int other_axis, double value) {
    const int row = row_of_[node];
    const int column = row_of_[other];
    if (row >= 0 && column >= 0) entries_.emplace_back(row + axis, column + other_axis, value);
  }
  /// Inertia on the diagonal, with the scene's effects.
  void add_inertia(const SolidTissueModel& model) {
    const double step = model.effective_step();
    const double density = 1 + model.effects.density_change;
    for (int i = 0; i < model.nodes(); ++i) {
      for (int axis = 0; axis < width_; ++axis)
        add(i, axis, i, axis, model.mass_at(i, density) / (step * step));
    }
  }
  PanelFactor factor() const {
    const auto size = static_cast<Eigen::Index>(unknown_.size());
    Eigen::SparseMatrix<double> matrix(size, size);
    matrix.setFromTriplets(entries_.begin(), entries_.end());
    return factorize(matrix, unknown_);
  }

 private:
  int width_;
  std::vector<int> row_of_, unknown_;
  std::vector<Eigen::Triplet<double>> entries_;
};

/// The preconditioner of a body that may rotate: inertia and a Laplace operator of the shear
/// stiffness. The rotated shear part of the Hessian is as stiff, whatever the rotation; the few
/// stiff volume modes are left to the conjugate gradients.
void set_factor(SolidTissueModel& model) {
  FactorMatrix matrix(model, 1);
  matrix.add_inertia(model);
  const double step = model.effective_step();
  const double density = 1 + model.effects.density_change;
  model.diagonal.clear();
  for (std::size_t i = 0; i < model.mass.size(); ++i) {
    model.diagonal.push_back(model.mass_at(i, density) / (step * step));
    if (model.anchor[i] == 0) continue;
    model.diagonal[i] += model.anchor[i];
    matrix.add(static_cast<int>(i), 0, static_cast<int>(i), 0, model.anchor[i]);
  }
  for (std::size_t t = 0; t < model.volume.size(); ++t) {
    const Tetrahedron& node = model.mesh.tetrahedra[t];
    for (int q = 0; q < 4; ++q) {
      const Eigen::Matrix<double, 10, 3> n = shape_gradients(gradients_of(model, t), q);
      const double shear =
          model.law.shear * model.effects.stiffness_at(model.integration_point(t, q));
      const Eigen::Matrix<double, 10, 10> k = 2 * shear * model.volume[t] / 4 * n * n.transpose();
      for (int a = 0; a < 10; ++a) {
        const std::int32_t i = node[a];
        model.diagonal[i] += k(a, a);
        for (int b = 0; b < 10; ++b) matrix.add(i, 0, node[b], 0, k(a, b));
      }
    }
  }
  model.factor = matrix.factor();
}

/// Hessian of the elastic energy of one element at rest in W, rows 3 k + axis. Small strain has the
/// Lame constants of E and nu, of lambda the part `local` at the points, `bulk` on the mean.
Eigen::Matrix<double, 30, 30> rest_stiffness(const SolidTissueModel& model, std::size_t t) {
  Eigen::Matrix<double, 30, 30> k = Eigen::Matrix<double, 30, 30>::Zero();
  Eigen::Matrix<double, 30, 1> mean = Eigen::Matrix<double, 30, 1>::Zero();
  const double weight = model.volume[t] / 4;
  const Matrix3d to_B = model.body.X_WB.linear().transpose();
  for (int q = 0; q < 4; ++q) {
    const Eigen::Matrix<double, 10, 3> n = shape_gradients(gradients_of(model, t), q) * to_B;
    for (int a = 0; a < 10; ++a) {
      mean.segment<3>(3 * a) += n.row(a).transpose() / 4;
      for (int b = 0; b < 10; ++b) {
        k.block<3, 3>(3 * a, 3 * b) +=
            weight * (model.law.shear * (n.row(a).dot(n.row(b)) * Matrix3d::Identity() +
                                         n.row(b).transpose() * n.row(a)) +
                      model.law.local * n.row(a).transpose() * n.row(b));
      }
    }
  }
  return k + model.volume[t] * model.law.bulk * mean * mean.transpose();
}

/// The preconditioner of a body that is anchored and so rotates little: the Hessian at rest. Its
/// response to a force is the body's, which the contact of a sheet counts on (docs/decisions/0020).
void set_rest_factor(SolidTissueModel& model) {
  FactorMatrix matrix(model, 3);
  matrix.add_inertia(model);
  for (std::size_t t = 0; t < model.volume.size(); ++t) {
    const Tetrahedron& node = model.mesh.tetrahedra[t];
    const Eigen::Matrix<double, 30, 30> k = rest_stiffness(model, t);
    for (int a = 0; a < 30; ++a) {
      for (int b = 0; b < 30; ++b) {
        matrix.add(node[a / 3], a % 3, node[b / 3], b % 3, k(a, b));
      }
    }
  }
  model.factor = matrix.factor();
  model.by_component = true;
}

/// What lies around the body and how it is stepped.
void set_surroundings(SolidTissueModel& model, const Scene& scene, double control_period) {
  OMENTUM_CHECK(model.mesh.nodes.size() == model.body.particles.size());
  model.control_period = control_period;
  model.parameters = scene.config.tissue().elastic();
  model.surroundings = make_surroundings(scene);
}

/// Clamped nodes that the effects of the anchor set free hang on springs.
void release_anchors(SolidTissueModel& model) {
  const EffectValues& effects = model.effects;
  model.anchor = model.make_anchor(effects);
  model.is_anchor.assign(model.anchor.size(), 0);
  if (!effects.moves_anchor()) return;
  bool clamped = false;
  bool held = false;
  for (std::size_t i = 0; i < model.anchor.size(); ++i) {
    if (model.body.fixed[i] == 0) continue;
    const double x = model.body.particles[i].x();
    const bool rigid =
        effects.anchor_compliance == 0 && detached_share(effects, x, 0.5 * model.spacing) == 0;
    clamped = true;
    held = held || rigid || model.anchor[i] > 0;
    if (rigid) continue;
    model.body.fixed[i] = 0;
    model.is_anchor[i] = 1;
  }
  if (clamped && !held) {
    throw_error("scene.tissue.effects.anchor: {} ... {} m detaches the whole clamp, allowed less",
                effects.anchor_free_from, effects.anchor_free_to);
  }
}

/// `stays`: the body is anchored and rotates little.
void set_material(SolidTissueModel& model, double density, bool stays) {
  model.law = make_solid_law(model.material.young_modulus_pa(),
                             model.material.poisson_ratio() + model.effects.poisson_change);
  set_geometry(model, density);
  release_anchors(model);
  set_factor(model);
  if (stays) set_rest_factor(model);
}

/// A body that begins inside another one would be thrown out of it.
void refuse_overlap(const SolidTissueModel& model) {
  for (std::size_t i = 0; i < model.body.particles.size(); ++i) {
    if (model.body.fixed[i] != 0 || model.on_surface[i] == 0) continue;
    const Vector3d p = model.body.X_WB * model.body.particles[i];
    for (const RigidShape& other : model.surroundings.bodies) {
      const double distance = rigid_gap(other, p).distance;
      if (distance >= 0) continue;
      throw_error(
          "scene.body[0]: free node at ({:.4g}, {:.4g}, {:.4g}) m is {:.2g} m inside rigid_body "
          "\"{}\", allowed: none inside at rest",
          p.x(), p.y(), p.z(), -distance, other.name);
    }
  }
}

}  // namespace

SolidLaw make_solid_law(double young_modulus, double poisson_ratio) {
  const double nu = poisson_ratio;
  SolidLaw law;
  law.shear = young_modulus / (2 * (1 + nu));
  const double lame = young_modulus * nu / ((1 + nu) * (1 - 2 * nu));
  // lambda of nu = 0.3 is 1.5 mu; what is beyond it acts on means (solid_kernel.inl).
  law.local = std::min(lame, 1.5 * law.shear);
  law.mu = 4.0 / 3 * law.shear;
  law.lambda = law.local + 5.0 / 6 * law.shear;
  law.bulk = lame - law.local;
  law.alpha = 1 + 0.75 * law.mu / law.lambda;
  return law;
}

EffectValues SolidTissueModel::own_effects(const EffectValues& e) const {
  // No slip: CoupledTissue lets both out of the jaws together, under the load of both.
  return beside_sheet ? effects_of_model(e, kSoftBodyModel) : e;
}

// A node carries the part of the clamp's length, its extent along x_B, that it has of the clamp's
// mass; one that is detached in part gets the spring of a grasp that covers it in part.
std::vector<double> SolidTissueModel::make_anchor(const EffectValues& values) const {
  std::vector<double> spring(mass.size(), 0.0);
  if (!values.moves_anchor()) return spring;
  const auto clamped = [this](std::size_t i) {
    return body.fixed[i] != 0 || (!is_anchor.empty() && is_anchor[i] != 0);
  };
  double whole = 0;
  double low = 1e9;
  double high = -1e9;
  for (std::size_t i = 0; i < mass.size(); ++i) {
    if (!clamped(i)) continue;
    whole += mass[i];
    low = std::min(low, body.particles[i].x());
    high = std::max(high, body.particles[i].x());
  }
  for (std::size_t i = 0; i < mass.size(); ++i) {
    if (!clamped(i)) continue;
    const double detached = detached_share(values, body.particles[i].x(), 0.5 * spacing);
    if (values.anchor_compliance > 0) {
      const double length = (high - low) * mass[i] / whole;
      spring[i] = (1 - detached) * length / values.anchor_compliance;
    } else if (detached > 0) {
      spring[i] = material.young_modulus_pa() * spacing * (1 - detached) / detached;
    }
  }
  return spring;
}

Vector3d SolidTissueModel::integration_point(std::size_t tetrahedron, int q) const {
  Vector3d p = Vector3d::Zero();
  for (int a = 0; a < 4; ++a) {
    const auto node = mesh.tetrahedra[tetrahedron][a];
    p += (a == q ? kNear : kFar) * mesh.nodes[node];
  }
  return p;
}

double SolidTissueModel::effective_step() const {
  return parameters.integrator() == pb::INTEGRATOR_BDF2 ? 2 * substep() / 3 : substep();
}

std::shared_ptr<const SolidTissueModel> make_solid_model(const Scene& scene,
                                                         double control_period) {
  const pb::Tissue& tissue = scene.config.tissue();
  if (tissue.material().law() != pb::LAW_STABLE_NEO_HOOKE) {
    throw_error(
        "scene.tissue.material.law: {}, allowed for a volume of the model elastic: "
        "LAW_STABLE_NEO_HOOKE",
        pb::ElasticLaw_Name(tissue.material().law()));
  }
  refuse_effects(tissue.effects(), kSolidModel, "TISSUE_ELASTIC with a volume");
  auto model = std::make_shared<SolidTissueModel>();
  model->effects =
      make_effects(tissue.effects(), tissue.material().poisson_ratio(), scene.tissue.particles);
  model->body = scene.tissue;
  model->mesh = scene.solid;
  model->material = tissue.material();
  model->spacing = tissue.volume().edge_length_m() / 2;
  set_surroundings(*model, scene, control_period);
  if ((model->effects.adhesion > 0 || model->effects.suction > 0) && scene.bodies.empty()) {
    throw_error("scene.tissue.effects.{}: nothing to stick to, needs a scene.rigid_body",
                model->effects.adhesion > 0 ? "adhesion" : "suction");
  }
  set_material(*model, tissue.density_kg_per_m3(), false);
  return model;
}

std::shared_ptr<const SolidTissueModel> make_soft_body_model(const Scene& scene,
                                                             double control_period) {
  OMENTUM_CHECK(scene.soft_body.has_value() && scene.config.body_size() == 1);
  const pb::DeformableBody& config = scene.config.body(0);
  if (config.material().law() != pb::LAW_STABLE_NEO_HOOKE) {
    throw_error("scene.body[0].material.law: {}, allowed: LAW_STABLE_NEO_HOOKE",
                pb::ElasticLaw_Name(config.material().law()));
  }
  auto model = std::make_shared<SolidTissueModel>();
  model->beside_sheet = true;
  const pb::Tissue& sheet = scene.config.tissue();
  model->effects = model->own_effects(
      make_effects(sheet.effects(), sheet.material().poisson_ratio(), scene.tissue.particles));
  model->body = scene.soft_body->body;
  model->mesh = scene.soft_body->mesh;
  model->material = config.material();
  model->spacing = config.edge_length_m() / 2;
  set_surroundings(*model, scene, control_period);
  const auto& fixed = model->body.fixed;
  set_material(*model, config.density_kg_per_m3(),
               std::find(fixed.begin(), fixed.end(), 1) != fixed.end());
  refuse_overlap(*model);
  return model;
}

std::unique_ptr<Tissue<float>> SolidTissueModel::make_tissue(
    const LaneKernel<float>& kernel) const {
  return std::make_unique<SolidTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> SolidTissueModel::make_tissue(
    const LaneKernel<double>& kernel) const {
  return std::make_unique<SolidTissue<double>>(shared_from_this(), kernel);
}

}  // namespace omentum

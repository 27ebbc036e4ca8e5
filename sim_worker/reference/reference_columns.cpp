// Forward sensitivities of the reference solid (reference_columns.h).
#include "sim_worker/reference/reference_columns.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/check.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Vector3d;
using Eigen::VectorXd;
using Values = std::array<double, Pack::kLanes>;

// Solves in which friction's limits follow the normal forces: at most, and while those of any
// column change by more than this share.
constexpr int kFrictionRounds = 5;
constexpr double kFrictionChange = 0.01;

/// Whether elements have the same forces in both at the same nodes.
bool same_elements(const ReferenceTissueModel& a, const ReferenceTissueModel& b) {
  const auto material = [](const ReferenceTissueModel& m) {
    EffectValues values;
    for (const EffectRow& row : effect_catalogue()) {
      const bool of_elements = row.part == EffectPart::kMaterial ||
                               row.part == EffectPart::kStructure || row.part == EffectPart::kShape;
      if (row.member != nullptr && of_elements) row.member(values) = row.get(m.effects);
    }
    return values;
  };
  return a.nodes == b.nodes && a.lame.mu == b.lame.mu && a.lame.lambda == b.lame.lambda &&
         a.material.law() == b.material.law() && material(a) == material(b);
}

}  // namespace

double site_weight(const ColumnParameter& site, const Vector3d& p_B) {
  return place_weight((p_B.head<2>() - site.place).norm() / site.radius);
}

ReferenceColumns::ReferenceColumns(std::vector<ColumnParameter> list,
                                   const std::shared_ptr<const ReferenceTissueModel>& model)
    : parameters(std::move(list)), factor(model->order) {
  const auto unknowns = static_cast<Eigen::Index>(model->unknowns);
  const auto nodes = static_cast<Eigen::Index>(model->nodes.size());
  for (RightSides* field : {&x, &v, &x_before, &v_before, &limit_load})
    field->setZero(unknowns, count());
  mode.setZero(9 * static_cast<Eigen::Index>(model->elements.size()), count());
  multiplier.setZero(3 * GraspPatch::kRows, count());
  offset.setZero(3 * GraspPatch::kRows, count());
  rest.setZero(3 * nodes, count());
  tip_from.setZero(3, count());
  tip_to.setZero(3, count());
  aside.setZero(2, count());
  same = std::make_unique<ReferenceTissue>(model);
  for (int axis = 0; axis < 2; ++axis) {
    const auto moved = std::make_shared<ReferenceTissueModel>(*model);
    (axis == 0 ? moved->effects.grasp_x : moved->effects.grasp_y) += kAside;
    pinched_aside[axis] = std::make_unique<ReferenceTissue>(moved);
  }
  site_elements.resize(parameters.size());
  for (Eigen::Index k = 0; k < count(); ++k) {
    const ColumnParameter& p = parameters[k];
    changed.push_back(nullptr);
    same_elements.push_back(p.kind == ColumnKind::kScene &&
                            omentum::same_elements(*model, *p.changed));
    if (p.kind == ColumnKind::kScene) {
      changed.back() = std::make_unique<ReferenceTissue>(p.changed);
      const Vector3d shift = p.changed->body.X_WB.translation() - model->body.X_WB.translation();
      for (Eigen::Index i = 0; i < nodes; ++i) {
        rest.col(k).segment<3>(3 * i) =
            (model->body.X_WB.linear() * (p.changed->nodes[i] - model->nodes[i]) + shift) / p.step;
        if (model->unknown[i] >= 0)
          x.col(k).segment<3>(model->unknown[i]) = rest.col(k).segment<3>(3 * i);
      }
    }
    if (p.kind == ColumnKind::kStiffnessSite) {
      for (std::size_t e = 0; e < model->elements.size(); ++e) {
        PointWeights weights{};
        for (int point = 0; point < kHexPoints; ++point)
          weights[point] = site_weight(p, model->gauss_point(model->elements[e], point));
        if (std::ranges::any_of(weights, [](double w) { return w > 0; }))
          site_elements[k].emplace_back(static_cast<int>(e), weights);
      }
    }
  }
  x_before = x;
  for (std::size_t batch = 0; batch < model->batches(); ++batch) {
    bool clamped = false;
    for (std::size_t lane = 0; lane < Pack::kLanes; ++lane) {
      const std::size_t e = std::min(Pack::kLanes * batch + lane, model->elements.size() - 1);
      for (const int node : model->elements[e].node) clamped = clamped || model->unknown[node] < 0;
    }
    if (clamped) clamp_batches.push_back(batch);
  }
}

ReferenceColumns::~ReferenceColumns() = default;

void ReferenceTissue::carry_columns(std::vector<ColumnParameter> parameters) {
  const EffectValues& fx = effects_.values();
  if (fx.has_memory() || fx.suction > 0 || fx.adhesion > 0 || fx.air_drag > 0 ||
      fx.slip_speed > 0) {
    throw_error(
        "columns: a scene with memory in its material, adhesion, suction, air drag or slip has "
        "none");
  }
  if (!(fx == model_->effects))
    throw_error("columns: effects of a lane are not those of the scene");
  if (grasp_) throw_error("columns: begun while tissue is held");
  for (const ColumnParameter& p : parameters) {
    OMENTUM_CHECK(p.kind != ColumnKind::kScene || p.changed->unknown == model_->unknown,
                  "a column's scene has another mesh");
    check_column(*model_, p);
  }
  columns_ = std::make_unique<ReferenceColumns>(std::move(parameters), model_);
  for_each_follower([this](ReferenceTissue& follower) {
    LaneParameters own = parameters_;
    own.effects = follower.model_->effects;
    follower.reset(0, offset_);
    follower.set_parameters(0, own);
  });
}

void ReferenceTissue::set_tip_columns(const Eigen::Matrix3Xd& from, const Eigen::Matrix3Xd& to) {
  OMENTUM_CHECK(columns_ && to.cols() == from.cols());
  if (from.cols() == 0) {
    columns_->tip_from.setZero();
    columns_->tip_to.setZero();
    return;
  }
  OMENTUM_CHECK(from.cols() == columns_->count());
  columns_->tip_from = from;
  columns_->tip_to = to;
}

/// Of a node: clamped ones move with the mesh.
Eigen::Matrix3Xd ReferenceTissue::node_columns(int node) const {
  const int row = model_->unknown[node];
  if (row < 0) return columns_->rest.middleRows<3>(3L * node);
  return columns_->x.middleRows<3>(row);
}

/// C s of the patch: [3 row + axis][column].
MatrixXd ReferenceTissue::patch_columns() const {
  MatrixXd rows = MatrixXd::Zero(3L * GraspPatch::kRows, columns_->count());
  const GraspPatch& patch = grasp_->patch;
  for (int k = 0; k < patch.weight.rows(); ++k) {
    for (int r = 0; r < GraspPatch::kRows; ++r)
      rows.middleRows<3>(3L * r) += patch.weight(k, r) * node_columns(patch.node[k]);
  }
  return rows;
}

/// Where the tip finds the sheet, per parameter: the shift of the tip in x_B, y_B that finds, on
/// the sheet as it is, what the moved tip finds on the moved sheet.
Eigen::Matrix2Xd ReferenceTissue::patch_shift() const {
  const BodyPoint::Location at =
      model_->locate({grasp_->centre.x(), grasp_->centre.y(), 0}).locations.front();
  const ReferenceElement& element = model_->elements[at.element];
  const std::array<double, 8> N = hex_functions(at.xi);
  const std::array<Vector3d, 8> x = nodes_of(at.element);
  Eigen::Matrix3Xd moved = columns_->tip_from;
  Eigen::Matrix<double, 3, 2> tangent = Eigen::Matrix<double, 3, 2>::Zero();
  for (int a = 0; a < kHexNodes; ++a) {
    moved -= N[a] * node_columns(element.node[a]);
    for (int axis = 0; axis < 2; ++axis) {
      double slope = 0.125;
      for (int other = 0; other < 3; ++other) {
        const double side = ((a >> other) & 1) != 0 ? 1 : -1;
        slope *= other == axis ? 2 * side / element.size[axis] : 1 + side * at.xi[other];
      }
      tangent.col(axis) += slope * x[a];
    }
  }
  const Eigen::Matrix<double, 3, 2> of_shift = model_->body.X_WB.linear().leftCols<2>();
  return Eigen::Matrix2d(tangent.transpose() * of_shift).inverse() * tangent.transpose() * moved;
}

void ReferenceTissue::hold_columns(const Matrix3d& jaw, bool collapse) {
  ReferenceColumns& c = *columns_;
  if (has_pad()) return hold_pad_columns(jaw, collapse);
  c.offset = patch_columns();
  c.offset.topRows<3>() -= c.tip_from;
  for (int r = 0; r < GraspPatch::kRows; ++r)
    c.offset.middleRows<3>(3L * r) = jaw * MatrixXd(c.offset.middleRows<3>(3L * r));
  c.aside = patch_shift();
  if (collapse) c.offset.topRows<3>().setZero();
  c.multiplier.setZero();
}

/// Of the targets of the grasp's rows at these multipliers: jaws that turn lead the slopes with
/// them.
MatrixXd ReferenceTissue::grasp_target_columns(const Terms& terms) const {
  MatrixXd grasp = columns_->offset;
  if (has_pad()) grasp.setZero();
  if (!turns()) return grasp;
  const PatchTurn turn = patch_turn(trial_turn_, terms.target, trial_multiplier_);
  MatrixXd moment = MatrixXd::Zero(3, grasp.cols());
  for (int r = 1; r < GraspPatch::kRows; ++r) {
    grasp.middleRows<3>(3L * r) = trial_turn_.matrix * MatrixXd(grasp.middleRows<3>(3L * r));
    moment -= cross_matrix(trial_multiplier_.col(r)) * grasp.middleRows<3>(3L * r);
  }
  const MatrixXd turned = turn.compliance * moment;
  for (int r = 1; r < GraspPatch::kRows; ++r)
    grasp.middleRows<3>(3L * r) -= cross_matrix(turn.targets.col(r)) * turned;
  return grasp;
}

/// Eliminates the modes from the right sides, element by element: b <- b - K_xm K_mm^-1 b_m, with
/// K_mm = L L^T and the factor's coupling L^-1 K_mx.
void ReferenceTissue::condense_columns(const RightSides& modes, RightSides& nodes) const {
  const ReferenceColumns& c = *columns_;
  std::vector<Eigen::Index> loaded;  // columns that load the element's modes
  MatrixXd mode_loads(9, c.count());
  MatrixXd node_loads;
  for (std::size_t element = 0; element < model_->elements.size(); ++element) {
    const auto load = modes.middleRows<9>(9 * static_cast<Eigen::Index>(element));
    loaded.clear();
    for (Eigen::Index k = 0; k < c.count(); ++k) {
      if ((load.col(k).array() == 0).all()) continue;
      mode_loads.col(static_cast<Eigen::Index>(loaded.size())) = load.col(k);
      loaded.push_back(k);
    }
    if (loaded.empty()) continue;
    hex_condense(c.inner[element / Pack::kLanes], static_cast<int>(element % Pack::kLanes),
                 mode_loads.leftCols(static_cast<Eigen::Index>(loaded.size())), node_loads);
    for (int row = 0; row < 24; ++row) {
      const int at = node_unknown(element, row);
      if (at < 0) continue;
      for (std::size_t k = 0; k < loaded.size(); ++k)
        nodes(at, loaded[k]) += node_loads(row, static_cast<Eigen::Index>(k));
    }
  }
}

/// nodes <- dx/dtheta of right sides without modes and of the grasp's rows.
void ReferenceTissue::solve_columns(const MatrixXd& grasp, RightSides& nodes,
                                    MatrixXd& multiplier) const {
  const ReferenceColumns& c = *columns_;
  c.factor.solve_lower(nodes);
  if (has_pad()) {
    const MatrixXd pose = c.border_solver.solve(grasp.topRows<6>() -
                                                c.softness * (c.signed_border.transpose() * nodes));
    nodes.noalias() -= c.border * pose;
    multiplier.topRows<6>() = pose;
  } else if (grasp_) {
    multiplier = c.border_solver.solve(c.signed_border.transpose() * nodes - grasp);
    nodes.noalias() -= c.border * multiplier;
  }
  c.factor.solve_upper(nodes);
}

/// Factor at the converged trial: false where it is singular. Held tissue under compression may be
/// stable only because it is held, so it need not be positive definite.
bool ReferenceTissue::factor_columns(const Terms& terms) {
  ReferenceColumns& c = *columns_;
  const Tangent tangent{true, inertia(terms), trial_x_, trial_mode_, node_blocks(terms)};
  assemble(tangent, c.factor, c.inner, c.body_blocks);
  if (!c.factor.factor()) return false;
  if (!grasp_) return true;
  if (has_pad()) {
    prepare_pad_columns();
    return true;
  }
  c.border = grasp_columns();
  c.factor.solve_lower(c.border);
  c.signed_border = c.border;
  c.factor.apply_signs(c.signed_border);
  MatrixXd rows = c.border.transpose() * c.signed_border;
  add_grasp_compliance(patch_turn(trial_turn_, terms.target, trial_multiplier_), rows);
  c.border_solver.compute(rows);
  return true;
}

/// Of the converged trial, before the state takes it over.
void ReferenceTissue::advance_columns(const Terms& terms) {
  ReferenceColumns& c = *columns_;
  if (!c.valid) return;
  c.valid = factor_columns(terms);
  if (!c.valid) c.reason = "the tangent of a converged step is singular";
  if (!c.valid) return;
  RightSides& x_tilde = c.x_tilde;
  RightSides& loads = c.loads;
  x_tilde = terms.now * c.x - terms.before * c.x_before;
  loads = terms.now * c.v - terms.before * c.v_before;
  for (std::size_t i = 0; i < trial_x_.size(); ++i) {
    const int row = model_->unknown[i];
    if (row < 0) continue;
    loads.middleRows<3>(row) = model_->mass[i] * (inertia(terms) * x_tilde.middleRows<3>(row) +
                                                  loads.middleRows<3>(row) / terms.beta);
  }
  friction_stiffness(terms, [&](int node, const Matrix3d& block) {
    const int row = model_->unknown[node];
    if (row >= 0) loads.middleRows<3>(row) += block * x_tilde.middleRows<3>(row);
  });
  effects_.for_each_damper([&](int node, double stiffness) {
    const int row = model_->unknown[node];
    if (row >= 0) loads.middleRows<3>(row) += stiffness * x_tilde.middleRows<3>(row);
  });
  c.mode_load.setZero(c.mode.rows(), c.count());
  MatrixXd grasp = grasp_target_columns(terms);
  column_loads(terms, loads, c.mode_load, grasp);
  if (has_pad()) pad_column_loads(terms, loads, grasp);
  condense_columns(c.mode_load, loads);

  std::swap(c.x, c.x_before);
  std::swap(c.v, c.v_before);
  // Friction's limits from those of the last step on: in slow motion they are nearly the same.
  if (friction_.empty()) c.limit_load.setZero();
  std::vector<Eigen::Index> open(c.parameters.size());  // columns still to be solved
  std::iota(open.begin(), open.end(), 0);
  for (int round = 0; round < kFrictionRounds && !open.empty(); ++round) {
    RightSides& s = c.part;
    s = loads(Eigen::all, open) + c.limit_load(Eigen::all, open);
    MatrixXd multiplier = MatrixXd::Zero(grasp.rows(), s.cols());
    solve_columns(grasp(Eigen::all, open), s, multiplier);
    c.x(Eigen::all, open) = s;
    c.multiplier(Eigen::all, open) = multiplier;
    if (friction_.empty()) break;
    c.next_limit_load.setZero(loads.rows(), loads.cols());
    add_limit_loads(terms, c.x, c.next_limit_load);
    const Eigen::ArrayXd change = (c.next_limit_load - c.limit_load).colwise().norm();
    const Eigen::ArrayXd size = c.next_limit_load.colwise().norm();
    std::swap(c.limit_load, c.next_limit_load);
    std::erase_if(open, [&](Eigen::Index k) { return change[k] <= kFrictionChange * size[k]; });
  }
  c.v = (c.x - x_tilde) / terms.beta;
  if (has_pad()) finish_pad_columns(terms);
  c.modes_recovered = false;
}

/// Columns of the modes from those of the nodes: nothing else needs them, so when they are asked
/// for.
void ReferenceTissue::recover_modes() const {
  ReferenceColumns& c = *columns_;
  if (c.modes_recovered) return;
  c.modes_recovered = true;
  const RightSides& modes = c.mode_load;
  for (std::size_t batch = 0; batch < model_->batches(); ++batch) {
    HexInner& inner = c.inner[batch];
    for (Eigen::Index k = 0; k < c.count(); ++k) {
      std::array<Pack, 9> load;
      std::array<Pack, 9> change;
      std::array<Pack, 24> dx;
      Values values{};
      for (int m = 0; m < 9; ++m) {
        for (int lane = 0; lane < elements_in(batch); ++lane)
          values[lane] = -modes(9 * static_cast<Eigen::Index>(Pack::kLanes * batch + lane) + m, k);
        load[m] = Pack::load(values.data());
      }
      hex_condense(load, inner);
      for (int row = 0; row < 24; ++row) {
        for (int lane = 0; lane < elements_in(batch); ++lane) {
          const std::size_t element = Pack::kLanes * batch + lane;
          const int at = node_unknown(element, row);
          values[lane] = at >= 0 ? c.x(at, k) : 0;
        }
        dx[row] = Pack::load(values.data());
      }
      hex_recover(inner, dx, change);
      for (int m = 0; m < 9; ++m) {
        for (int lane = 0; lane < elements_in(batch); ++lane)
          c.mode(9 * static_cast<Eigen::Index>(Pack::kLanes * batch + lane) + m, k) =
              change[m].lane(lane);
      }
    }
  }
}

Eigen::Matrix3Xd ReferenceTissue::point_columns(const BodyPoint& point) const {
  const ReferenceColumns& c = *columns_;
  recover_modes();
  Eigen::Matrix3Xd sum = Eigen::Matrix3Xd::Zero(3, c.count());
  for (const BodyPoint::Location& at : point.locations) {
    const ReferenceElement& element = model_->elements[at.element];
    const std::array<double, 8> N = hex_functions(at.xi);
    const std::array<Vector3d, 8> x = nodes_of(at.element);
    std::array<Eigen::Matrix3Xd, 8> nodes;
    for (int a = 0; a < kHexNodes; ++a) nodes[a] = node_columns(element.node[a]);
    const std::array<double, 9>& base = state_.mode[at.element];
    const HexBow bow(element.size, x, base, at.xi);
    for (Eigen::Index k = 0; k < c.count(); ++k) {
      std::array<Vector3d, 8> dx;
      for (int a = 0; a < kHexNodes; ++a) {
        dx[a] = nodes[a].col(k);
        sum.col(k) += N[a] * dx[a];
      }
      if (point.fixed) continue;
      std::array<double, 9> mode{};
      for (int m = 0; m < 9; ++m) mode[m] = c.mode(9L * at.element + m, k);
      sum.col(k) += bow.rate(dx, mode);
      const ColumnParameter& p = c.parameters[k];
      if (p.kind != ColumnKind::kScene) continue;
      const Vector3d& size = p.changed->elements[at.element].size;
      if (size != element.size)
        sum.col(k) += (HexBow(size, x, base, at.xi).value() - bow.value()) / p.step;
    }
  }
  return sum / static_cast<double>(point.locations.size());
}

}  // namespace omentum

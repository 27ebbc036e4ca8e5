#include "sim_worker/reference/reference_effects.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "sim_worker/geometry/rigid_gap.h"
#include "sim_worker/reference/pack.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Energy of a string of length `size`, its tension and the derivative of that; a smooth corner of
/// 10 um where it becomes taut, as in the lanes (node_effects.inl).
struct StringLaw {
  double energy = 0, tension = 0, slope = 0;
};
StringLaw string_law(double stiffness, double slack, double size) {
  if (!(slack > 0)) return {0.5 * stiffness * size * size, stiffness * size, stiffness};
  constexpr double w = 1e-5;  // [m]
  const double over = size - slack;
  const double smooth = std::sqrt(over * over + w * w);
  const double sum = over > 0 ? over + smooth : w * w / (smooth - over);
  const double half = 0.5 * stiffness;
  return {half * 0.5 * (over * sum + w * w * logarithm(sum / w)), half * sum,
          half * (1 + over / smooth)};
}

constexpr double kTouch = 1e-5;  // [m]: nearer than this a face bonds; contact starts at 2 um

}  // namespace

ReferenceEffects::ReferenceEffects(std::shared_ptr<const ReferenceTissueModel> model)
    : model_(std::move(model)) {
  set(model_->effects);
}

bool ReferenceEffects::bonds(const EffectValues& v) const {
  return v.adhesion > 0 || model_->effects.moves_anchor();
}

bool ReferenceEffects::fits(const EffectValues& v) const {
  return baked_fit(model_->effects, v, kReferenceModel);
}

void ReferenceEffects::set(const EffectValues& v) {
  if (!fits(v)) {
    throw_error(
        "tissue.effects: TISSUE_REFERENCE has effects of density, stiffness, shape and anchor in "
        "its mesh; allowed to differ from the scene's: the others");
  }
  values_ = v;
  const bool in_material =
      v.stiffens() || v.fibre_ratio > 0 || v.has_memory() || !model_->rest.empty();
  material_.clear();
  if (v.has_memory() && memory_.empty()) memory_.resize(model_->batches());
  if (in_material) {
    const double nu = model_->material.poisson_ratio() + v.poisson_change;
    const trig::SinCos a = trig::sin_cos(v.fibre_angle);
    HexEffects fx;
    fx.stiffening = v.stiffening;
    fx.exponential = v.exponential;
    fx.fibre = 2 * (1 + nu) * v.fibre_ratio;
    fx.axis = {a.cos, a.sin};
    fx.softening = v.softening;
    fx.softening_energy = (1 + nu) * v.softening_strain * v.softening_strain;
    fx.branches = make_prony(v, 1).branches > 0;
    fx.slider = 2 * (1 + nu) * v.slider_ratio;
    fx.yield = v.slider_yield;
    material_.assign(model_->batches(), fx);
    for (std::size_t b = 0; b < material_.size(); ++b) {
      if (!model_->rest.empty()) material_[b].rest = &model_->rest[b];
      if (!memory_.empty()) material_[b].memory = &memory_[b];
    }
  }
  const std::size_t n = model_->nodes.size();
  if (bonds(v) && bond_longest_.empty()) {
    bond_place_.assign(n, Vector3d::Zero());
    bond_longest_.assign(n, -1);
  }
  sticking_.clear();
  for (std::size_t i = 0; i < n && v.adhesion > 0 && !v.sticks_everywhere(); ++i)
    sticking_.push_back(sticking_share(v, model_->node_box(i)));
  place_pull();
}

void ReferenceEffects::place_pull() {
  const EffectValues& v = values_;
  pulled_.clear();
  if (!(v.pull > 0)) return;
  const Vector3d anchor(v.pull_anchor_x, v.pull_anchor_y, v.pull_anchor_z);
  const std::vector<double> share =
      disc_shares(model_->nodes, model_->node_area, {v.pull_x, v.pull_y}, v.pull_radius);
  for (std::size_t i = 0; i < share.size(); ++i) {
    if (share[i] == 0 || model_->unknown[i] < 0) continue;
    const Vector3d from_centre = model_->nodes[i] - Vector3d(v.pull_x, v.pull_y, 0);
    pulled_.push_back({static_cast<int>(i), v.pull * share[i],
                       anchor + model_->body.X_WB.linear() * from_centre});
  }
}

void ReferenceEffects::reset(const Vector3d& offset) {
  push_left_ = push_now_ = 1;
  std::fill(memory_.begin(), memory_.end(), HexMemory{});
  std::fill(bond_longest_.begin(), bond_longest_.end(), -1);
  std::fill(bond_place_.begin(), bond_place_.end(), Vector3d::Zero());
  for (std::size_t i = 0; i < bond_longest_.size(); ++i) {
    if (model_->is_anchor.empty() || model_->is_anchor[i] == 0) continue;
    bond_place_[i] = model_->body.X_WB * model_->nodes[i] + offset;
    bond_longest_[i] = 0;
  }
  bed_longest_.assign(model_->bed.size(), 0);
  bed_place_.assign(model_->bed.size(), offset);
  for (std::size_t k = 0; k < bed_place_.size(); ++k) {
    const BedPoint& point = model_->bed[k];
    for (int a = 0; a < 4; ++a)
      bed_place_[k] += point.share[a] * (model_->body.X_WB * model_->nodes[point.node[a]]);
  }
}

void ReferenceEffects::begin(double h, const Nodes& x, const Nodes& v, const Nodes& x_tilde,
                             double beta) {
  step_ = h;
  const PronyStep prony = make_prony(values_, h);
  for (std::size_t b = 0; b < memory_.size() && prony.branches > 0; ++b) {
    material_[b].gains = prony.gains;
    for (std::size_t point = 0; point < kHexPoints; ++point) {
      for (std::size_t k = 0; k < 9; ++k) {
        Pack bias;
        for (int j = 0; j < prony.branches; ++j) {
          bias = bias + Pack(prony.keep[j]) * memory_[b].branch[j][point][k] -
                 Pack(prony.gain[j]) * memory_[b].stress[point][k];
        }
        memory_[b].bias[point][k] = bias;
      }
    }
  }
  beta_ = beta;
  const bool fades = values_.push_decay > 0 && !clock_stopped_;
  push_now_ = fades ? push_left_ * trig::decay(h / values_.push_decay) : push_left_;
  drag_.clear();
  if (values_.air_drag > 0 || !pulled_.empty()) drag_origin_ = x_tilde;
  if (values_.air_drag > 0) {
    for (std::size_t i = 0; i < v.size(); ++i) {
      drag_.push_back(0.5 * values_.air_drag * kAirDensity * model_->node_area[i] * v[i].norm() /
                      beta);
    }
  }
  lubrication_.clear();
  if (!(values_.suction > 0)) return;
  start_ = x;
  lubrication_.assign(x.size(), 0);
  lubrication_normal_.assign(x.size(), Vector3d::Zero());
  const auto nearest_gap = [&](int node) {
    Gap nearest{1, Vector3d::Zero()};
    for (const RigidShape& body : model_->surroundings.bodies) {
      const Gap gap = rigid_gap(body, x[node]);
      if (gap.distance < nearest.distance) nearest = gap;
    }
    return nearest;
  };
  const int layers = model_->cells(2);
  for (const FaceNode& face : model_->face_nodes) {
    const int i = face.node;
    const bool lower = face.node % (layers + 1) == 0;
    const Gap found = nearest_gap(face.node);
    const double nearest = found.distance;
    // On the side of the sheet that faces the body.
    const double other = nearest_gap(face.node + (lower ? layers : -layers)).distance;
    if (other < nearest || (other == nearest && !lower)) continue;
    lubrication_normal_[i] = found.normal;
    const double gap = std::max(0.0, nearest + model_->face_inset);
    const double part = values_.suction_reach / (values_.suction_reach + gap);
    lubrication_[i] = values_.suction * face.area * part * part * part / h;
  }
}

double ReferenceEffects::bond_stiffness(std::size_t i) const {
  if (bond_longest_[i] < 0) return 0;
  if (!model_->is_anchor.empty() && model_->is_anchor[i] != 0) return model_->anchor[i];
  const double part = sticking_.empty() ? 1 : sticking_[i];
  return values_.adhesion * part * model_->face_area[i] *
         cohesive_share(bond_longest_[i], values_.adhesion_break);
}

double ReferenceEffects::bed_stiffness(std::size_t k) const {
  const double limit = values_.anchor_break;
  return model_->bed[k].stiffness * (limit > 0 ? cohesive_share(bed_longest_[k], limit) : 1);
}

Vector3d ReferenceEffects::bed_stretch(std::size_t k, const Nodes& x) const {
  const BedPoint& point = model_->bed[k];
  Vector3d off = -bed_place_[k];
  for (int a = 0; a < 4; ++a) off += point.share[a] * x[static_cast<std::size_t>(point.node[a])];
  return off;
}

void ReferenceEffects::for_each_force(
    const Nodes& x,
    const std::function<void(int, double, const Vector3d&, const Matrix3d&)>& fn) const {
  for (std::size_t i = 0; i < drag_.size(); ++i) {
    const Vector3d d = x[i] - drag_origin_[i];
    fn(static_cast<int>(i), 0.5 * drag_[i] * d.squaredNorm(), drag_[i] * d,
       drag_[i] * Matrix3d::Identity());
  }
  for (std::size_t i = 0; i < bond_longest_.size(); ++i) {
    const double k = bond_stiffness(i);
    if (!(k > 0)) continue;
    const Vector3d off = x[i] - bond_place_[i];
    fn(static_cast<int>(i), 0.5 * k * off.squaredNorm(), k * off, k * Matrix3d::Identity());
  }
  for (std::size_t p = 0; p < bed_place_.size(); ++p) {
    const double k = bed_stiffness(p);
    if (!(k > 0)) continue;
    const BedPoint& point = model_->bed[p];
    const Vector3d off = bed_stretch(p, x);
    for (int a = 0; a < 4; ++a) {
      const double share = point.share[a];
      fn(point.node[a], 0.5 * k * share * off.squaredNorm(), k * share * off, Matrix3d::Zero());
    }
  }
  const Vector3d push(values_.push_x, values_.push_y, values_.push_z);
  for (const Pulled& p : pulled_) {
    const Vector3d off = x[p.node] - p.place;
    const double size = std::max(off.norm(), 1e-10);
    const StringLaw law = string_law(p.share * values_.pull_stiffness, values_.pull_slack, size);
    const double damper = p.share * values_.pull_damper / beta_;
    const Vector3d d = x[p.node] - drag_origin_[p.node];
    const Vector3d n = off / size;
    const double across = law.tension / size;
    const Matrix3d block =
        (across + damper) * Matrix3d::Identity() + (law.slope - across) * n * n.transpose();
    const Vector3d constant = p.share * push_now_ * push;
    fn(p.node, law.energy + 0.5 * damper * d.squaredNorm() - constant.dot(d),
       law.tension * n + damper * d - constant, block);
  }
  for (std::size_t i = 0; i < lubrication_.size(); ++i) {
    if (!(lubrication_[i] > 0)) continue;
    const Vector3d& n = lubrication_normal_[i];
    const double along = n.dot(x[i] - start_[i]);
    fn(static_cast<int>(i), 0.5 * lubrication_[i] * along * along, lubrication_[i] * along * n,
       lubrication_[i] * n * n.transpose());
  }
}

void ReferenceEffects::for_each_damper(const std::function<void(int, double)>& fn) const {
  for (const Pulled& p : pulled_) fn(p.node, p.share * values_.pull_damper / beta_);
}

void ReferenceEffects::remember(const Nodes& x,
                                const std::function<HexShape(std::size_t)>& shape_of) {
  push_left_ = push_now_;
  if (values_.has_memory()) {
    const PronyStep prony = make_prony(values_, step_);
    for (std::size_t b = 0; b < memory_.size(); ++b) {
      hex_remember(model_->material.law(), shape_of(b), prony, memory_[b]);
    }
  }
  for (std::size_t i = 0; i < bond_longest_.size(); ++i) {
    if (bond_longest_[i] < 0) continue;
    bond_longest_[i] = std::max(bond_longest_[i], (x[i] - bond_place_[i]).norm());
  }
  for (std::size_t k = 0; k < bed_longest_.size(); ++k)
    bed_longest_[k] = std::max(bed_longest_[k], bed_stretch(k, x).norm());
  if (!(values_.adhesion > 0)) return;
  for (const FaceNode& face : model_->face_nodes) {
    const int i = face.node;
    if (bond_longest_[i] >= 0 || (!sticking_.empty() && sticking_[i] == 0)) continue;
    for (const RigidShape& body : model_->surroundings.bodies) {
      if (rigid_gap(body, x[i]).distance + model_->face_inset > kTouch) continue;
      bond_place_[i] = x[i];
      bond_longest_[i] = 0;
    }
  }
}

std::size_t ReferenceEffects::saved_size(const EffectValues& v) const {
  return (v.has_memory() ? model_->batches() * sizeof(HexMemory) / sizeof(double) : 0) +
         (bonds(v) ? 4 * model_->nodes.size() : 0) + 4 * model_->bed.size() + (v.pull > 0 ? 1 : 0);
}

void ReferenceEffects::save(std::vector<double>& out) const {
  if (values_.has_memory()) {
    const auto* first = reinterpret_cast<const double*>(memory_.data());
    out.insert(out.end(), first, first + memory_.size() * sizeof(HexMemory) / sizeof(double));
  }
  if (values_.pull > 0) out.push_back(push_left_);
  for (const Vector3d& p : bed_place_) out.insert(out.end(), p.data(), p.data() + 3);
  out.insert(out.end(), bed_longest_.begin(), bed_longest_.end());
  if (!bonds(values_)) return;
  for (const Vector3d& p : bond_place_) out.insert(out.end(), p.data(), p.data() + 3);
  out.insert(out.end(), bond_longest_.begin(), bond_longest_.end());
}

void ReferenceEffects::load(std::span<const double> in) {
  const double* next = in.data();
  if (values_.has_memory()) {
    const std::size_t count = memory_.size() * sizeof(HexMemory) / sizeof(double);
    std::copy(next, next + count, reinterpret_cast<double*>(memory_.data()));
    next += count;
  }
  if (values_.pull > 0) push_left_ = *next++;
  for (Vector3d& p : bed_place_) {
    std::copy(next, next + 3, p.data());
    next += 3;
  }
  std::copy(next, next + bed_longest_.size(), bed_longest_.begin());
  next += bed_longest_.size();
  if (!bonds(values_)) return;
  for (Vector3d& p : bond_place_) {
    std::copy(next, next + 3, p.data());
    next += 3;
  }
  std::copy(next, next + bond_longest_.size(), bond_longest_.begin());
}

}  // namespace omentum

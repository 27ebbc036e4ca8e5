// State bytes of the reference solid.
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/hash.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/tissue/state_bytes.h"

namespace omentum {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

/// Parts that follow the fixed one. Reaches checkpoints: do not change.
enum Parts { kGrasp = 1, kEffects = 2, kTangent = 4 };

constexpr std::size_t kEffectValues = sizeof(EffectValues) / sizeof(double);

std::span<double> numbers(std::vector<Vector3d>& points) {
  return points.empty() ? std::span<double>() : std::span(points[0].data(), 3 * points.size());
}
std::span<double> numbers(std::vector<std::array<double, 9>>& modes) {
  return {modes.front().data(), 9 * modes.size()};
}
template <int kRows, int kColumns>
std::span<double> numbers(Eigen::Matrix<double, kRows, kColumns>& matrix) {
  return {matrix.data(), kRows * kColumns};
}

/// The numbers of a state, one after another.
class NumberReader {
 public:
  explicit NumberReader(std::span<const std::byte> bytes)
      : numbers_(bytes.size() / sizeof(double)) {
    if (!numbers_.empty())
      std::memcpy(numbers_.data(), bytes.data(), numbers_.size() * sizeof(double));
  }

  /// False where they end or one of them is not finite.
  bool read(std::span<double> to) {
    if (to.size() > numbers_.size() - used_) return false;
    std::copy_n(&numbers_[used_], to.size(), to.begin());
    used_ += to.size();
    return all_finite(std::span<const double>(to));
  }
  bool read(double& to) { return read({&to, 1}); }
  std::size_t used() const { return used_; }

 private:
  std::vector<double> numbers_;
  std::size_t used_ = 0;
};

}  // namespace

// Layout, all doubles: the fixed part; grasp: patch centre, radius, targets, multipliers, turn;
// effects: their values, slip, memory; tangent: inertia, nodes, parabolas, number of blocks, each
// block as its node and its lower triangle.
struct ReferenceTissue::Saved {
  State state;
  LaneParameters parameters;
  Vector3d held_force = Vector3d::Zero();
  Nodes contact_forces;
  double healthy = 1;
  double parts = 0;

  std::vector<std::span<double>> fixed() {
    return {numbers(state.x),
            numbers(state.v),
            numbers(state.x_before),
            numbers(state.v_before),
            std::span(&state.step_before, 1),
            numbers(state.mode),
            std::span(&parameters.stiffness_scale, 1),
            std::span(&parameters.gravity_scale, 1),
            std::span(&parameters.damping_scale, 1),
            std::span(&parameters.friction_scale, 1),
            numbers(held_force),
            numbers(contact_forces),
            std::span(&healthy, 1),
            std::span(&parts, 1)};
  }
};

void ReferenceTissue::save(int, Bytes& out) const {
  StateWriter writer(out);
  const auto add = [&writer](std::span<const double> values) { writer.add_all(values); };
  const bool has_effects = !(effects_.values() == EffectValues{});
  Saved saved{state_, parameters_, held_force_, contact_forces_};
  saved.healthy = failure_.empty() ? 1 : 0;
  saved.parts =
      (grasp_ ? kGrasp : 0) + (has_effects ? kEffects : 0) + (tangent_.usable ? kTangent : 0);
  for (const std::span<double> values : saved.fixed()) add(values);
  if (grasp_) {
    Grasp grasp = *grasp_;
    add(numbers(grasp.centre));
    writer.add(grasp.radius);
    add(numbers(grasp.offset));
    add(numbers(saved.state.multiplier));
    add(numbers(saved.state.turn.quaternion.coeffs()));
    add(numbers(grasp.arm));
  }
  if (has_effects) {
    writer.add(effects_.values());
    writer.add(slipped_);
    std::vector<double> memory;
    effects_.save(memory);
    add(memory);
  }
  if (!tangent_.usable) return;
  Tangent tangent = tangent_;
  writer.add(tangent.inertia);
  add(numbers(tangent.x));
  add(numbers(tangent.mode));
  std::vector<double> blocks;
  for (std::size_t i = 0; i < tangent.node_blocks.size(); ++i) {
    const Matrix3d& b = tangent.node_blocks[i];
    if (b.isZero(0)) continue;
    blocks.insert(blocks.end(),
                  {static_cast<double>(i), b(0, 0), b(1, 0), b(1, 1), b(2, 0), b(2, 1), b(2, 2)});
  }
  writer.add(static_cast<double>(blocks.size() / 7));
  add(blocks);
}

Result<std::size_t> ReferenceTissue::load(int, std::span<const std::byte> bytes) {
  const Failure ends{"reference tissue state ends early or holds a non-finite number"};
  NumberReader reader(bytes);
  Saved saved{state_, {}, {}, contact_forces_};
  saved.state.multiplier.setZero();
  saved.state.turn = {};
  Eigen::Quaterniond turn;
  for (const std::span<double> values : saved.fixed()) {
    if (!reader.read(values)) return ends;
  }
  if (!(saved.parts >= 0 && saved.parts <= 7 && saved.parts == std::floor(saved.parts)))
    return Failure{fmt::format("reference tissue state: parts {}, allowed 0 ... 7", saved.parts)};
  const int parts = static_cast<int>(saved.parts);
  if (saved.healthy != 0 && saved.healthy != 1)
    return Failure{fmt::format("reference tissue state: flag is {}, allowed 0, 1", saved.healthy)};
  if (!(saved.state.step_before >= 0)) {
    return Failure{fmt::format("reference tissue state: last step {} s", saved.state.step_before)};
  }
  Grasp grasp;
  if ((parts & kGrasp) != 0) {
    if (!reader.read(numbers(grasp.centre)) || !reader.read(grasp.radius) ||
        !reader.read(numbers(grasp.offset)) || !reader.read(numbers(saved.state.multiplier)) ||
        !reader.read(numbers(turn.coeffs())))
      return ends;
    if (!(std::fabs(turn.norm() - 1) < 1e-9))
      return Failure{fmt::format("reference tissue state: turn of norm {}", turn.norm())};
    saved.state.turn.set(turn);
    const Eigen::AlignedBox2d sheet = model_->free_sheet();
    if (!sheet.contains(grasp.centre) || !(grasp.radius > 0 && grasp.radius <= 1)) {
      return Failure{fmt::format("reference tissue state: patch at ({}, {}) m of radius {} m",
                                 grasp.centre.x(), grasp.centre.y(), grasp.radius)};
    }
    if (model_->surroundings.grip.pad) {
      make_pad(grasp);
      if (!reader.read(numbers(grasp.arm))) return ends;
    }
  }
  EffectValues effects;
  double slipped = 0;
  std::vector<double> memory;
  if ((parts & kEffects) != 0) {
    std::array<double, kEffectValues> values{};
    if (!reader.read(values) || !reader.read(slipped)) return ends;
    std::memcpy(static_cast<void*>(&effects), values.data(), sizeof effects);
    if (!usable(effects, model_->material.poisson_ratio(), model_->body.particles))
      return Failure{"reference tissue state holds effects out of range"};
    memory.resize(effects_.saved_size(effects));
    if (!reader.read(memory)) return ends;
  }
  if (!effects_.fits(effects))
    return Failure{"reference tissue state holds effects of another mesh"};
  Tangent tangent{true, 0, saved.state.x, saved.state.mode, {}};
  if ((parts & kTangent) != 0) {
    double count = 0;
    if (!reader.read(tangent.inertia) || !reader.read(numbers(tangent.x)) ||
        !reader.read(numbers(tangent.mode)) || !reader.read(count) ||
        !(count >= 0 && count <= static_cast<double>(state_.x.size())))
      return ends;
    tangent.node_blocks.assign(state_.x.size(), Matrix3d::Zero());
    for (int k = 0; k < count; ++k) {
      std::array<double, 7> b{};
      if (!reader.read(b)) return ends;
      if (!(b[0] >= 0 && b[0] < static_cast<double>(state_.x.size())))
        return Failure{fmt::format("reference tissue state: block of node {}", b[0])};
      tangent.node_blocks[static_cast<std::size_t>(b[0])] << b[1], b[2], b[4], b[2], b[3], b[5],
          b[4], b[5], b[6];
    }
  }

  state_ = std::move(saved.state);
  saved.parameters.effects = effects;
  set_parameters(0, saved.parameters);
  if ((parts & kEffects) != 0) effects_.load(memory);
  slipped_ = slipped;
  held_force_ = saved.held_force;
  contact_forces_ = std::move(saved.contact_forces);
  failure_ = saved.healthy == 1 ? "" : "the saved state had failed";
  grasp_.reset();
  if ((parts & kGrasp) != 0) {
    grasp_ = make_grasp(grasp.centre, grasp.radius);
    grasp_->offset = grasp.offset;
    grasp_->arm = std::move(grasp.arm);
  }
  factored_ = constrained_ = false;
  if ((parts & kTangent) != 0) tangent_ = std::move(tangent);
  return reader.used() * sizeof(double);
}

std::uint64_t ReferenceTissue::hash(int) const {
  Bytes bytes;
  save(0, bytes);
  return fnv1a64(bytes);
}

}  // namespace omentum

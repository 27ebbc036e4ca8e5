#include "sim_worker/instrument/arm.h"

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/constants.h"
#include "core/trig.h"
#include "proto/knob.pb.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Position gains P of the dVRK's servo (sawControllers, docs/mismatch.md 2.2) [N m/rad, N/m].
constexpr std::array<double, 6> kServoGain = {120, 120, 6000, 6, 6, 6};

std::array<double, 6> values(const pb::JointValues& v) {
  return {v.yaw(), v.pitch(), v.insertion(), v.roll(), v.wrist_pitch(), v.wrist_yaw()};
}

bool any(const std::array<double, 6>& v) {
  return std::any_of(v.begin(), v.end(), [](double x) { return x != 0; });
}

/// Disc angles of a pose with the jaw's joint at zero, since the jaw does not move the tip.
Eigen::Vector4d discs_of(const PsmInstrument& instrument, const PsmJoints& q) {
  return instrument.disc_coupling().inverse() * Eigen::Vector4d(q[3], q[4], q[5], 0);
}

Vector3d to_vector(const double* p) { return {p[0], p[1], p[2]}; }

void assign(double* to, const Vector3d& from) {
  for (int k = 0; k < 3; ++k) to[k] = from[k];
}

/// First-order lag T y' = u - y over dt, exact for an input from u0 to u1; decay = exp(-dt/T).
double lag(double y, double u0, double u1, double T, double decay, double dt) {
  if (T == 0) return u1;
  const double behind = T * (u1 - u0) / dt;
  return u1 - behind + (y - u0 + behind) * decay;
}

/// Play operator of half-width b; with b = F / P Coulomb friction F on a servo of gain P.
double play(double y, double x, double b) { return std::clamp(y, x - b, x + b); }

using Message = google::protobuf::Message;
using Field = google::protobuf::FieldDescriptor;

/// A number of the message, or of one that it holds once.
const Field& find_effect(const Message& message, const std::string& name, const std::string& path) {
  const auto* type = message.GetDescriptor();
  const Field* field = type->FindFieldByName(name);
  if (field == nullptr || field->is_repeated()) {
    std::string names;
    for (int k = 0; k < type->field_count(); ++k) {
      if (!type->field(k)->is_repeated()) names += " " + type->field(k)->name();
    }
    throw_error("arm.{}: no effect of that name, allowed at \"{}\":{}", path, name, names);
  }
  return *field;
}

void set_number(Message& message, const Field& field, const std::string& path, double value) {
  const pb::Knob& knob = field.options().GetExtension(pb::knob);
  if (!(value >= knob.min() && value <= knob.max()))
    throw_error("arm.{}: {}, allowed {} ... {}", path, value, knob.min(), knob.max());
  message.GetReflection()->SetDouble(&message, &field, value);
}

}  // namespace

void set_effect(pb::ArmEffects& effects, const std::string& path, double value) {
  const std::size_t dot = path.find('.');
  const Field& field = find_effect(effects, path.substr(0, dot), path);
  if (field.cpp_type() != Field::CPPTYPE_MESSAGE) {
    if (dot != std::string::npos) find_effect(effects, path, path);  // throws
    set_number(effects, field, path, value);
    return;
  }
  Message& part = *effects.GetReflection()->MutableMessage(&effects, &field);
  if (dot != std::string::npos) {
    set_number(part, find_effect(part, path.substr(dot + 1), path), path, value);
    return;
  }
  for (int k = 0; k < part.GetDescriptor()->field_count(); ++k)
    set_number(part, *part.GetDescriptor()->field(k), path, value);
}

Arm::Arm(const pb::ArmEffects& effects, const ToolMount& mount, double control_period)
    : effects_(effects),
      mount_(mount),
      dt_(control_period),
      droop_(values(effects.droop_s())),
      coulomb_(values(effects.coulomb_friction())),
      viscous_(values(effects.viscous_friction())),
      backlash_(values(effects.backlash())),
      compliance_(values(effects.joint_compliance())),
      offset_(values(effects.joint_offset())) {
  const double longest = (ArmState::kHistory - 1) * dt_;
  if (effects.transport_delay_s() > longest) {
    throw_error("scene.arm.transport_delay_s: {} s, allowed 0 ... {} at a control period of {} s",
                effects.transport_delay_s(), longest, dt_);
  }
  for (std::size_t j = 0; j < 6; ++j) {
    for (const auto& [name, value] : {std::pair{"droop_s", droop_[j]},
                                      {"coulomb_friction", coulomb_[j]},
                                      {"viscous_friction", viscous_[j]},
                                      {"backlash", backlash_[j]},
                                      {"joint_compliance", compliance_[j]}}) {
      if (value < 0)
        throw_error("scene.arm.{}.{}: {}, allowed 0 or more", name,
                    mount.instrument->limits[j].name, value);
    }
  }
  const pb::DiscValues& discs = effects.disc_backlash();
  const pb::AxisValues& tip = effects.tip_compliance();
  const pb::AxisValues& tip_play = effects.tip_backlash();
  active_ = effects.transport_delay_s() > 0 || effects.payload_kg() > 0 || any(droop_) ||
            effects.bandwidth_s() > 0 || any(coulomb_) || any(viscous_) ||
            effects.load_friction() > 0 || any(backlash_) || discs.roll() > 0 ||
            discs.pitch() > 0 || discs.yaw() > 0 || discs.jaw() > 0 ||
            effects.servo_compliance() > 0 || any(compliance_) || tip.x() > 0 || tip.y() > 0 ||
            tip.z() > 0 || tip_play.x() > 0 || tip_play.y() > 0 || tip_play.z() > 0 ||
            any(offset_) || effects.tool_length_offset_m() != 0 ||
            std::any_of(effects.coupling().begin(), effects.coupling().end(),
                        [](const pb::JointCoupling& c) { return c.slope() != 0; });
  // Viscous friction lags like the servo's own damping: T = (D + Fv) / P.
  for (std::size_t j = 0; j < 6; ++j) {
    droop_[j] += viscous_[j] / kServoGain[j];
    decay_droop_[j] = droop_[j] > 0 ? trig::decay(dt_ / droop_[j]) : 0;
  }
  decay_pole_ = effects.bandwidth_s() > 0 ? trig::decay(dt_ / effects.bandwidth_s()) : 0;
}

Vector3d Arm::tip_of(const PsmJoints& q, double extra_length) const {
  const PsmPose pose = psm_forward(q, *mount_.instrument);
  return mount_.X_WR * (pose.p + (mount_.tip_offset + extra_length) * pose.R.col(2));
}

/// The command `transport_delay_s` ago: linear between the ends of control steps.
Vector3d Arm::delayed(const ArmState& state) const {
  const double steps = effects_.transport_delay_s() / dt_;
  const int whole = std::min(static_cast<int>(steps), ArmState::kHistory - 2);
  const double fraction = steps - whole;
  Vector3d newer = to_vector(state.command[whole]);
  if (fraction == 0) return newer;
  return newer + fraction * (to_vector(state.command[whole + 1]) - newer);
}

/// Joint efforts J^T F of a force at the tip, J by central differences [N m, N].
std::array<double, 6> Arm::load_efforts(const PsmJoints& q, const Vector3d& load_W) const {
  constexpr double kStep = 1e-6;
  std::array<double, 6> efforts{};
  for (std::size_t j = 0; j < 6; ++j) {
    PsmJoints up = q;
    PsmJoints down = q;
    up[j] += kStep;
    down[j] -= kStep;
    efforts[j] = load_W.dot(tip_of(up, 0) - tip_of(down, 0)) / (2 * kStep);
  }
  return efforts;
}

PsmJoints Arm::play_of_discs(ArmState& state, const PsmJoints& q) const {
  const pb::DiscValues& b = effects_.disc_backlash();
  const std::array<double, 4> widths = {b.roll(), b.pitch(), b.yaw(), b.jaw()};
  if (std::all_of(widths.begin(), widths.end(), [](double w) { return w == 0; })) return q;
  const Eigen::Vector4d discs = discs_of(*mount_.instrument, q);
  Eigen::Vector4d played;
  for (int k = 0; k < 4; ++k) {
    state.disc[k] = play(state.disc[k], discs[k], widths[k]);
    played[k] = state.disc[k];
  }
  const Eigen::Vector4d joints = mount_.instrument->disc_coupling() * (played - discs);
  PsmJoints result = q;
  for (int k = 0; k < 3; ++k) result[3 + k] += joints[k];
  return result;
}

void Arm::reset_joints(ArmState& state, const PsmJoints& q) const {
  for (double* memory :
       {state.target, state.droop, state.pole[0], state.pole[1], state.motor, state.joint}) {
    std::copy(q.begin(), q.end(), memory);
  }
  Eigen::Vector4d::Map(state.disc) = discs_of(*mount_.instrument, q);
}

void Arm::reset(ArmState& state, const Vector3d& p_WT) const {
  state = {};
  for (auto& command : state.command) assign(command, p_WT);
  if (const Result<PsmJoints> solved = joints_for_tip(mount_, p_WT))
    reset_joints(state, solved.value());
  assign(state.p_WT_true, p_WT);
  assign(state.p_WT_measured, p_WT);
  step(state, p_WT, Vector3d::Zero());  // offsets act at rest as well
}

ArmReport Arm::step(ArmState& state, const Vector3d& p_WT, const Vector3d& load_W) const {
  for (int k = ArmState::kHistory - 1; k > 0; --k)
    std::copy_n(state.command[k - 1], 3, state.command[k]);
  assign(state.command[0], p_WT);
  const Vector3d goal = delayed(state);

  PsmJoints target{};
  std::copy_n(state.target, 6, target.begin());
  if (const Result<PsmJoints> q = joints_for_tip(mount_, goal)) target = q.value();
  PsmJoints joints{};
  ArmReport report = follow(state, target, load_W, joints);

  // As differences from the nominal arm: zero effects leave the goal to the bit.
  const Vector3d nominal = tip_of(target, 0);
  assign(state.p_WT_measured, goal + (tip_of(report.measured, 0) - nominal));
  const Vector3d tip =
      goal + (tip_of(joints, effects_.tool_length_offset_m()) - nominal) + bending(target, load_W);
  // Play at the tip, along the axes of W; it begins in the middle.
  const pb::AxisValues& b = effects_.tip_backlash();
  const std::array<double, 3> widths = {b.x(), b.y(), b.z()};
  for (int k = 0; k < 3; ++k)
    state.p_WT_true[k] = widths[k] > 0 ? play(state.p_WT_true[k], tip[k], widths[k]) : tip[k];
  return report;
}

Vector3d Arm::force(const Vector3d& load_W) const {
  return load_W - Vector3d(0, 0, effects_.payload_kg() * kStandardGravity);
}

Vector3d Arm::bending(const PsmJoints& target, const Vector3d& load_W) const {
  const pb::AxisValues& c = effects_.tip_compliance();
  const double depth = 1 + effects_.compliance_depth_slope() * (target[2] - 0.12);
  return depth * Vector3d(c.x(), c.y(), c.z()).cwiseProduct(force(load_W));
}

Vector3d Arm::true_tip(const PsmJoints& tip_joints, const PsmJoints& target,
                       const Vector3d& load_W) const {
  return tip_of(tip_joints, effects_.tool_length_offset_m()) + bending(target, load_W);
}

ArmReport Arm::follow(ArmState& state, const PsmJoints& target, const Vector3d& load_W,
                      PsmJoints& tip_joints) const {
  ArmReport report;
  report.commanded = target;
  const std::array<double, 6> load = load_efforts(target, force(load_W));
  PsmJoints measured{};
  for (std::size_t j = 0; j < 6; ++j) {
    // Servo: droop, two poles of the bandwidth, Coulomb friction against the position gain.
    const double u0 = state.target[j];
    const double d0 = state.droop[j];
    const double a0 = state.pole[0][j];
    state.droop[j] = lag(d0, u0, target[j], droop_[j], decay_droop_[j], dt_);
    state.pole[0][j] = lag(a0, d0, state.droop[j], effects_.bandwidth_s(), decay_pole_, dt_);
    state.pole[1][j] =
        lag(state.pole[1][j], a0, state.pole[0][j], effects_.bandwidth_s(), decay_pole_, dt_);
    const double friction = coulomb_[j] + effects_.load_friction() * std::fabs(load[j]);
    const double before = state.motor[j];
    state.motor[j] = play(before, state.pole[1][j], friction / kServoGain[j]);
    report.effort[j] = kServoGain[j] * (state.pole[1][j] - state.motor[j]) +
                       viscous_[j] * (state.motor[j] - before) / dt_ - load[j];
    measured[j] = state.motor[j] + effects_.servo_compliance() * load[j] / kServoGain[j];
    state.target[j] = target[j];
  }
  report.measured = measured;

  // After the encoder: play of discs and joints, compliance, zero offsets, coupling.
  const PsmJoints behind_discs = play_of_discs(state, measured);
  for (std::size_t j = 0; j < 6; ++j) {
    state.joint[j] = play(state.joint[j], behind_discs[j], backlash_[j]);
    tip_joints[j] = state.joint[j] + compliance_[j] * load[j] + offset_[j];
  }
  for (const pb::JointCoupling& c : effects_.coupling()) {
    tip_joints[c.driven()] += c.slope() * state.joint[c.driving()];
  }
  return report;
}

}  // namespace omentum

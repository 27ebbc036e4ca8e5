#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "core/trig.h"

namespace omentum {

// Turns of held tissue as rotation vectors, with our own sine and arc tangent.

/// [a]x: [a]x b = a x b.
inline Eigen::Matrix3d cross_matrix(const Eigen::Vector3d& a) {
  Eigen::Matrix3d m;
  m << 0, -a.z(), a.y(), a.z(), 0, -a.x(), -a.y(), a.x(), 0;
  return m;
}

inline Eigen::Quaterniond turn_quaternion(const Eigen::Vector3d& angle) {
  const double size = angle.norm();
  const trig::SinCos half = trig::sin_cos(0.5 * size);
  const Eigen::Vector3d v = (size > 0 ? half.sin / size : 0.5) * angle;
  return {half.cos, v.x(), v.y(), v.z()};
}

inline Eigen::Vector3d rotation_vector(const Eigen::Quaterniond& q) {
  const double sine = q.vec().norm();
  return (sine > 0 ? 2 * trig::atan2(sine, q.w()) / sine : 2) * q.vec();
}

/// How a turn w after that by `angle` changes it: d angle = this w, to the sixth power of the angle
/// (I - [a]x / 2 + c [a]x^2 of the exponential map).
inline Eigen::Matrix3d turn_change(const Eigen::Vector3d& angle) {
  const Eigen::Matrix3d X = cross_matrix(angle);
  const double square = angle.squaredNorm();
  const double c = 1.0 / 12 + square / 720 + square * square / 30240;
  return Eigen::Matrix3d::Identity() - 0.5 * X + c * X * X;
}

/// A turn and its rotation vector.
struct Turn {
  Eigen::Quaterniond quaternion = Eigen::Quaterniond::Identity();
  Eigen::Vector3d angle = Eigen::Vector3d::Zero();
  Eigen::Matrix3d matrix = Eigen::Matrix3d::Identity();

  /// Turns further by w.
  void add(const Eigen::Vector3d& w) { set((turn_quaternion(w) * quaternion).normalized()); }
  void set(const Eigen::Quaterniond& q) {
    quaternion = q;
    angle = rotation_vector(quaternion);
    matrix = quaternion.toRotationMatrix();
  }
};

}  // namespace omentum

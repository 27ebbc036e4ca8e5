#include "mismatch/fit/camera_errors.h"

#include <algorithm>

#include "core/constants.h"

namespace omentum {
namespace {

void set(pb::Vec3& to, const Eigen::Vector3d& v) {
  to.set_x(v.x());
  to.set_y(v.y());
  to.set_z(v.z());
}

Eigen::Vector3d vector_of(const pb::Vec3& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

void set_camera_errors(const FitData& data, const FitState& state, pb::Scene& scene) {
  constexpr double kLatest = 0.25;  // [s] that a scene can state
  const Registration6 registration = registration_of(data, state);
  pb::DepthSensor& sensor = *scene.mutable_depth_sensor();
  set(*sensor.mutable_registration_m(), registration.shift);
  set(*sensor.mutable_registration_deg(), registration.turn / kDegree);
  sensor.set_time_offset_s(std::clamp(state.shared[data.layout.clock.begin], -kLatest, kLatest));
}

void take_camera_errors(const FitData& data, const pb::Scene& scene, FitState& state) {
  const pb::DepthSensor& sensor = scene.depth_sensor();
  const int begin = data.layout.registration.begin;
  state.shared.segment<3>(begin) = vector_of(sensor.registration_m());
  state.shared.segment<3>(begin + 3) = kDegree * vector_of(sensor.registration_deg());
  state.shared[data.layout.clock.begin] = sensor.time_offset_s();
}

}  // namespace omentum

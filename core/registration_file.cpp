#include "core/registration_file.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <cmath>

#include "core/check.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/read_file.h"
#include "core/utc_time.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

void set(pb::Vec3& to, const Vector3d& from) {
  to.set_x(from.x());
  to.set_y(from.y());
  to.set_z(from.z());
}

Vector3d to_vector(const pb::Vec3& v) { return {v.x(), v.y(), v.z()}; }

/// Tells what is wrong with a field of a text.
class Reader {
 public:
  Reader(const std::string& name, const std::string& text) : name_(name), text_(text) {
    parse_text_proto(name, text, file_);
  }
  const pb::RegistrationFile& file() const { return file_; }

  [[noreturn]] void refuse(const std::string& field, const std::string& what) const {
    std::string place = place_in_text(name_, text_, file_, field);
    if (place.empty()) place = name_ + ": ";
    throw_error("{}{}: {}", place, field, what);
  }
  void require(bool right, const std::string& field, const std::string& what) const {
    if (!right) refuse(field, what);
  }

 private:
  const std::string& name_;
  const std::string& text_;
  pb::RegistrationFile file_;
};

Eigen::Isometry3d pose_of(const Reader& reader) {
  const pb::RegistrationFile& file = reader.file();
  reader.require(file.p_m_size() == 3, "p_m", fmt::format("{} numbers, needed 3", file.p_m_size()));
  reader.require(file.q_wxyz_size() == 4, "q_wxyz",
                 fmt::format("{} numbers, needed 4", file.q_wxyz_size()));
  for (int i = 0; i < 3; ++i) {
    reader.require(std::abs(file.p_m(i)) <= 100, fmt::format("p_m[{}]", i),
                   fmt::format("{} m, allowed -100 ... 100", file.p_m(i)));
  }
  const Eigen::Quaterniond q(file.q_wxyz(0), file.q_wxyz(1), file.q_wxyz(2), file.q_wxyz(3));
  reader.require(std::abs(q.norm() - 1) <= 1e-6, "q_wxyz[0]",
                 fmt::format("quaternion of length {}, needed 1", q.norm()));
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.linear() = q.normalized().toRotationMatrix();
  X_WR.translation() = Vector3d(file.p_m(0), file.p_m(1), file.p_m(2));
  return X_WR;
}

/// An edited pose or figure would be trusted as measured: all of it follows from the points.
void check_against_points(const Reader& reader, const Registration& registration) {
  constexpr double kRounding = 1e-7;  // m: the text holds every digit
  std::vector<Vector3d> from, to;
  for (const RegisteredPoint& point : registration.points) {
    if (point.outlier) continue;
    from.push_back(point.touched.p_RT);
    to.push_back(point.touched.p_WT);
  }
  reader.require(from.size() >= 4, "point",
                 fmt::format("{} points in the fit, needed 4", from.size()));
  double sum = 0;
  double sum_left_out = 0;
  for (std::size_t i = 0; i < registration.points.size(); ++i) {
    const RegisteredPoint& point = registration.points[i];
    const double residual = (registration.X_WR * point.touched.p_RT - point.touched.p_WT).norm();
    reader.require(std::abs(residual - point.residual) <= kRounding,
                   fmt::format("point[{}].residual_m", i),
                   fmt::format("{}, but pose and point give {}", point.residual, residual));
    if (point.outlier) continue;
    sum += residual * residual;
    sum_left_out += point.leave_one_out * point.leave_one_out;
  }
  const auto count = static_cast<double>(from.size());
  const Eigen::Isometry3d fitted = fit_rigid(from, to);
  double fitted_sum = 0;
  for (std::size_t i = 0; i < from.size(); ++i)
    fitted_sum += (fitted * from[i] - to[i]).squaredNorm();
  // Of points near a line another turn about it fits as well: the residuals judge, not the pose.
  reader.require(std::sqrt(sum / count) <= std::sqrt(fitted_sum / count) + kRounding, "p_m[0]",
                 "pose is not the fit of the points");
  const auto same = [&](const char* field, double given, double follows) {
    reader.require(std::abs(given - follows) <= kRounding, field,
                   fmt::format("{}, but the points give {}", given, follows));
  };
  same("residual_rms_m", registration.residual_rms, std::sqrt(sum / count));
  same("leave_one_out_rms_m", registration.leave_one_out_rms, std::sqrt(sum_left_out / count));
  same("touch_error_m", registration.touch_error, std::sqrt(sum / (count - 2)));
}

}  // namespace

std::string print_registration(const Registration& registration) {
  pb::RegistrationFile file;
  file.set_format_version(1);
  file.set_date(utc_text(registration.date_ns));
  file.set_instrument(registration.instrument);
  const Vector3d p = registration.X_WR.translation();
  for (int i = 0; i < 3; ++i) file.add_p_m(p[i]);
  const Eigen::Quaterniond q(registration.X_WR.linear());
  for (const double part : {q.w(), q.x(), q.y(), q.z()}) file.add_q_wxyz(part);
  set(*file.mutable_tip_in_control_m(), registration.p_CT);
  file.set_residual_rms_m(registration.residual_rms);
  file.set_leave_one_out_rms_m(registration.leave_one_out_rms);
  file.set_touch_error_m(registration.touch_error);
  for (const RegisteredPoint& point : registration.points) {
    pb::RegisteredPoint& to = *file.add_point();
    to.set_name(point.touched.name);
    set(*to.mutable_world_m(), point.touched.p_WT);
    set(*to.mutable_robot_m(), point.touched.p_RT);
    to.set_residual_m(point.residual);
    to.set_leave_one_out_m(point.leave_one_out);
    if (point.outlier) to.set_outlier(true);
  }
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(file, &text));
  return text;
}

Result<void> save_registration(const std::string& path, const Registration& registration) {
  return write_durably(path, print_registration(registration));
}

Registration parse_registration(const std::string& name, const std::string& text) {
  const Reader reader(name, text);
  const pb::RegistrationFile& file = reader.file();
  reader.require(file.format_version() == 1, "format_version",
                 fmt::format("{}, allowed: 1", file.format_version()));
  Registration registration;
  const std::optional<std::int64_t> date = parse_utc(file.date());
  reader.require(date.has_value(), "date",
                 fmt::format("\"{}\", needed as 2026-01-31T12:00:00Z", file.date()));
  registration.date_ns = *date;
  try {
    registration.instrument = find_instrument(file.instrument()).name;
  } catch (const Error& error) {
    reader.refuse("instrument", error.what());
  }
  registration.X_WR = pose_of(reader);
  registration.p_CT = to_vector(file.tip_in_control_m());
  registration.residual_rms = file.residual_rms_m();
  registration.leave_one_out_rms = file.leave_one_out_rms_m();
  registration.touch_error = file.touch_error_m();
  for (const pb::RegisteredPoint& point : file.point()) {
    registration.points.push_back(
        {{point.name(), to_vector(point.world_m()), to_vector(point.robot_m())},
         point.residual_m(),
         point.leave_one_out_m(),
         point.outlier()});
  }
  check_against_points(reader, registration);
  return registration;
}

Registration load_registration(const std::string& path) {
  const Result<std::string> text = read_file(path);
  if (!text) throw_error("{}", text.error());
  return parse_registration(path, text.value());
}

}  // namespace omentum

#include "core/touched_points.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr std::array<const char*, 4> kWorld = {"name", "world_x_m", "world_y_m", "world_z_m"};
constexpr std::array<const char*, 7> kControl = {"control_x_m", "control_y_m", "control_z_m", "q_w",
                                                 "q_x",         "q_y",         "q_z"};

bool is_control(char c) { return static_cast<unsigned char>(c) < 0x20; }

/// A cell as one line of an error may show it: quoted cells hold line ends.
std::string one_line(std::string text) {
  std::replace_if(text.begin(), text.end(), is_control, ' ');
  return text;
}

bool is_name(const std::string& text) {
  return !text.empty() && std::none_of(text.begin(), text.end(), is_control);
}

bool is_column(const std::string& name) {
  const auto is_it = [&](const char* known) { return name == known; };
  return std::any_of(kWorld.begin(), kWorld.end(), is_it) ||
         std::any_of(kControl.begin(), kControl.end(), is_it);
}

Result<void> check_columns(const CsvTable& table, bool with_world) {
  for (const CsvCell& cell : table.header) {
    if (is_column(cell.text)) continue;
    return Failure{fmt::format("{}:{}:{}: unknown column \"{}\", allowed: {}, {}", table.path,
                               table.header_line, cell.at, one_line(cell.text),
                               fmt::join(kWorld, ", "), fmt::join(kControl, ", "))};
  }
  const auto missing = [&](const char* name) { return !table.column(name); };
  for (const char* name : kControl) {
    if (missing(name))
      return Failure{fmt::format("{}:{}: no column {}", table.path, table.header_line, name)};
  }
  for (const char* name : kWorld) {
    if (with_world && missing(name))
      return Failure{fmt::format("{}:{}: no column {}", table.path, table.header_line, name)};
  }
  return {};
}

/// The touch with its point moved from the control point to the tip.
TouchedPoint touched_point(const Touch& touch, const Vector3d& p_CT) {
  return {touch.name, touch.p_WT, touch.pose_RC.p + touch.pose_RC.R * p_CT};
}

}  // namespace

Result<std::vector<Touch>> read_touches(const CsvTable& table, bool with_world) {
  if (const Result<void> checked = check_columns(table, with_world); !checked)
    return Failure{checked.error()};
  if (!table.cut_off.empty()) return Failure{table.cut_off};
  for (std::size_t row = 0; row < table.rows.size(); ++row) {
    for (std::size_t column = 0; column < table.header.size(); ++column) {
      const std::string& cell = table.rows[row][column].text;
      const bool names = table.header[column].text == "name";
      if (names ? is_name(cell) : std::isfinite(parse_number(cell).value_or(NAN))) continue;
      return Failure{fmt::format("{}: \"{}\" in column {} is no {}", table.place(row, column),
                                 one_line(cell), table.header[column].text,
                                 names ? "name" : "finite number")};
    }
  }
  std::vector<Touch> touches;
  for (std::size_t row = 0; row < table.rows.size(); ++row) {
    const auto vector = [&](const char* x, const char* y, const char* z) {
      return Vector3d(table.number(row, x), table.number(row, y), table.number(row, z));
    };
    Touch touch;
    if (with_world) {
      touch.name = table.rows[row][*table.column("name")].text;
      touch.p_WT = vector("world_x_m", "world_y_m", "world_z_m");
    }
    touch.pose_RC.p = vector("control_x_m", "control_y_m", "control_z_m");
    const Vector3d xyz = vector("q_x", "q_y", "q_z");
    const Eigen::Quaterniond q(table.number(row, "q_w"), xyz.x(), xyz.y(), xyz.z());
    if (!(std::abs(q.norm() - 1) <= 1e-3)) {
      return Failure{fmt::format("{}: quaternion of length {:.6g}, needed 1",
                                 table.place(row, *table.column("q_w")), q.norm())};
    }
    touch.pose_RC.R = q.normalized().toRotationMatrix();
    touches.push_back(std::move(touch));
  }
  return touches;
}

Result<Registration> register_from_tables(const RegistrationInput& input) {
  const auto touches_of = [](const std::string& path,
                             bool with_world) -> Result<std::vector<Touch>> {
    const Result<CsvTable> table = load_csv(path);
    if (!table) return Failure{table.error()};
    return read_touches(table.value(), with_world);
  };
  Vector3d p_CT(0, 0, input.nominal_tip_offset);
  std::string warning;
  if (!input.pivots.empty()) {
    const Result<std::vector<Touch>> pivots = touches_of(input.pivots, false);
    if (!pivots) return Failure{pivots.error()};
    std::vector<PsmPose> poses;
    for (const Touch& touch : pivots.value()) poses.push_back(touch.pose_RC);
    const Result<TipPivot> pivot = pivot_tip(poses);
    if (!pivot) return Failure{fmt::format("{}: {}", input.pivots, pivot.error())};
    p_CT = pivot.value().p_CT;
    const double beside = p_CT.head<2>().norm();
    if (beside > 0.001 || std::abs(p_CT.z() - input.nominal_tip_offset) > 0.003) {
      warning = fmt::format(
          "tip found {:.2f} mm along the jaw and {:.2f} mm beside it, nominal {:.2f} and 0: is the "
          "instrument right, is it bent?",
          1e3 * p_CT.z(), 1e3 * beside, 1e3 * input.nominal_tip_offset);
    }
  }
  const Result<std::vector<Touch>> touches = touches_of(input.touches, true);
  if (!touches) return Failure{touches.error()};
  std::vector<TouchedPoint> points;
  for (const Touch& touch : touches.value()) points.push_back(touched_point(touch, p_CT));
  Result<Registration> registered =
      register_points(points, input.rules, input.workspace_min, input.workspace_max);
  if (!registered) return Failure{fmt::format("{}: {}", input.touches, registered.error())};
  Registration registration = std::move(registered).value();
  registration.p_CT = p_CT;
  registration.instrument = input.instrument;
  registration.date_ns = input.date_ns;
  if (!warning.empty()) registration.warnings.push_back(warning);
  return registration;
}

std::string describe_registration(const Registration& registration,
                                  const pb::RegistrationRules& rules, const Vector3d& workspace_min,
                                  const Vector3d& workspace_max) {
  std::string text = "point  residual [mm]  leave-one-out [mm]\n";
  for (const RegisteredPoint& point : registration.points) {
    text += fmt::format("{}  {:.3f}  {:.3f}{}\n", point.touched.name, 1e3 * point.residual,
                        1e3 * point.leave_one_out, point.outlier ? "  outlier, left out" : "");
  }
  const double error = std::max(registration.touch_error, rules.touch_noise_m());
  text += fmt::format(
      "residual {:.3f} mm, leave-one-out {:.3f} mm, one touch {:.3f} mm (all root mean square)\n",
      1e3 * registration.residual_rms, 1e3 * registration.leave_one_out_rms,
      1e3 * registration.touch_error);
  text += fmt::format(
      "predicted error of the tip with touches of {:.3f} mm: {:.3f} mm in the centre of the "
      "workspace, {:.3f} mm in its worst corner\n",
      1e3 * error,
      1e3 * predicted_error(registration, error, 0.5 * (workspace_min + workspace_max)),
      1e3 * worst_predicted_error(registration, error, workspace_min, workspace_max));
  for (const std::string& warning : registration.warnings) text += "warning: " + warning + "\n";
  return text;
}

}  // namespace omentum

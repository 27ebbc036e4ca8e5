#include "mismatch/ros/rows.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <set>

#include "core/check.h"
#include "core/table.h"
#include "mismatch/recording/table_columns.h"

namespace omentum {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();
constexpr std::uint32_t kMostJoints = 9;

Eigen::Vector3d vector_of(const RosValue& value) {
  return {value.number_at("x"), value.number_at("y"), value.number_at("z")};
}

const RosValue& position_in(const RosValue& pose) {
  return pose.get(pose.find("position") != nullptr ? "position" : "translation");
}

/// The k-th number of a field that may be absent or shorter.
double number_of(const RosValue& message, std::string_view field, std::size_t k) {
  const RosValue& numbers = message.numbers_at(field);
  return k < numbers.size() ? numbers.at(k) : kUnknown;
}

bool is_linear(const RosColumns& columns, std::uint32_t joint, std::string_view name) {
  if (columns.linear_known)
    return std::find(columns.linear.begin(), columns.linear.end(), joint) != columns.linear.end();
  if (name.find("insertion") != std::string_view::npos) return true;
  const bool told = !name.empty() && name != fmt::format("q{}", joint);
  return !told && is_usually_linear(fmt::format("{}", joint));
}

}  // namespace

void RosRows::begin_row(std::int64_t time_ns) {
  series_.time_ns.push_back(time_ns);
  series_.values.resize(series_.values.size() + series_.columns.size(), kUnknown);
}

std::size_t RosRows::column(const std::string& name) {
  const std::size_t found = series_.find(name);
  if (found < series_.columns.size()) return found;
  const std::size_t width = series_.columns.size();
  std::vector<double> wider;
  wider.reserve((width + 1) * rows());
  for (std::size_t row = 0; row < rows(); ++row) {
    for (std::size_t k = 0; k < width; ++k) wider.push_back(series_.at(row, k));
    wider.push_back(kUnknown);
  }
  series_.values = std::move(wider);
  series_.columns.push_back(name);
  return width;
}

void RosRows::set(std::size_t column, double value) {
  series_.values[series_.values.size() - series_.columns.size() + column] = value;
}

Series RosRows::take() { return std::move(series_); }

RowTaken add_pose_row(const RosValue& pose, std::int64_t time_ns, const std::string& stem,
                      RosRows& rows) {
  const Eigen::Vector3d p = vector_of(position_in(pose));
  const RosValue& turn = pose.get(pose.find("orientation") != nullptr ? "orientation" : "rotation");
  const Eigen::Quaterniond q(turn.number_at("w"), turn.number_at("x"), turn.number_at("y"),
                             turn.number_at("z"));
  if (!p.allFinite()) return RowTaken::kNothing;
  rows.begin_row(time_ns);
  rows.set(stem + "x_m", p.x());
  rows.set(stem + "y_m", p.y());
  rows.set(stem + "z_m", p.z());
  constexpr double kUnit = 1e-3;  // three digits
  if (!(std::fabs(q.norm() - 1) <= kUnit)) return RowTaken::kPart;
  rows.set(stem + "qw", q.w());
  rows.set(stem + "qx", q.x());
  rows.set(stem + "qy", q.y());
  rows.set(stem + "qz", q.z());
  return RowTaken::kAll;
}

RowTaken add_marker_row(const RosValue& pose, std::int64_t time_ns, const std::string& marker,
                        RosRows& rows) {
  const Eigen::Vector3d p = vector_of(position_in(pose));
  if (!p.allFinite()) return RowTaken::kNothing;
  rows.begin_row(time_ns);
  for (Eigen::Index k = 0; k < 3; ++k) rows.set(fmt::format("{}_{}_m", marker, "xyz"[k]), p[k]);
  return RowTaken::kAll;
}

RowTaken add_wrench_row(const RosValue& wrench, std::int64_t time_ns, double factor,
                        RosRows& rows) {
  const Eigen::Vector3d force = vector_of(wrench.get("force"));
  const Eigen::Vector3d torque = vector_of(wrench.get("torque"));
  if (!force.allFinite() || !torque.allFinite()) return RowTaken::kNothing;
  rows.begin_row(time_ns);
  for (Eigen::Index k = 0; k < 3; ++k) rows.set(fmt::format("f{}_N", "xyz"[k]), factor * force[k]);
  for (Eigen::Index k = 0; k < 3; ++k)
    rows.set(fmt::format("t{}_Nm", "xyz"[k]), factor * torque[k]);
  return RowTaken::kAll;
}

namespace {

/// Number of a joint by a name that tells it; 0 by any other.
std::uint32_t number_told(std::string_view name) {
  std::string text(name);
  for (char& c : text) c = c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c;
  std::string_view rest = text;
  if (rest.ends_with("_joint")) rest.remove_suffix(6);
  for (const auto& [known, number] : {std::pair{std::string_view("wrist_pitch"), 5U},
                                      {"wrist_yaw", 6U},
                                      {"insertion", 3U},
                                      {"roll", 4U},
                                      {"pitch", 2U},
                                      {"yaw", 1U},
                                      {"jaw", 7U}}) {
    if (!rest.ends_with(known)) continue;
    const std::size_t before = rest.size() - known.size();
    if (before == 0 || rest[before - 1] == '_' || rest[before - 1] == '/') return number;
  }
  for (const std::string_view begin : {"joint_", "joint", "q"}) {
    if (rest.size() == begin.size() + 1 && rest.starts_with(begin) && rest.back() >= '1' &&
        rest.back() <= '9')
      return static_cast<std::uint32_t>(rest.back() - '0');
  }
  return 0;
}

}  // namespace

std::vector<std::uint32_t> RosJointNames::numbers(const std::vector<RosValue>& names,
                                                  std::size_t count) {
  std::vector<std::uint32_t> found(count);
  std::iota(found.begin(), found.end(), 1U);
  std::set<std::string_view> distinct;
  for (const RosValue& name : names) distinct.insert(name.bytes);
  if (names.empty() || names.size() != count || distinct.size() != names.size() ||
      distinct.contains("") || count > 100)
    return found;
  const bool first = by_number_.empty();
  std::set<std::uint32_t> told;
  for (const RosValue& name : names) told.insert(number_told(name.bytes));
  if (first) of_robot_ = told.size() == names.size() && !told.contains(0);
  for (std::size_t k = 0; k < count; ++k) {
    const std::string_view name = names[k].bytes;
    const auto known = std::find(by_number_.begin(), by_number_.end(), name);
    std::size_t at = static_cast<std::size_t>(known - by_number_.begin());
    const std::uint32_t own = of_robot_ ? number_told(name) : 0;
    if (known == by_number_.end() && own > 0 &&
        (by_number_.size() < own || by_number_[own - 1].empty()))
      at = own - 1;
    constexpr std::size_t kMost = 200;  // beyond it they are no joints of one robot
    at = std::min(at, kMost);
    if (at >= by_number_.size()) by_number_.resize(at + 1);
    by_number_[at] = name;
    found[k] = static_cast<std::uint32_t>(at + 1);
  }
  if (first) first_numbers_ = found;
  if (found != first_numbers_ &&
      std::is_permutation(found.begin(), found.end(), first_numbers_.begin(), first_numbers_.end()))
    ++reordered_;
  return found;
}

std::string RosJointNames::told() const {
  if (reordered_ == 0 && std::is_sorted(first_numbers_.begin(), first_numbers_.end())) return "";
  std::string text;
  for (std::size_t k = 0; k < by_number_.size(); ++k) {
    if (!by_number_[k].empty())
      text += fmt::format("{}q{} {}", text.empty() ? "" : ", ", k + 1, shown(by_number_[k]));
  }
  return text;
}

RowTaken add_joint_row(const RosValue& state, std::int64_t time_ns, const RosColumns& columns,
                       RosJointNames& known, RosRows& rows) {
  const std::vector<RosValue>& names = state.get("name").items;
  std::size_t count = names.size();
  for (const char* field : {"position", "velocity", "effort"})
    count = std::max(count, state.numbers_at(field).size());
  const std::vector<std::uint32_t> numbers = known.numbers(names, count);
  rows.begin_row(time_ns);
  bool any = false, all = true;
  for (std::size_t k = 0; k < count; ++k) {
    if (numbers[k] > kMostJoints) {
      all = false;
      continue;
    }
    JointColumn column;
    column.joint = fmt::format("{}", numbers[k]);
    column.linear = is_linear(columns, numbers[k], k < names.size() ? names[k].bytes : "");
    column.source = columns.source == "commanded"  ? JointColumn::kCommanded
                    : columns.source == "setpoint" ? JointColumn::kSetpoint
                                                   : JointColumn::kMeasured;
    const auto put = [&](JointColumn::Quantity quantity, const char* field) {
      const double value = number_of(state, field, k);
      if (!std::isfinite(value)) return;
      column.quantity = quantity;
      rows.set(name_of(column), value);
      any = true;
    };
    put(JointColumn::kPosition, "position");
    put(JointColumn::kVelocity, "velocity");
    put(JointColumn::kEffort, "effort");
  }
  if (!any) return RowTaken::kNothing;
  return all ? RowTaken::kAll : RowTaken::kPart;
}

RowTaken add_jaw_row(const RosValue& state, std::int64_t time_ns, const std::string& source,
                     RosRows& rows) {
  const double position = number_of(state, "position", 0);
  if (!std::isfinite(position)) return RowTaken::kNothing;
  rows.begin_row(time_ns);
  rows.set(fmt::format("jaw_{}_rad", source), position);
  if (source != "measured") return RowTaken::kAll;
  const double velocity = number_of(state, "velocity", 0), effort = number_of(state, "effort", 0);
  if (std::isfinite(velocity)) rows.set("jaw_velocity_rad_per_s", velocity);
  if (std::isfinite(effort)) rows.set("jaw_effort_Nm", effort);
  return RowTaken::kAll;
}

Series merge_rows(std::vector<Series> parts, std::size_t& dropped) {
  struct From {
    std::int64_t time_ns = 0;
    std::size_t part = 0, row = 0;
  };
  std::vector<From> order;
  std::vector<std::vector<std::size_t>> to(parts.size());
  Series merged;
  for (std::size_t part = 0; part < parts.size(); ++part) {
    for (std::size_t row = 0; row < parts[part].rows(); ++row)
      order.push_back({parts[part].time_ns[row], part, row});
    for (const std::string& name : parts[part].columns) {
      to[part].push_back(merged.find(name));
      if (to[part].back() == merged.columns.size()) merged.columns.push_back(name);
    }
  }
  std::stable_sort(order.begin(), order.end(),
                   [](const From& a, const From& b) { return a.time_ns < b.time_ns; });
  const std::size_t width = merged.columns.size();
  merged.values.reserve(order.size() * width);
  for (const From& from : order) {
    const Series& part = parts[from.part];
    const bool together = !merged.time_ns.empty() && merged.time_ns.back() == from.time_ns;
    if (!together) {
      merged.time_ns.push_back(from.time_ns);
      merged.values.resize(merged.values.size() + width, kUnknown);
    }
    double* row = merged.values.data() + merged.values.size() - width;
    bool contradicts = false;
    for (std::size_t k = 0; k < part.columns.size(); ++k)
      contradicts =
          contradicts || (!std::isnan(row[to[from.part][k]]) && !std::isnan(part.at(from.row, k)));
    if (contradicts) {
      ++dropped;
      continue;
    }
    for (std::size_t k = 0; k < part.columns.size(); ++k) {
      const double value = part.at(from.row, k);
      if (!std::isnan(value)) row[to[from.part][k]] = value;
    }
  }
  return merged;
}

Series wrench_at_tip(const Series& wrench, const Series& tool,
                     const std::optional<Eigen::Isometry3d>& X_WB, std::size_t& dropped) {
  const std::size_t p = tool.find("tip_measured_x_m"), q = tool.find("tip_measured_qw");
  Series turned;
  turned.columns = wrench.columns;
  if (q + 4 > tool.columns.size()) {
    dropped += wrench.rows();
    return turned;
  }
  const std::size_t f = wrench.find("fx_N"), t = wrench.find("tx_Nm");
  for (std::size_t row = 0; row < wrench.rows(); ++row) {
    // The last pose before it: a period of the robot moves the tip by less than it can be known.
    const auto next =
        std::upper_bound(tool.time_ns.begin(), tool.time_ns.end(), wrench.time_ns[row]);
    const auto at = static_cast<std::size_t>(next - tool.time_ns.begin());
    if (at == 0 || std::isnan(tool.at(at - 1, q))) {
      ++dropped;
      continue;
    }
    const double* pose = tool.values.data() + (at - 1) * tool.columns.size();
    const Eigen::Vector3d tip(pose[p], pose[p + 1], pose[p + 2]);
    const Eigen::Quaterniond turn(pose[q], pose[q + 1], pose[q + 2], pose[q + 3]);
    const double* values = wrench.values.data() + row * wrench.columns.size();
    Eigen::Vector3d force(values[f], values[f + 1], values[f + 2]);
    Eigen::Vector3d torque(values[t], values[t + 1], values[t + 2]);
    const Eigen::Quaterniond R = !X_WB ? turn.normalized() : Eigen::Quaterniond(X_WB->linear());
    force = R * force;
    torque = R * torque;
    if (X_WB) torque -= (tip - X_WB->translation()).cross(force);
    turned.time_ns.push_back(wrench.time_ns[row]);
    turned.values.insert(turned.values.end(), force.data(), force.data() + 3);
    turned.values.insert(turned.values.end(), torque.data(), torque.data() + 3);
  }
  return turned;
}

}  // namespace omentum

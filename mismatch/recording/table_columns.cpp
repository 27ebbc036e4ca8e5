#include "mismatch/recording/table_columns.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <set>

#include "core/check.h"

namespace omentum {
namespace {

constexpr std::array<std::string_view, 7> kPose = {"x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"};
constexpr std::array<std::string_view, 3> kSources = {"commanded", "setpoint", "measured"};
constexpr std::array<std::string_view, 5> kJaw = {"jaw_commanded_rad", "jaw_measured_rad",
                                                  "jaw_setpoint_rad", "jaw_velocity_rad_per_s",
                                                  "jaw_effort_Nm"};
constexpr std::array<std::string_view, 6> kForce = {"fx_N",  "fy_N",  "fz_N",
                                                    "tx_Nm", "ty_Nm", "tz_Nm"};
constexpr std::array<std::string_view, 4> kCoupon = {"elongation_m", "load_N", "strain_engineering",
                                                     "stress_engineering_Pa"};
// Tables begin with what was commanded, then what was measured; the set-point is rare.
constexpr std::array<int, 3> kSourceRank = {0, 2, 1};

template <typename List>
std::optional<int> index_in(const List& list, std::string_view name) {
  const auto found = std::find(list.begin(), list.end(), name);
  if (found == list.end()) return std::nullopt;
  return static_cast<int>(found - list.begin());
}

bool take(std::string_view& text, std::string_view prefix) {
  if (!text.starts_with(prefix)) return false;
  text.remove_prefix(prefix.size());
  return true;
}

std::string topic_of(std::string_view stem, int source) {
  constexpr std::array<std::string_view, 3> kSuffix = {"_commanded", "_setpoint", ""};
  return fmt::format("{}{}", stem, kSuffix[static_cast<std::size_t>(source)]);
}

std::optional<ColumnPlace> place_in_tool(std::string_view name) {
  constexpr int kPerSource = 10, kAfterTips = 100;
  if (const auto jaw = index_in(kJaw, name)) return ColumnPlace{"jaw", kAfterTips + *jaw};
  std::string_view rest = name;
  if (!take(rest, "tip_")) return std::nullopt;
  for (std::size_t source = 0; source < kSources.size(); ++source) {
    std::string_view axis = rest;
    if (!take(axis, kSources[source]) || !take(axis, "_")) continue;
    const auto part = index_in(kPose, axis);
    if (!part) return std::nullopt;
    return ColumnPlace{topic_of("tool", static_cast<int>(source)),
                       kPerSource * kSourceRank[source] + *part};
  }
  return std::nullopt;
}

std::optional<ColumnPlace> place_in_joints(std::string_view name) {
  const auto column = parse_joint_column(name);
  if (!column) return std::nullopt;
  const int joint = column->joint == "in"    ? 10
                    : column->joint == "out" ? 11
                                             : column->joint.front() - '0';
  constexpr std::array<int, 3> kRank = {0, 1, 2};  // position: commanded, set-point, measured
  return ColumnPlace{topic_of("joints", column->source),
                     10 * joint + 3 * column->quantity + kRank[column->source]};
}

}  // namespace

std::vector<std::string> topics_of(std::string_view file) {
  if (file == "tool.csv") return {"tool_commanded", "tool", "tool_setpoint", "jaw"};
  if (file == "joints.csv") return {"joints_commanded", "joints_setpoint", "joints"};
  return {std::string(file.substr(0, file.find('.')))};
}

std::optional<ColumnPlace> place_of_column(std::string_view file, std::string_view name) {
  if (file == "tool.csv") return place_in_tool(name);
  if (file == "joints.csv") return place_in_joints(name);
  std::optional<int> rank;
  if (file == "force.csv") rank = index_in(kForce, name);
  if (file == "coupon.csv") rank = index_in(kCoupon, name);
  if (file == "tracker.csv") {
    std::string_view axis = name;
    if (take(axis, "tip_optical_")) rank = index_in(kPose, axis);
  }
  if (file == "markers.csv" && name.size() > 4) {
    const std::string_view end = name.substr(name.size() - 4);
    if (end == "_x_m" || end == "_y_m" || end == "_z_m") rank = 0;
  }
  if (!rank) return std::nullopt;
  return ColumnPlace{topics_of(file).front(), *rank};
}

std::optional<JointColumn> parse_joint_column(std::string_view name) {
  JointColumn column;
  std::string_view rest = name;
  if (take(rest, "dq")) {
    column.quantity = JointColumn::kVelocity;
  } else if (take(rest, "effort")) {
    column.quantity = JointColumn::kEffort;
  } else if (take(rest, "torque")) {
    column.quantity = JointColumn::kEffort;
    if (!rest.starts_with("_in_") && !rest.starts_with("_out_")) return std::nullopt;
  } else if (!take(rest, "q")) {
    return std::nullopt;
  }
  if (take(rest, "_in")) {
    column.joint = "in";
  } else if (take(rest, "_out")) {
    column.joint = "out";
  } else if (!rest.empty() && rest.front() >= '1' && rest.front() <= '9') {
    column.joint.push_back(rest.front());
    rest.remove_prefix(1);
  }
  if (column.joint.empty() || !take(rest, "_")) return std::nullopt;
  bool stated = false;
  for (std::size_t source = 0; source < kSources.size() && !stated; ++source) {
    stated = take(rest, kSources[source]);
    if (stated) column.source = static_cast<JointColumn::Source>(source);
  }
  if (stated && !take(rest, "_")) return std::nullopt;
  // An effort is measured where nothing is said.
  if (!stated && column.quantity != JointColumn::kEffort) return std::nullopt;
  for (const bool linear : {false, true}) {
    column.linear = linear;
    if (name_of(column) == name) return column;
  }
  return std::nullopt;
}

std::string name_of(const JointColumn& c) {
  const bool bench = c.joint == "in" || c.joint == "out";
  const std::string joint = fmt::format("{}{}", bench ? "_" : "", c.joint);
  const std::string_view source = kSources[c.source];
  if (c.quantity == JointColumn::kEffort) {
    const std::string said = c.source == JointColumn::kMeasured ? "" : fmt::format("_{}", source);
    return fmt::format("{}{}{}_{}", bench ? "torque" : "effort", joint, said,
                       c.linear ? "N" : "Nm");
  }
  const bool velocity = c.quantity == JointColumn::kVelocity;
  return fmt::format("{}q{}_{}_{}{}", velocity ? "d" : "", joint, source, c.linear ? "m" : "rad",
                     velocity ? "_per_s" : "");
}

namespace {

/// Whole groups of columns: x y z, w x y z.
Result<void> check_groups(std::string_view file, const std::vector<std::string>& columns) {
  const std::set<std::string, std::less<>> all(columns.begin(), columns.end());
  if (all.size() < columns.size()) {
    for (const std::string& name : all) {
      if (std::count(columns.begin(), columns.end(), name) > 1)
        return Failure{fmt::format("column {} appears twice", name)};
    }
  }
  if (file == "joints.csv" || file == "coupon.csv") return {};
  const bool force = file == "force.csv";
  for (const std::string_view name : columns) {
    for (const std::string_view end : {"_qw", "_qx", "_qy", "_qz", "_x_m", "_y_m", "_z_m", "x_N",
                                       "y_N", "z_N", "x_Nm", "y_Nm", "z_Nm"}) {
      if (!name.ends_with(end) || force != (end.ends_with("_N") || end.ends_with("_Nm"))) continue;
      const std::size_t axis_at = end.find_first_of("wxyz");
      const std::string_view stem = name.substr(0, name.size() - end.size());
      const bool turn = end.starts_with("_q");
      const auto needed = [&](char axis) {
        return fmt::format("{}{}{}{}", stem, end.substr(0, axis_at), axis, end.substr(axis_at + 1));
      };
      for (const char axis : turn ? std::string_view("wxyz") : std::string_view("xyz")) {
        if (all.count(needed(axis)) == 0)
          return Failure{fmt::format("column {} without {}", name, needed(axis))};
      }
      if (turn && all.count(fmt::format("{}_x_m", stem)) == 0)
        return Failure{fmt::format("column {} without {}_x_m", name, stem)};
    }
  }
  return {};
}

/// Name without its axis, of columns that mean something only together: "tip_measured_" of
/// tip_measured_x_m, "tip_measured_q" of tip_measured_qw, "f_N" of fx_N; empty of all others.
std::string group_of(std::string_view file, std::string_view name) {
  if (file == "tool.csv" || file == "tracker.csv") {
    for (const std::string_view end : {"x_m", "y_m", "z_m"}) {
      if (name.ends_with(end)) return std::string(name.substr(0, name.size() - end.size()));
    }
    for (const std::string_view end : {"_qw", "_qx", "_qy", "_qz"}) {
      if (name.ends_with(end)) return std::string(name.substr(0, name.size() - 1));
    }
  }
  if (file == "force.csv") return std::string(name.substr(0, 1)) + std::string(name.substr(2));
  return "";
}

}  // namespace

std::vector<std::string> never_known(const Series& series) {
  std::vector<std::string> names;
  for (std::size_t k = 0; k < series.columns.size(); ++k) {
    bool known = false;
    for (std::size_t row = 0; row < series.rows() && !known; ++row)
      known = !std::isnan(series.at(row, k));
    if (!known) names.push_back(series.columns[k]);
  }
  return names;
}

std::string told_never_known(const Series& series) {
  constexpr std::size_t kEnough = 6;
  std::vector<std::string> names = never_known(series);
  if (names.empty()) return "";
  const std::size_t more = names.size() - std::min(kEnough, names.size());
  names.resize(names.size() - more);
  return fmt::format("{}{} known in no row", fmt::join(names, ", "),
                     more > 0 ? fmt::format(" and {} others", more) : "");
}

Result<void> normalise(std::string_view file, Series& series) {
  if (Result<void> whole = check_groups(file, series.columns); !whole) return whole;
  const std::size_t width = series.columns.size();
  std::vector<bool> known(width, false);
  std::vector<std::size_t> rows;
  for (std::size_t row = 0; row < series.rows(); ++row) {
    bool any = false;
    for (std::size_t k = 0; k < width; ++k) {
      if (std::isnan(series.at(row, k))) continue;
      any = true;
      known[k] = true;
    }
    if (any) rows.push_back(row);
  }
  // Of a position, an orientation or a force all numbers stay or none: messages hold all of them,
  // and a neighbour would take the place of the one that is missing.
  std::set<std::string> known_groups;
  for (std::size_t k = 0; k < width; ++k) {
    if (known[k]) known_groups.insert(group_of(file, series.columns[k]));
  }
  known_groups.erase("");
  std::vector<std::size_t> order;
  for (std::size_t k = 0; k < width; ++k) {
    const bool together = known_groups.count(group_of(file, series.columns[k])) > 0;
    // A force may be known along some axes; half a position or orientation is none.
    if (!known[k] && together && file != "force.csv")
      return Failure{fmt::format(
          "column {} is empty in every row, and others of its {} are not: needed all of them, or "
          "none",
          series.columns[k], series.columns[k].ends_with("_m") ? "position" : "orientation")};
    // A marker keeps its place: the message holds all of them.
    if (known[k] || together || file == "markers.csv") order.push_back(k);
  }
  const auto rank = [&](std::size_t k) {
    const auto place = place_of_column(file, series.columns[k]);
    OMENTUM_CHECK(place.has_value(), "column {} of {}", series.columns[k], file);
    return place->rank;
  };
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return rank(a) < rank(b); });
  if (file == "markers.csv") {
    // x y z of a marker beside each other, markers in the order of their first column.
    std::map<std::string, std::size_t> first;
    const auto stem = [&](std::size_t k) {
      std::string name = series.columns[k];
      name.erase(name.size() - 4);  // _x_m
      return name;
    };
    for (const std::size_t k : order) first.emplace(stem(k), k);
    std::vector<std::pair<std::size_t, std::string>> keys(width);
    for (const std::size_t k : order) keys[k] = {first.at(stem(k)), series.columns[k]};
    std::sort(order.begin(), order.end(),
              [&](std::size_t a, std::size_t b) { return keys[a] < keys[b]; });
  }
  Series sorted;
  sorted.path = std::move(series.path);
  for (const std::size_t k : order) sorted.columns.push_back(series.columns[k]);
  sorted.values.reserve(rows.size() * order.size());
  for (const std::size_t row : rows) {
    sorted.time_ns.push_back(series.time_ns[row]);
    if (!series.lines.empty()) sorted.lines.push_back(series.lines[row]);
    for (const std::size_t k : order) sorted.values.push_back(series.at(row, k));
  }
  series = std::move(sorted);
  return {};
}

}  // namespace omentum

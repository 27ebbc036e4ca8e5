#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"
#include "mismatch/recording/recording.h"

namespace omentum {

/// Tables of numbers of a recording folder (docs/formats.md 3).
inline constexpr std::array<std::string_view, 6> kTableFiles = {
    "tool.csv", "joints.csv", "tracker.csv", "force.csv", "markers.csv", "coupon.csv"};

/// Topics of a table: its columns are theirs.
std::vector<std::string> topics_of(std::string_view file);

/// Where a column of a table belongs.
struct ColumnPlace {
  std::string topic;
  int rank = 0;  ///< order in the table and in the topic; of markers that of the table
};
/// Of a name with the unit of SI; nothing where the table has no such column.
std::optional<ColumnPlace> place_of_column(std::string_view file, std::string_view name);

/// Columns without a number in any row.
std::vector<std::string> never_known(const Series& series);
/// The same for people; empty where there are none.
std::string told_never_known(const Series& series);

/// Number of a joint or side of a bench ("1" ... "9", "in", "out") and quantity of a column of
/// joints.csv.
struct JointColumn {
  enum Quantity { kPosition, kVelocity, kEffort };
  enum Source { kCommanded, kSetpoint, kMeasured };
  std::string joint;
  Quantity quantity = kPosition;
  Source source = kMeasured;
  bool linear = false;  ///< m and N instead of rad and N m
};
std::optional<JointColumn> parse_joint_column(std::string_view name);
std::string name_of(const JointColumn& column);
/// The insertion of a PSM is its joint 3.
inline bool is_usually_linear(std::string_view joint) { return joint == "3"; }

/// Puts columns into their order, drops columns that no row knows and rows that know nothing. Of a
/// force whose axes are known in part the others stay, not known. Fails with one line: a position
/// without one of x y z, an orientation without one of w x y z, as a column or in every row, a
/// column twice.
Result<void> normalise(std::string_view file, Series& series);

}  // namespace omentum

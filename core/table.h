#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// A table of numbers with one header line, as recording folders hold them (docs/formats.md 3):
/// comma separated, no quotes. Columns are converted to SI by the suffix of their name
/// (`_mm`, `_deg`, `_ms`, `_g`), which is then replaced by that of the SI unit.
struct Table {
  std::string path;
  std::vector<std::string> names;
  std::vector<std::vector<double>> columns;          ///< [column][row]
  std::vector<std::size_t> lines;                    ///< of the file, of each row
  std::vector<std::vector<std::size_t>> characters;  ///< [column][row]: of its line, from 1
  /// The last line has no end: of its last number a part may be missing.
  bool open_end = false;

  std::size_t rows() const { return columns.empty() ? 0 : columns.front().size(); }
  /// Column of that name, if there is one.
  const std::vector<double>* find(const std::string& name) const;
  /// Column of that name; throws Error naming file and column.
  const std::vector<double>& column(const std::string& name) const;
  /// "path:line:character" of a cell of a column that there is.
  std::string place(std::size_t row, const std::string& name) const;
};

/// A name of a column in SI units, and what its numbers are multiplied by.
struct SiColumn {
  std::string name;
  double factor = 1;
};
/// Fails where the name ends in no known unit.
Result<SiColumn> si_column(std::string_view name);

/// Throws Error, one line with file:line:column and what was expected there: no header, two columns
/// of one name, a cell that is no finite number, a row of another length, an unknown unit suffix.
/// A byte order mark does not count.
Table parse_table(const std::string& path, std::string_view text);
/// The same of a regular file of at most 1 GB.
Table read_table(const std::string& path);

/// Seconds of each row: the column `t_s`, strictly increasing, or rows at the nominal rate where
/// there is no such column. Throws Error with file:line for time that does not increase.
/// Precondition: nominal_rate_hz > 0.
std::vector<double> table_times(const Table& table, double nominal_rate_hz);

/// Text of a file as it may stand in a message of one line: without control characters, cut.
std::string shown(std::string_view text);

}  // namespace omentum

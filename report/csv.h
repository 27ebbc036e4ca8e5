#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// A CSV file with a header line: columns of text. Quoted fields may hold commas, quotes and line
/// ends.
struct CsvTable {
  std::vector<std::string> columns;
  std::vector<std::vector<std::string>> rows;  ///< each as long as `columns`
  std::size_t dropped = 0;  ///< rows of another length: a writer was stopped in the middle

  std::optional<std::size_t> column(std::string_view name) const;
  /// Numbers of a column; NaN for what is not a number. Empty if there is no such column.
  std::vector<double> numbers(std::string_view name) const;
  /// One cell as a number, NaN if absent.
  double number(std::size_t row, std::string_view name) const;
};

/// Total: any text gives a table.
CsvTable parse_csv(std::string_view text);

/// Fails if the file cannot be opened.
Result<CsvTable> load_csv(const std::string& path);

/// "true" and "yes" count as 1, "false" and "no" as 0; NaN for anything else that is not a number.
double parse_number(std::string_view text);

}  // namespace omentum

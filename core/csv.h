#pragma once

#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// One cell, and the character (from 1) of its line where it begins.
struct CsvCell {
  std::string text;
  std::size_t at = 1;
};

/// A CSV file: a header line, then rows of as many cells. A cell may be quoted: it then holds
/// commas and line ends as they are and "" for a quote. Blanks around other cells, and lines of
/// nothing but blanks, do not count.
struct CsvTable {
  std::string path;
  std::vector<CsvCell> header;
  std::vector<std::vector<CsvCell>> rows;  ///< each as long as `header`
  std::size_t header_line = 1;             ///< from 1
  std::vector<std::size_t> lines;          ///< of each row
  /// What is wrong with a last line that has no end and too few cells, as a writer leaves it that
  /// was stopped; such a line is left out. Empty if there is none.
  std::string cut_off;

  std::optional<std::size_t> column(std::string_view name) const;
  /// "path:line:character" of a cell that there is.
  std::string place(std::size_t row, std::size_t column) const;
  /// Fails on the first cell that is neither empty nor a number (`nan` and `inf` are numbers), but
  /// in the columns that `text` names.
  Result<void> require_numbers(const std::vector<std::string>& text = {}) const;
  /// Numbers of a column, NaN for what is none; empty if there is no such column.
  std::vector<double> numbers(std::string_view name) const;
  /// One cell as a number, NaN if it is absent or none.
  double number(std::size_t row, std::string_view name) const;
};

/// Fails with one line, path:line[:character] and what is wrong there: no header, a row of another
/// length, a quote inside a cell or one that is never closed.
Result<CsvTable> parse_csv(const std::string& path, std::string_view text);
/// The same of a file; fails as well if it cannot be opened.
Result<CsvTable> load_csv(const std::string& path);

/// The whole text as a number; nothing if it is none or too large.
std::optional<double> parse_number(std::string_view text);

}  // namespace omentum

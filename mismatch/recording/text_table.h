#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

namespace omentum {

/// How a table is written down.
struct TextFormat {
  std::string delimiter = ",";  ///< one character; a blank stands for any run of blanks and tabs
  std::string comment;          ///< lines that begin so are no rows; empty: there are none
  std::string header_starts;    ///< the header is the first line that begins so; empty: the first
  std::vector<std::string> unknown;  ///< cells that say "not known", beside empty ones
  std::size_t skip_lines = 0;        ///< before the header
  std::size_t unit_rows = 0;         ///< behind the header
  /// Rows end before the first line behind the header that begins so; "": before a line of nothing
  /// but blanks and delimiters; none: with the file.
  std::optional<std::string> ends_before;
  bool decimal_comma = false;
  bool header = true;  ///< false: columns are called "1", "2", ...
};

/// A table of text, cells of which are numbers or words. Blanks around cells, quotes around a cell
/// and lines of nothing but blanks do not count, nor do empty cells behind the last column.
class TextTable {
 public:
  /// Throws Error, path:line[:character] and what was expected: no header, a row of another length,
  /// a quote without its other one, a byte of zero.
  TextTable(std::string path, std::string text, const TextFormat& format);
  /// Of a regular file of at most 1 GB.
  static TextTable read(const std::string& path, const TextFormat& format);

  const std::string& path() const { return path_; }
  const std::vector<std::string>& names() const { return names_; }
  /// Index of a column, "#3": of the third whatever it is called; an Error names the ones that
  /// there are, or the places of a name that stands in several.
  std::size_t column(const std::string& name) const;
  /// The first of that name.
  std::optional<std::size_t> find(std::string_view name) const;
  std::size_t rows() const { return lines_.size(); }
  std::string_view cell(std::size_t row, std::size_t column) const;
  /// NaN of a cell that is empty or says so; throws Error where it is no finite number.
  double number(std::size_t row, std::size_t column) const;
  /// Of seconds, exact; throws Error where it is no number.
  std::int64_t time_ns(std::size_t row, std::size_t column, double factor) const;
  std::string place(std::size_t row, std::size_t column) const;
  /// Lines of the rows in the file.
  const std::vector<std::uint32_t>& lines() const { return lines_; }
  /// The last line has no end: of its last number a part may be missing.
  bool open_end() const { return !text_.empty() && text_.back() != '\n'; }
  std::string header_place(std::size_t column) const;
  /// What was passed over, one line each.
  const std::vector<std::string>& warnings() const { return warnings_; }
  /// Lines that are no rows: comments, what was skipped, the header.
  const std::vector<std::string>& head() const { return head_; }

 private:
  using Span = std::pair<std::uint32_t, std::uint32_t>;  ///< begin and end in text_
  void split(std::size_t begin, std::size_t end, std::size_t number,
             std::vector<Span>& cells) const;
  void add_row(std::size_t begin, std::size_t end, std::size_t number, bool after_gap);
  bool ends_at(std::string_view line) const;
  std::optional<double> parse(std::string_view cell) const;

  std::string path_, text_;
  TextFormat format_;
  std::vector<std::string> names_, head_, warnings_;
  std::size_t header_line_ = 1;
  std::vector<Span> header_cells_;
  std::vector<Span> cells_;  ///< row by row
  std::vector<std::uint32_t> lines_, line_begins_;
  std::size_t ended_by_delimiter_ = 0;  ///< rows with empty cells behind the last column
};

/// Rows whose times increase, and their times. A row that steps back by a millionth of a second or
/// less, as few of them do where a clock was steered, is left out and told; throws Error with its
/// place where more of them do, or by more.
void keep_increasing(const TextTable& table, std::size_t column, std::vector<std::size_t>& rows,
                     std::vector<std::int64_t>& times, std::vector<std::string>& warnings);

/// The whole content of a regular file of at most 1 GB. Throws Error.
std::string read_whole_file(const std::string& path);

}  // namespace omentum

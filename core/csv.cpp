#include "core/csv.h"

#include <fmt/core.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iterator>
#include <limits>
#include <utility>

namespace omentum {
namespace {

constexpr std::string_view kBlanks = " \t\r";

std::string_view trim(std::string_view text) {
  const std::size_t from = text.find_first_not_of(kBlanks);
  if (from == std::string_view::npos) return {};
  return text.substr(from, text.find_last_not_of(kBlanks) - from + 1);
}

/// Takes the text apart, row by row.
class CsvParser {
 public:
  CsvParser(const std::string& path, std::string_view text) : path_(path), text_(text) {}

  /// A row follows. Lines of blanks are passed over.
  bool more() {
    while (at_ < text_.size()) {
      const std::size_t end = std::min(text_.find('\n', at_), text_.size());
      if (!trim(text_.substr(at_, end - at_)).empty()) return true;
      at_ = end + 1;
      line_begin_ = at_;
      ++line_;
    }
    return false;
  }

  /// Precondition: more(). Fails on quotes that are not closed or not where they belong.
  Result<std::vector<CsvCell>> row() {
    row_line_ = line_;
    std::vector<CsvCell> cells;
    while (true) {
      Result<CsvCell> cell = this->cell();
      if (!cell) return Failure{cell.error()};
      cells.push_back(std::move(cell).value());
      if (at_ < text_.size() && text_[at_] == ',') {
        ++at_;
        continue;
      }
      ended_ = at_ < text_.size();
      if (ended_) next_line();
      return cells;
    }
  }

  std::size_t row_line() const { return row_line_; }
  /// The row taken last had a line end.
  bool ended() const { return ended_; }
  /// The text ended inside quotes.
  bool open_quote() const { return open_quote_; }

 private:
  void next_line() {
    ++at_;
    line_begin_ = at_;
    ++line_;
  }

  /// Leaves at_ at the comma, the line end or the end of the text behind the cell.
  Result<CsvCell> cell() {
    const std::size_t from = at_ - line_begin_ + 1;
    const std::size_t end = std::min(text_.find_first_of(",\n", at_), text_.size());
    const std::size_t begin = text_.find_first_not_of(kBlanks, at_);
    if (begin < text_.size() && text_[begin] == '"') {
      at_ = begin + 1;
      return quoted(from);
    }
    const std::string_view text = text_.substr(at_, end - at_);
    if (const std::size_t quote = text.find('"'); quote != std::string_view::npos)
      return Failure{fmt::format("{}:{}:{}: quote inside a cell", path_, line_, from + quote)};
    at_ = end;
    return CsvCell{std::string(trim(text)), from};
  }

  Result<CsvCell> quoted(std::size_t from) {
    CsvCell cell{"", from};
    const std::size_t line = line_;
    for (; at_ < text_.size(); ++at_) {
      if (text_[at_] == '"') {
        if (at_ + 1 >= text_.size() || text_[at_ + 1] != '"') break;
        ++at_;
      } else if (text_[at_] == '\n') {
        line_begin_ = at_ + 1;
        ++line_;
      }
      cell.text += text_[at_];
    }
    if (at_ >= text_.size()) {
      open_quote_ = true;
      return Failure{fmt::format("{}:{}:{}: quote is never closed", path_, line, from)};
    }
    ++at_;
    const std::size_t next = text_.find_first_not_of(kBlanks, at_);
    if (next < text_.size() && text_[next] != ',' && text_[next] != '\n')
      return Failure{
          fmt::format("{}:{}:{}: text behind a quote", path_, line_, next - line_begin_ + 1)};
    at_ = std::min(next, text_.size());
    return cell;
  }

  const std::string& path_;
  std::string_view text_;
  std::size_t at_ = 0, line_begin_ = 0, line_ = 1, row_line_ = 1;
  bool ended_ = false, open_quote_ = false;
};

}  // namespace

std::optional<double> parse_number(std::string_view text) {
  double value = 0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size()) return std::nullopt;
  return value;
}

Result<CsvTable> parse_csv(const std::string& path, std::string_view text) {
  CsvTable table;
  table.path = path;
  CsvParser parser(path, text);
  if (!parser.more()) return Failure{fmt::format("{}:1: no header line", path)};
  while (parser.more()) {
    Result<std::vector<CsvCell>> row = parser.row();
    const bool header = table.header.empty();
    if (!row) {
      if (header || !parser.open_quote()) return Failure{row.error()};
      table.cut_off = row.error();
      break;
    }
    std::vector<CsvCell> cells = std::move(row).value();
    if (header) {
      table.header = std::move(cells);
      table.header_line = parser.row_line();
      continue;
    }
    if (cells.size() != table.header.size()) {
      std::string what = fmt::format("{}:{}: row of {} cells, needed {}", path, parser.row_line(),
                                     cells.size(), table.header.size());
      if (parser.ended() || cells.size() > table.header.size()) return Failure{std::move(what)};
      table.cut_off = std::move(what);
      break;
    }
    table.rows.push_back(std::move(cells));
    table.lines.push_back(parser.row_line());
  }
  return table;
}

Result<CsvTable> load_csv(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return Failure{fmt::format("{}: cannot be opened", path)};
  const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  return parse_csv(path, text);
}

std::optional<std::size_t> CsvTable::column(std::string_view name) const {
  for (std::size_t k = 0; k < header.size(); ++k) {
    if (header[k].text == name) return k;
  }
  return std::nullopt;
}

std::string CsvTable::place(std::size_t row, std::size_t column) const {
  return fmt::format("{}:{}:{}", path, lines[row], rows[row][column].at);
}

Result<void> CsvTable::require_numbers(const std::vector<std::string>& text) const {
  for (std::size_t k = 0; k < header.size(); ++k) {
    const std::string& name = header[k].text;
    if (std::find(text.begin(), text.end(), name) != text.end()) continue;
    for (std::size_t row = 0; row < rows.size(); ++row) {
      const std::string& cell = rows[row][k].text;
      if (cell.empty() || parse_number(cell)) continue;
      return Failure{
          fmt::format("{}: \"{}\" in column {} is no number", place(row, k), cell, name)};
    }
  }
  return {};
}

std::vector<double> CsvTable::numbers(std::string_view name) const {
  std::vector<double> values;
  if (!column(name)) return values;
  values.reserve(rows.size());
  for (std::size_t row = 0; row < rows.size(); ++row) values.push_back(number(row, name));
  return values;
}

double CsvTable::number(std::size_t row, std::string_view name) const {
  const std::optional<std::size_t> at = column(name);
  if (!at || row >= rows.size()) return std::numeric_limits<double>::quiet_NaN();
  return parse_number(rows[row][*at].text).value_or(std::numeric_limits<double>::quiet_NaN());
}

}  // namespace omentum

#include "core/csv.h"

#include <fmt/core.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <utility>

#include "core/read_file.h"

namespace omentum {
namespace {

constexpr std::string_view kBlanks = " \t\r";

std::string_view trim(std::string_view text) {
  const std::size_t from = text.find_first_not_of(kBlanks);
  if (from == std::string_view::npos) return {};
  return text.substr(from, text.find_last_not_of(kBlanks) - from + 1);
}

/// A place in a text, and the line it lies in (from 1).
struct Place {
  std::size_t at = 0, line = 1, line_begin = 0;
  std::size_t character() const { return at - line_begin + 1; }
};

/// Passes over the text before `to`.
void advance(std::string_view text, std::size_t to, Place& place) {
  for (; place.at < to; ++place.at) {
    if (text[place.at] != '\n') continue;
    ++place.line;
    place.line_begin = place.at + 1;
  }
}

/// Leaves `place` at the comma, the line end or the end of the text behind the cell; at the end of
/// the text where a quote is never closed.
Result<CsvCell> read_cell(const std::string& path, std::string_view text, Place& place) {
  const auto wrong = [&path](const Place& where, const char* what) {
    return Failure{fmt::format("{}:{}:{}: {}", path, where.line, where.character(), what)};
  };
  const Place begin = place;
  CsvCell cell{"", begin.character()};
  const std::size_t first = text.find_first_not_of(kBlanks, begin.at);
  if (first >= text.size() || text[first] != '"') {
    const std::size_t end = std::min(text.find_first_of(",\n", begin.at), text.size());
    place.at = std::min(text.find('"', begin.at), end);
    if (place.at < end) return wrong(place, "quote inside a cell");
    cell.text = trim(text.substr(begin.at, end - begin.at));
    return cell;
  }
  std::size_t end = first + 1;
  for (; end < text.size(); ++end) {
    const bool quote = text[end] == '"';
    if (quote && (end + 1 == text.size() || text[end + 1] != '"')) break;
    if (quote) ++end;
    cell.text += text[end];
  }
  advance(text, std::min(text.find_first_not_of(kBlanks, end + 1), text.size()), place);
  if (end == text.size()) return wrong(begin, "quote is never closed");
  if (place.at < text.size() && text[place.at] != ',' && text[place.at] != '\n')
    return wrong(place, "text behind a quote");
  return cell;
}

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
  Place place;
  while (true) {
    // Lines of blanks are passed over.
    const std::size_t first = text.find_first_not_of(" \t\r\n", place.at);
    if (first == std::string_view::npos) break;
    advance(text, first, place);
    place.at = place.line_begin;
    const std::size_t line = place.line;
    std::vector<CsvCell> cells;
    for (bool more = true; more;) {
      Result<CsvCell> cell = read_cell(path, text, place);
      if (!cell && (table.header.empty() || place.at < text.size())) return Failure{cell.error()};
      if (!cell) {
        table.cut_off = cell.error();
        return table;
      }
      cells.push_back(std::move(cell).value());
      more = place.at < text.size() && text[place.at] == ',';
      if (more) ++place.at;
    }
    const bool ended = place.at < text.size();
    if (ended) advance(text, place.at + 1, place);
    if (table.header.empty()) {
      table.header = std::move(cells);
      table.header_line = line;
      continue;
    }
    if (cells.size() != table.header.size()) {
      std::string what = fmt::format("{}:{}: row of {} cells, needed {}", path, line, cells.size(),
                                     table.header.size());
      if (ended || cells.size() > table.header.size()) return Failure{std::move(what)};
      table.cut_off = std::move(what);
      return table;
    }
    table.rows.push_back(std::move(cells));
    table.lines.push_back(line);
  }
  if (table.header.empty()) return Failure{fmt::format("{}:1: no header line", path)};
  return table;
}

Result<CsvTable> load_csv(const std::string& path) {
  const Result<std::string> text = read_file(path);
  if (!text) return Failure{text.error()};
  return parse_csv(path, text.value());
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

#include "report/csv.h"

#include <fmt/core.h>

#include <charconv>
#include <fstream>
#include <iterator>
#include <limits>

namespace omentum {

double parse_number(std::string_view text) {
  if (text == "true" || text == "yes") return 1;
  if (text == "false" || text == "no") return 0;
  double value = 0;
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (code != std::errc() || end != text.data() + text.size())
    return std::numeric_limits<double>::quiet_NaN();
  return value;
}

CsvTable parse_csv(std::string_view text) {
  CsvTable table;
  std::vector<std::string> row;
  std::string field;
  bool quoted = false;
  bool any = false;  // something on the present line
  const auto end_row = [&] {
    if (!any && field.empty() && row.empty()) return;
    row.push_back(std::move(field));
    field.clear();
    if (table.columns.empty()) {
      table.columns = std::move(row);
    } else if (row.size() == table.columns.size()) {
      table.rows.push_back(std::move(row));
    } else {
      ++table.dropped;
    }
    row.clear();
    any = false;
  };
  for (std::size_t k = 0; k < text.size(); ++k) {
    const char c = text[k];
    if (quoted) {
      if (c == '"' && k + 1 < text.size() && text[k + 1] == '"') {
        field += text[++k];
      } else if (c == '"') {
        quoted = false;
      } else {
        field += c;
      }
    } else if (c == '"') {
      quoted = any = true;
    } else if (c == ',') {
      row.push_back(std::move(field));
      field.clear();
      any = true;
    } else if (c == '\n') {
      end_row();
    } else if (c != '\r') {
      field += c;
      any = true;
    }
  }
  end_row();
  return table;
}

Result<CsvTable> load_csv(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return Failure{fmt::format("{}: cannot be opened", path)};
  const std::string text{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  return parse_csv(text);
}

std::optional<std::size_t> CsvTable::column(std::string_view name) const {
  for (std::size_t k = 0; k < columns.size(); ++k) {
    if (columns[k] == name) return k;
  }
  return std::nullopt;
}

std::vector<double> CsvTable::numbers(std::string_view name) const {
  std::vector<double> values;
  const auto index = column(name);
  if (!index) return values;
  values.reserve(rows.size());
  for (const auto& row : rows) values.push_back(parse_number(row[*index]));
  return values;
}

double CsvTable::number(std::size_t row, std::string_view name) const {
  const auto index = column(name);
  if (!index || row >= rows.size()) return std::numeric_limits<double>::quiet_NaN();
  return parse_number(rows[row][*index]);
}

}  // namespace omentum

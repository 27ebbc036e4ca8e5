#include "mismatch/table.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <fstream>
#include <numbers>
#include <sstream>
#include <string_view>

#include "core/check.h"

namespace omentum {
namespace {

struct Unit {
  std::string_view suffix, si;
  double factor;
};
// The first suffix that fits decides; SI units and the unitless parts of quaternions and strains
// come as they are.
constexpr std::array<Unit, 21> kUnits = {{{"_deg_per_s", "_rad_per_s", std::numbers::pi / 180},
                                          {"_mm_per_s", "_m_per_s", 1e-3},
                                          {"_rad_per_s", "_rad_per_s", 1},
                                          {"_m_per_s", "_m_per_s", 1},
                                          {"_mm", "_m", 1e-3},
                                          {"_deg", "_rad", std::numbers::pi / 180},
                                          {"_ms", "_s", 1e-3},
                                          {"_g", "_kg", 1e-3},
                                          {"_s", "_s", 1},
                                          {"_m", "_m", 1},
                                          {"_rad", "_rad", 1},
                                          {"_N", "_N", 1},
                                          {"_Nm", "_Nm", 1},
                                          {"_Pa", "_Pa", 1},
                                          {"_kg", "_kg", 1},
                                          {"_Hz", "_Hz", 1},
                                          {"_engineering", "_engineering", 1},
                                          {"_qw", "_qw", 1},
                                          {"_qx", "_qx", 1},
                                          {"_qy", "_qy", 1},
                                          {"_qz", "_qz", 1}}};

std::string_view trim(std::string_view text) {
  const auto from = text.find_first_not_of(" \t\r");
  if (from == std::string_view::npos) return {};
  return text.substr(from, text.find_last_not_of(" \t\r") - from + 1);
}

const Unit& unit_of(std::string_view name, const std::string& where) {
  for (const Unit& unit : kUnits) {
    if (!name.ends_with(unit.suffix)) continue;
    // Metres per second are known above; anything else per second is not a time.
    if (unit.suffix == "_s" && name.ends_with("_per_s")) break;
    return unit;
  }
  throw_error("{}: column \"{}\" ends in no known unit (_s _m _rad _N _Nm _Pa _mm _deg ...)", where,
              name);
}

/// The cells of a line, with the column (from 1) where each begins.
struct Cell {
  std::string_view text;
  std::size_t column;
};
std::vector<Cell> split(std::string_view line) {
  std::vector<Cell> cells;
  for (std::size_t from = 0; from <= line.size();) {
    const std::size_t comma = std::min(line.find(',', from), line.size());
    cells.push_back({trim(line.substr(from, comma - from)), from + 1});
    from = comma + 1;
  }
  return cells;
}

double number_of(std::string_view text) {
  double value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() ? value : std::nan("");
}

}  // namespace

const std::vector<double>* Table::find(const std::string& name) const {
  const auto at = std::find(names.begin(), names.end(), name);
  return at == names.end() ? nullptr : &columns[static_cast<std::size_t>(at - names.begin())];
}

const std::vector<double>& Table::column(const std::string& name) const {
  const std::vector<double>* found = find(name);
  if (found == nullptr) throw_error("{}:1: column {} is missing", path, name);
  return *found;
}

Table parse_table(const std::string& path, const std::string& text) {
  Table table;
  table.path = path;
  std::vector<double> factors;
  std::istringstream lines(text);
  std::string line;
  for (std::size_t number = 1; std::getline(lines, line); ++number) {
    if (trim(line).empty()) continue;
    const std::vector<Cell> cells = split(line);
    if (table.columns.empty()) {
      for (const Cell& cell : cells) {
        const std::string where = fmt::format("{}:{}:{}", path, number, cell.column);
        const Unit& unit = unit_of(cell.text, where);
        const std::string name =
            std::string(cell.text.substr(0, cell.text.size() - unit.suffix.size())) +
            std::string(unit.si);
        if (table.find(name) != nullptr) throw_error("{}: column {} appears twice", where, name);
        table.names.push_back(name);
        factors.push_back(unit.factor);
        table.columns.emplace_back();
      }
      continue;
    }
    if (cells.size() != table.columns.size()) {
      throw_error("{}:{}: row of {} cells, needed {}", path, number, cells.size(),
                  table.columns.size());
    }
    for (std::size_t k = 0; k < cells.size(); ++k) {
      const double value = number_of(cells[k].text);
      if (!std::isfinite(value)) {
        throw_error("{}:{}:{}: \"{}\" in column {} is no finite number", path, number,
                    cells[k].column, cells[k].text, table.names[k]);
      }
      table.columns[k].push_back(value * factors[k]);
    }
  }
  if (table.columns.empty()) throw_error("{}:1: no header line", path);
  return table;
}

Table read_table(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) throw_error("{}: cannot be opened", path);
  std::ostringstream text;
  text << file.rdbuf();
  return parse_table(path, text.str());
}

std::vector<double> table_times(const Table& table, double nominal_rate_hz) {
  std::vector<double> times;
  if (const std::vector<double>* t = table.find("t_s")) {
    times = *t;
  } else {
    for (std::size_t i = 0; i < table.rows(); ++i)
      times.push_back(static_cast<double>(i) / nominal_rate_hz);
  }
  for (std::size_t i = 1; i < times.size(); ++i) {
    if (!(times[i] > times[i - 1]))
      throw_error("{}:{}: t_s {} after {}, needed increasing", table.path, i + 2, times[i],
                  times[i - 1]);
  }
  return times;
}

}  // namespace omentum

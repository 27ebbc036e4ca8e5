#include "mismatch/table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <string_view>

#include "core/check.h"
#include "core/constants.h"
#include "core/csv.h"

namespace omentum {
namespace {

struct Unit {
  std::string_view suffix, si;
  double factor;
};
// The first suffix that fits decides; SI units and the unitless parts of quaternions and strains
// come as they are.
constexpr std::array<Unit, 21> kUnits = {{{"_deg_per_s", "_rad_per_s", kDegree},
                                          {"_mm_per_s", "_m_per_s", 1e-3},
                                          {"_rad_per_s", "_rad_per_s", 1},
                                          {"_m_per_s", "_m_per_s", 1},
                                          {"_mm", "_m", 1e-3},
                                          {"_deg", "_rad", kDegree},
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

Table make_table(const Result<CsvTable>& read) {
  if (!read) throw_error("{}", read.error());
  const CsvTable& csv = read.value();
  if (!csv.cut_off.empty()) throw_error("{}", csv.cut_off);
  Table table;
  table.path = csv.path;
  table.lines = csv.lines;
  table.columns.resize(csv.header.size());
  for (std::size_t k = 0; k < csv.header.size(); ++k) {
    const std::string& given = csv.header[k].text;
    const std::string where = fmt::format("{}:{}:{}", csv.path, csv.header_line, csv.header[k].at);
    const Unit& unit = unit_of(given, where);
    const std::string name =
        given.substr(0, given.size() - unit.suffix.size()) + std::string(unit.si);
    if (table.find(name) != nullptr) throw_error("{}: column {} appears twice", where, name);
    table.names.push_back(name);
    for (std::size_t row = 0; row < csv.rows.size(); ++row) {
      const std::string& text = csv.rows[row][k].text;
      const std::optional<double> value = parse_number(text);
      if (!value || !std::isfinite(*value))
        throw_error("{}: \"{}\" in column {} is no finite number", csv.place(row, k), text, name);
      table.columns[k].push_back(*value * unit.factor);
    }
  }
  return table;
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
  return make_table(parse_csv(path, text));
}

Table read_table(const std::string& path) { return make_table(load_csv(path)); }

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
      throw_error("{}:{}: t_s {} after {}, needed increasing", table.path, table.lines[i], times[i],
                  times[i - 1]);
  }
  return times;
}

}  // namespace omentum

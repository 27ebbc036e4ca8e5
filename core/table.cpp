#include "core/table.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string_view>

#include "core/check.h"
#include "core/constants.h"
#include "core/csv.h"
#include "core/regular_file.h"

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

Table make_table(const Result<CsvTable>& read) {
  if (!read) throw_error("{}", read.error());
  const CsvTable& csv = read.value();
  if (!csv.cut_off.empty()) throw_error("{}", csv.cut_off);
  Table table;
  table.path = csv.path;
  table.lines = csv.lines;
  table.columns.resize(csv.header.size());
  table.characters.resize(csv.header.size());
  for (std::size_t k = 0; k < csv.header.size(); ++k) {
    const std::string& given = csv.header[k].text;
    const std::string where = fmt::format("{}:{}:{}", csv.path, csv.header_line, csv.header[k].at);
    if (given.find_first_of(";\t") != std::string::npos)
      throw_error("{}: \"{}\" is separated by semicolons or tabs, needed commas", where,
                  shown(given));
    const Result<SiColumn> si = si_column(given);
    if (!si) throw_error("{}: {}", where, si.error());
    const auto& [name, factor] = si.value();
    if (table.find(name) != nullptr) throw_error("{}: column {} appears twice", where, shown(name));
    table.names.push_back(name);
    for (std::size_t row = 0; row < csv.rows.size(); ++row) {
      const std::string& text = csv.rows[row][k].text;
      const std::optional<double> value = parse_number(text);
      if (!value || !std::isfinite(*value))
        throw_error("{}: \"{}\" in column {} is no finite number", csv.place(row, k), shown(text),
                    shown(name));
      table.columns[k].push_back(*value * factor);
      table.characters[k].push_back(csv.rows[row][k].at);
    }
  }
  return table;
}

}  // namespace

std::string shown(std::string_view text) {
  constexpr std::size_t kLongest = 40;
  std::string line;
  for (const char c : text.substr(0, kLongest)) {
    const auto byte = static_cast<unsigned char>(c);
    line += byte < 0x20 || byte >= 0x7f ? fmt::format("\\x{:02x}", byte) : std::string(1, c);
  }
  return text.size() > kLongest ? line + "..." : line;
}

Result<SiColumn> si_column(std::string_view name) {
  for (const Unit& unit : kUnits) {
    if (!name.ends_with(unit.suffix)) continue;
    // Metres per second are known above; anything else per second is not a time.
    if (unit.suffix == "_s" && name.ends_with("_per_s")) break;
    name.remove_suffix(unit.suffix.size());
    return SiColumn{std::string(name) + std::string(unit.si), unit.factor};
  }
  return Failure{fmt::format(
      "column \"{}\" ends in no known unit (_s _m _rad _N _Nm _Pa _mm _deg ...)", shown(name))};
}

const std::vector<double>* Table::find(const std::string& name) const {
  const auto at = std::find(names.begin(), names.end(), name);
  return at == names.end() ? nullptr : &columns[static_cast<std::size_t>(at - names.begin())];
}

const std::vector<double>& Table::column(const std::string& name) const {
  const std::vector<double>* found = find(name);
  if (found == nullptr) throw_error("{}:1: column {} is missing", path, name);
  return *found;
}

std::string Table::place(std::size_t row, const std::string& name) const {
  const auto k = std::find(names.begin(), names.end(), name) - names.begin();
  return fmt::format("{}:{}:{}", path, lines[row], characters[static_cast<std::size_t>(k)][row]);
}

Table parse_table(const std::string& path, std::string_view text) {
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);  // byte order mark
  if (text.find('\0') != std::string_view::npos)
    throw_error("{}: bytes of zero, needed plain text (UTF-8)", path);
  Table table = make_table(parse_csv(path, text));
  table.open_end = !text.empty() && text.back() != '\n';
  return table;
}

Table read_table(const std::string& path) {
  constexpr std::uintmax_t kLargest = 1'000'000'000;  // [byte] days of commands
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::error_code failed;
  const std::uintmax_t size = std::filesystem::file_size(path, failed);
  if (failed) throw_error("{}: cannot be opened: {}", path, failed.message());
  if (size > kLargest) throw_error("{}: {} bytes, allowed up to {}", path, size, kLargest);
  std::string text(size, '\0');
  if (!std::ifstream(path, std::ios::binary).read(text.data(), static_cast<std::streamsize>(size)))
    throw_error("{}: cannot be read", path);
  return parse_table(path, text);
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
      throw_error("{}: t_s {} after {}, needed increasing", table.place(i, "t_s"), times[i],
                  times[i - 1]);
  }
  return times;
}

}  // namespace omentum

#include "mismatch/import/source.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/check.h"
#include "core/constants.h"
#include "core/csv.h"
#include "core/table.h"
#include "mismatch/import/rigid.h"
#include "mismatch/import/units.h"
#include "mismatch/recording/plain_folder.h"
#include "mismatch/recording/table_columns.h"

namespace omentum {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

template <typename T>
T required(Result<T> result, const std::string& where) {
  if (!result) throw_error("{}: {}", where, result.error());
  return std::move(result).value();
}

double number_of(const std::string& text, const Values& values, const std::string& where) {
  return required(parse_numbers(required(fill_in(text, values), where), 1), where).front();
}

/// Lines of a text without their ends.
std::vector<std::string> lines_of(const std::string& text) {
  std::vector<std::string> lines;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    lines.push_back(text.substr(at, end - at));
    at = end + 1;
  }
  return lines;
}

std::string_view trimmed(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(" \t\r"), text.size()));
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t' || text.back() == '\r'))
    text.remove_suffix(1);
  return text;
}

/// The n-th number of a text.
std::optional<double> number_in(std::string_view text, std::uint32_t n) {
  constexpr std::string_view kOfNumber = "+-.0123456789eE";
  while (true) {
    text.remove_prefix(std::min(text.find_first_of("+-.0123456789"), text.size()));
    if (text.empty()) return std::nullopt;
    std::string_view word = text.substr(0, text.find_first_not_of(kOfNumber));
    text.remove_prefix(word.size());
    // "10.5." at the end of a sentence, "3e": the longest part that is a number.
    std::optional<double> value;
    for (; !word.empty() && !value; word.remove_suffix(1))
      value = parse_number(word.front() == '+' ? word.substr(1) : word);
    if (value && --n == 0) return value;
  }
}

std::string value_in(const pb::ValueMap& map, std::string_view line, const std::string& delimiter,
                     const std::string& where) {
  std::string_view rest = line.substr(line.find(map.behind()) + map.behind().size());
  if (map.has_until()) rest = rest.substr(0, rest.find(map.until()));
  if (map.number() == 0) {
    if (!map.has_until()) rest = rest.substr(0, rest.find(delimiter));
    return std::string(trimmed(rest));
  }
  const auto value = number_in(rest, map.number());
  if (!value) throw_error("{}: \"{}\": no number {} behind it", where, map.behind(), map.number());
  double factor = 1;
  if (map.has_unit()) factor = required(find_unit(map.unit()), where).factor;
  return fmt::format("{}", *value * factor);
}

}  // namespace

std::string_view table_of_column(std::string_view column) {
  // Markers come last: theirs are any names.
  for (const std::string_view file :
       {"tool.csv", "joints.csv", "tracker.csv", "force.csv", "coupon.csv", "markers.csv"}) {
    if (place_of_column(file, column)) return file;
  }
  return "";
}

TextTable read_source_table(const pb::SourceMap& source, const std::string& path) {
  TextFormat format;
  format.delimiter = source.delimiter();
  if (format.delimiter.size() != 1)
    throw_error("source.delimiter: \"{}\", needed one character", shown(source.delimiter()));
  format.decimal_comma = source.decimal_comma();
  if (format.decimal_comma && format.delimiter == ",")
    throw_error("source.delimiter: \",\" with decimal_comma");
  format.comment = source.comment();
  format.skip_lines = source.skip_lines();
  format.header_starts = source.header_starts();
  format.header = source.header();
  format.unit_rows = source.unit_rows();
  format.unknown.assign(source.unknown().begin(), source.unknown().end());
  if (source.has_ends_before()) format.ends_before = source.ends_before();
  return TextTable::read(path, format);
}

void add_values(const pb::SourceMap& source, const std::string& folder, const TextTable* table,
                Values& values) {
  for (const pb::ValueMap& map : source.value()) {
    const std::string where = fmt::format("source.value {}", map.name());
    if (map.name().empty() || map.behind().empty())
      throw_error("{}: needed name and behind", where);
    std::vector<std::string> lines;
    std::string path = table != nullptr ? table->path() : "";
    if (map.has_file()) {
      path = folder + "/" + required(fill_in(map.file(), values), where);
      lines = lines_of(read_whole_file(path));
    } else if (table != nullptr) {
      lines = table->head();
    }
    const auto line = std::find_if(lines.begin(), lines.end(), [&](const std::string& text) {
      return text.find(map.behind()) != std::string::npos;
    });
    if (line == lines.end())
      throw_error("{}: {}: \"{}\" stands in no line{}", path, where, map.behind(),
                  map.has_file() ? "" : " before the rows");
    values[map.name()] = value_in(map, *line, source.delimiter(), path + ": " + where);
  }
}

std::vector<RowBlock> split_rows(const pb::SourceMap& source, const TextTable& table) {
  std::vector<std::size_t> rows;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    bool stays = true;
    for (const pb::RowFilter& filter : source.filter()) {
      const std::size_t column = table.column(filter.column());
      const std::string_view cell = table.cell(row, column);
      bool fits =
          filter.equals().empty() ||
          std::find(filter.equals().begin(), filter.equals().end(), cell) != filter.equals().end();
      if (filter.has_min() || filter.has_max()) {
        const double value = table.number(row, column);
        fits = fits && !(filter.has_min() && !(value >= filter.min())) &&
               !(filter.has_max() && !(value <= filter.max()));
      }
      stays = stays && fits != filter.drop();
    }
    if (stays) rows.push_back(row);
  }
  const pb::SplitMap& split = source.split();
  std::vector<RowBlock> blocks;
  if (!split.column().empty()) {
    std::map<std::vector<std::string>, std::size_t> known;
    for (const std::size_t row : rows) {
      std::vector<std::string> key;
      for (const std::string& name : split.column())
        key.emplace_back(table.cell(row, table.column(name)));
      const auto [found, fresh] = known.try_emplace(key, blocks.size());
      if (fresh) {
        blocks.emplace_back();
        for (int k = 0; k < split.column_size(); ++k)
          blocks.back().values[split.column(k)] = key[static_cast<std::size_t>(k)];
      }
      blocks[found->second].rows.push_back(row);
    }
  } else if (split.rows() > 0 || split.has_begins_with()) {
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const bool begins =
          split.rows() > 0 ? k % split.rows() == 0 : table.cell(rows[k], 0) == split.begins_with();
      if (begins) blocks.emplace_back();
      if (blocks.empty())
        throw_error("{}: before the first row that begins with \"{}\"", table.place(rows[k], 0),
                    shown(split.begins_with()));
      blocks.back().rows.push_back(rows[k]);
    }
  } else {
    blocks.push_back({{}, rows});
  }
  for (std::size_t k = 0; k < blocks.size(); ++k) {
    RowBlock& block = blocks[k];
    block.values["block"] = fmt::format("{}", k);
    for (const pb::SplitMap::Parameter& parameter : split.parameter()) {
      if (parameter.row() >= block.rows.size())
        throw_error("{}: block {} has no row {}", table.path(), k, parameter.row());
      const std::size_t row = block.rows[parameter.row()],
                        column = table.column(parameter.column());
      std::string& value = block.values[parameter.name()];
      value = table.cell(row, column);
      if (!parameter.has_unit()) continue;
      const double factor = required(find_unit(parameter.unit()), "source.split.parameter").factor;
      value = fmt::format("{}", table.number(row, column) * factor);
    }
    const std::size_t taken = std::min<std::size_t>(split.parameter_rows(), block.rows.size());
    block.rows.erase(block.rows.begin(), block.rows.begin() + static_cast<long>(taken));
  }
  return blocks;
}

namespace {

/// Times of rows that are numbered: one number is a period of the rate, and what is missing between
/// two rows leaves its time.
std::vector<std::int64_t> frame_times(const pb::TimeMap& map, const TextTable* table,
                                      const std::vector<std::size_t>& rows, std::int64_t offset) {
  if (table == nullptr) throw_error("source.time.column: \"{}\" of no table", map.column());
  if (!(map.rate_hz() > 1e-6 && map.rate_hz() < 1e9))
    throw_error("source.time.rate_hz: {} Hz, allowed 1e-06 ... 1e+09", map.rate_hz());
  const std::size_t column = table->column(map.column());
  std::vector<std::int64_t> times;
  double first = 0, last = 0;
  for (const std::size_t row : rows) {
    const double number = table->number(row, column);
    if (number != std::round(number) || std::fabs(number) > 9e15)
      throw_error(
          "{}: \"{}\" is no number of a frame, of which rate_hz makes times: needed whole ones, or "
          "column without rate_hz where it is a time",
          table->place(row, column), shown(table->cell(row, column)));
    if (times.empty()) first = number;
    if (!times.empty() && number <= last)
      throw_error("{}: frame {} after {}, needed increasing", table->place(row, column), number,
                  last);
    last = number;
    const double since = (number - first) / map.rate_hz();
    if (!(since < 9e9)) throw_error("{}: frame {} is no time", table->place(row, column), number);
    times.push_back(std::llround(since * 1e9) + offset);
  }
  return times;
}

}  // namespace

std::vector<std::int64_t> row_times(
    const pb::SourceMap& source, const TextTable* table, const std::vector<std::size_t>& rows,
    const Values& values, const std::map<std::string, std::vector<std::int64_t>>& earlier) {
  const pb::TimeMap& map = source.time();
  const auto offset = static_cast<std::int64_t>(std::llround(map.offset_s() * 1e9));
  const UnitFactor unit = required(find_unit(map.unit()), "source.time.unit");
  if (unit.si != "s") throw_error("source.time.unit: \"{}\", needed a time", map.unit());
  std::vector<std::int64_t> times;
  if (map.has_of_source()) {
    const auto found = earlier.find(map.of_source());
    if (found == earlier.end())
      throw_error("source.time.of_source: no earlier source \"{}\"", shown(map.of_source()));
    if (found->second.size() != rows.size())
      throw_error("source.time.of_source: {} rows, source {} has {}", rows.size(), map.of_source(),
                  found->second.size());
    return found->second;
  }
  if (map.has_column() && map.at_rest())
    throw_error("source.time: column \"{}\" with at_rest, needed one of them", map.column());
  if (map.has_rate_hz() && map.has_column()) return frame_times(map, table, rows, offset);
  if (map.has_rate_hz() || map.at_rest()) {
    if (map.has_rate_hz() && !(map.rate_hz() > 1e-6 && map.rate_hz() < 1e9))
      throw_error("source.time.rate_hz: {} Hz, allowed 1e-06 ... 1e+09", map.rate_hz());
    const double rate = map.at_rest() ? 1 : map.rate_hz();
    for (std::size_t k = 0; k < rows.size(); ++k)
      times.push_back(std::llround(static_cast<double>(k) / rate * 1e9) + offset);
    return times;
  }
  if (map.has_value()) {
    const double t = number_of(map.value(), values, "source.time.value") * unit.factor;
    if (!(std::fabs(t) < 9e9)) throw_error("source.time.value: {} s", t);
    return {std::llround(t * 1e9) + offset};
  }
  if (table == nullptr)
    throw_error("source.time: needed rate_hz, at_rest, of_source or value for {}", source.files());
  std::string name = map.column();
  double factor = unit.factor;
  if (name.empty()) {
    name = table->find("t_ms") ? "t_ms" : "t_s";
    factor = name == "t_ms" ? 1e-3 : 1;
  }
  const std::size_t column = table->column(name);
  for (const std::size_t row : rows) {
    times.push_back(table->time_ns(row, column, factor) + offset);
  }
  return times;
}

namespace {

/// Appends a column to the series it belongs to.
void add_column(const std::string& name, const std::vector<std::int64_t>& times,
                const std::vector<double>& values, std::map<std::string, Series>& found,
                std::map<std::string, std::vector<std::vector<double>>>& columns) {
  const std::string topic = place_of_column(table_of_column(name), name)->topic;
  Series& series = found[topic];
  series.time_ns = times;
  series.columns.push_back(name);
  columns[topic].push_back(values);
}

}  // namespace

void add_columns(const pb::SourceMap& source, const TextTable& table,
                 const std::vector<std::size_t>& rows, const std::vector<std::int64_t>& times,
                 const Values& values, std::map<std::string, Series>& found) {
  std::map<std::string, std::vector<std::vector<double>>> columns;
  for (const pb::ColumnMap& map : source.column()) {
    const std::string where = fmt::format("source.column {}", shown(map.to()));
    if (table_of_column(map.to()).empty() || unit_of_column(map.to()) == "s")
      throw_error("{}: no column of a recording (docs/formats.md 3)", where);
    double unit = map.has_unit() ? required(factor_to_column(map.unit(), map.to()), where) : 1;
    if (map.has_counts_per_turn()) {
      if (map.has_unit() || unit_of_column(map.to()) != "rad" || map.counts_per_turn() == 0)
        throw_error("{}: counts_per_turn {} gives rad, without unit", where, map.counts_per_turn());
      unit = 2 * kPi / map.counts_per_turn();
    }
    double factor = map.factor(), offset = map.offset();
    if (map.has_factor_value()) factor *= number_of(map.factor_value(), values, where);
    if (map.has_offset_value()) offset += number_of(map.offset_value(), values, where);
    const std::size_t column = table.column(map.from());
    std::vector<double> numbers;
    for (const std::size_t row : rows) {
      const double raw = table.number(row, column);
      // What is only renamed stays the same to the last bit.
      numbers.push_back((factor == 1 && offset == 0 ? raw : raw * factor + offset) * unit);
    }
    add_column(map.to(), times, numbers, found, columns);
  }
  for (std::size_t column = 0; source.named() && column < table.names().size(); ++column) {
    const Result<SiColumn> si = si_column(table.names()[column]);
    if (!si || si.value().name == "t_s" || table_of_column(si.value().name).empty()) continue;
    std::vector<double> numbers;
    for (const std::size_t row : rows)
      numbers.push_back(table.number(row, column) * si.value().factor);
    add_column(si.value().name, times, numbers, found, columns);
  }
  for (const pb::RotationMap& map : source.rotation()) {
    const std::string where = fmt::format("source.rotation {}", shown(map.to()));
    if (table_of_column(map.to() + "_qw").empty())
      throw_error("{}: allowed tip_measured, tip_commanded, tip_setpoint, tip_optical", where);
    if (static_cast<std::size_t>(map.from_size()) != numbers_of(map.form()))
      throw_error("{}: {} columns, {} has {}", where, map.from_size(),
                  pb::RotationForm_Name(map.form()), numbers_of(map.form()));
    std::array<std::vector<double>, 4> wxyz;
    for (const std::size_t row : rows) {
      std::vector<double> numbers;
      for (const std::string& from : map.from())
        numbers.push_back(table.number(row, table.column(from)));
      const bool known = std::none_of(numbers.begin(), numbers.end(),
                                      [](double value) { return std::isnan(value); });
      Eigen::Quaterniond q(kUnknown, kUnknown, kUnknown, kUnknown);
      if (known) {
        q = required(make_rotation(numbers, map.form(), map.axes(), map.degrees()),
                     table.place(row, table.column(map.from(0))));
      }
      wxyz[0].push_back(q.w());
      wxyz[1].push_back(q.x());
      wxyz[2].push_back(q.y());
      wxyz[3].push_back(q.z());
    }
    for (std::size_t k = 0; k < 4; ++k)
      add_column(map.to() + "_q" + std::string("wxyz").substr(k, 1), times, wxyz[k], found,
                 columns);
  }
  for (auto& [topic, series] : found) {
    for (std::size_t row = 0; row < rows.size(); ++row) {
      for (const std::vector<double>& column : columns[topic]) series.values.push_back(column[row]);
    }
  }
}

void add_series(const std::string& path, const Eigen::Isometry3d& X_WF,
                std::map<std::string, Series> found, Recording& recording) {
  for (auto& [topic, series] : found) {
    const std::string_view file = table_of_column(series.columns.front());
    if (const Result<void> whole = normalise(file, series); !whole)
      throw_error("{}: {}", path, whole.error());
    transform_series(X_WF, series);
    if (series.rows() == 0) continue;
    if (const std::string told = told_never_known(series); !told.empty())
      recording.warnings.push_back(fmt::format("{}: {}", path, told));
    if (!recording.series.emplace(topic, std::move(series)).second)
      throw_error("{}: channel {} comes from another source already", path, topic);
  }
}

}  // namespace omentum

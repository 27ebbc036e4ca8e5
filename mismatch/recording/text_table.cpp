#include "mismatch/recording/text_table.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>

#include "core/check.h"
#include "core/csv.h"
#include "core/regular_file.h"
#include "core/table.h"
#include "mismatch/recording/recording.h"

namespace omentum {
namespace {

constexpr std::string_view kBlanks = " \t\r";

std::string_view trim(std::string_view text) {
  const std::size_t from = std::min(text.find_first_not_of(kBlanks), text.size());
  text.remove_prefix(from);
  while (!text.empty() && kBlanks.find(text.back()) != std::string_view::npos)
    text.remove_suffix(1);
  return text;
}

}  // namespace

std::string read_whole_file(const std::string& path) {
  constexpr std::uintmax_t kLargest = 1'000'000'000;  // [byte]
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::error_code failed;
  const std::uintmax_t size = std::filesystem::file_size(path, failed);
  if (failed) throw_error("{}: cannot be opened: {}", path, failed.message());
  if (size > kLargest) throw_error("{}: {} bytes, allowed up to {}", path, size, kLargest);
  std::string text(size, '\0');
  if (!std::ifstream(path, std::ios::binary).read(text.data(), static_cast<std::streamsize>(size)))
    throw_error("{}: cannot be read", path);
  return text;
}

TextTable TextTable::read(const std::string& path, const TextFormat& format) {
  return TextTable(path, read_whole_file(path), format);
}

TextTable::TextTable(std::string path, std::string text, const TextFormat& format)
    : path_(std::move(path)), text_(std::move(text)), format_(format) {
  OMENTUM_CHECK(format_.delimiter.size() == 1, "delimiter \"{}\"", format_.delimiter);
  const std::string_view all = text_;
  if (all.size() > std::numeric_limits<std::uint32_t>::max() / 2)
    throw_error("{}: {} bytes, too many", path_, all.size());
  if (all.find('\0') != std::string_view::npos)
    throw_error("{}: bytes of zero, needed plain text (UTF-8)", path_);
  std::size_t begin = all.starts_with("\xef\xbb\xbf") ? 3 : 0, number = 0, units = 0;
  bool headed = !format_.header, after_gap = false;
  for (; begin < all.size();) {
    const std::size_t end = std::min(all.find('\n', begin), all.size());
    const std::string_view line = all.substr(begin, end - begin);
    const std::size_t at = begin;
    ++number;
    begin = end + 1;
    const bool comment = !format_.comment.empty() && line.starts_with(format_.comment);
    if (headed && number > format_.skip_lines && ends_at(line)) break;
    if (trim(line).empty()) {
      after_gap = true;
      continue;
    }
    const bool before =
        !headed && !format_.header_starts.empty() && !line.starts_with(format_.header_starts);
    if (comment || number <= format_.skip_lines || before) {
      head_.emplace_back(trim(line));
      continue;
    }
    if (!headed) {
      headed = true;
      header_line_ = number;
      head_.emplace_back(trim(line));
      split(at, end, number, header_cells_);
      while (header_cells_.size() > 1 && header_cells_.back().first == header_cells_.back().second)
        header_cells_.pop_back();
      for (const auto& [from, to] : header_cells_) names_.emplace_back(all.substr(from, to - from));
      after_gap = false;
      continue;
    }
    if (units < format_.unit_rows) {
      ++units;
      head_.emplace_back(trim(line));
      continue;
    }
    add_row(at, end, number, after_gap);
    after_gap = false;
  }
  if (ended_by_delimiter_ > 0)
    warnings_.push_back(
        fmt::format("{}: {} rows have empty cells behind the last of {} columns: passed over",
                    path_, ended_by_delimiter_, names_.size()));
  if (names_.empty()) {
    throw_error("{}:1: no header line{}", path_,
                format_.header_starts.empty()
                    ? ""
                    : fmt::format(" that begins with \"{}\"", shown(format_.header_starts)));
  }
}

bool TextTable::ends_at(std::string_view line) const {
  if (!format_.ends_before || names_.empty()) return false;
  if (!format_.ends_before->empty()) return line.starts_with(*format_.ends_before);
  return line.find_first_not_of(std::string(kBlanks) + format_.delimiter) == std::string_view::npos;
}

void TextTable::add_row(std::size_t begin, std::size_t end, std::size_t number, bool after_gap) {
  const std::size_t had = cells_.size();
  split(begin, end, number, cells_);
  if (names_.empty()) {
    for (std::size_t k = had; k < cells_.size(); ++k)
      names_.push_back(fmt::format("{}", k - had + 1));
  }
  const std::size_t width = cells_.size() - had, needed = names_.size();
  while (cells_.size() - had > needed && cells_.back().first == cells_.back().second)
    cells_.pop_back();
  if (cells_.size() - had != needed) {
    const bool later = !lines_.empty() && after_gap;
    throw_error(
        "{}:{}: row of {} cells, needed {}{}", path_, number, width, needed,
        later ? ": another table? source.ends_before of a map says where this one ends" : "");
  }
  if (width > needed) ++ended_by_delimiter_;
  lines_.push_back(static_cast<std::uint32_t>(number));
  line_begins_.push_back(static_cast<std::uint32_t>(begin));
}

void TextTable::split(std::size_t begin, std::size_t end, std::size_t number,
                      std::vector<Span>& cells) const {
  const std::string_view line = std::string_view(text_).substr(begin, end - begin);
  const auto add = [&](std::string_view cell) {
    cell = trim(cell);
    if (cell.size() >= 2 && cell.front() == '"' && cell.back() == '"')
      cell = cell.substr(1, cell.size() - 2);
    const auto from = static_cast<std::uint32_t>(cell.data() - text_.data());
    cells.emplace_back(from, from + static_cast<std::uint32_t>(cell.size()));
  };
  const bool blanks = format_.delimiter == " ";
  const std::string_view delimiters = blanks ? kBlanks : std::string_view(format_.delimiter);
  // Blanks before a quote; a tab that delimits is none.
  const std::string_view around = format_.delimiter == "\t" ? std::string_view(" \r") : kBlanks;
  for (std::size_t at = 0; at <= line.size();) {
    if (blanks) at = std::min(line.find_first_not_of(kBlanks, at), line.size());
    if (blanks && at == line.size()) break;
    std::size_t stop = at;
    const std::size_t first = std::min(line.find_first_not_of(around, at), line.size());
    if (first < line.size() && line[first] == '"') {  // delimiters within quotes are text
      stop = line.find('"', first + 1);
      while (stop != std::string_view::npos && line.substr(stop + 1).starts_with('"'))
        stop = line.find('"', stop + 2);  // two of them are one in the text
      if (stop == std::string_view::npos)
        throw_error("{}:{}:{}: a quote without its other one in this line", path_, number,
                    first + 1);
    }
    stop = std::min(line.find_first_of(delimiters, stop), line.size());
    add(line.substr(at, stop - at));
    at = stop + 1;
  }
}

std::optional<std::size_t> TextTable::find(std::string_view name) const {
  const auto found = std::find(names_.begin(), names_.end(), name);
  if (found == names_.end()) return std::nullopt;
  return static_cast<std::size_t>(found - names_.begin());
}

std::size_t TextTable::column(const std::string& name) const {
  auto found = find(name);
  if (found && std::count(names_.begin(), names_.end(), name) > 1) {
    std::vector<std::size_t> places;
    for (std::size_t k = 0; k < names_.size(); ++k) {
      if (names_[k] == name) places.push_back(k + 1);
    }
    throw_error("{}:{}: {} columns are called {}, those at {}: needed \"#{}\" for the first, ...",
                path_, header_line_, places.size(), shown(name), fmt::join(places, ", "),
                places.front());
  }
  if (const auto number =
          name.starts_with('#') ? parse_number(std::string_view(name).substr(1)) : std::nullopt;
      !found && number && *number >= 1 && *number <= static_cast<double>(names_.size()))
    found = static_cast<std::size_t>(*number) - 1;
  if (!found) {
    const std::size_t few = std::min<std::size_t>(names_.size(), 12);
    const std::vector<std::string> some(names_.begin(), names_.begin() + static_cast<long>(few));
    throw_error("{}:{}: column {} is missing; there are {}{}", path_, header_line_, shown(name),
                shown(fmt::format("{}", fmt::join(some, " "))), names_.size() > few ? " ..." : "");
  }
  return *found;
}

std::string_view TextTable::cell(std::size_t row, std::size_t column) const {
  const auto [from, to] = cells_[row * names_.size() + column];
  return std::string_view(text_).substr(from, to - from);
}

std::string TextTable::place(std::size_t row, std::size_t column) const {
  return fmt::format("{}:{}:{}", path_, lines_[row],
                     cells_[row * names_.size() + column].first - line_begins_[row] + 1);
}

std::string TextTable::header_place(std::size_t column) const {
  if (header_cells_.empty()) return fmt::format("{}:1", path_);
  return fmt::format("{}:{}:{}", path_, header_line_,
                     header_cells_[column].first - header_cells_.front().first + 1);
}

std::optional<double> TextTable::parse(std::string_view cell) const {
  if (cell.starts_with('+')) cell.remove_prefix(1);
  if (!format_.decimal_comma) return parse_number(cell);
  std::string text(cell);
  std::replace(text.begin(), text.end(), ',', '.');
  return parse_number(text);
}

double TextTable::number(std::size_t row, std::size_t column) const {
  const std::string_view text = cell(row, column);
  const auto& unknown = format_.unknown;
  if (text.empty() || std::find(unknown.begin(), unknown.end(), text) != unknown.end())
    return std::numeric_limits<double>::quiet_NaN();
  const std::optional<double> value = parse(text);
  if (value && std::isfinite(*value)) return *value;
  throw_error("{}: \"{}\" in column {} is no finite number", place(row, column), shown(text),
              shown(names_[column]));
}

void keep_increasing(const TextTable& table, std::size_t column, std::vector<std::size_t>& rows,
                     std::vector<std::int64_t>& times, std::vector<std::string>& warnings) {
  constexpr std::int64_t kSmall = 1000;  // [ns]
  constexpr std::size_t kFew = 100;      // one of so many
  std::vector<std::size_t> kept_rows;
  std::vector<std::int64_t> kept;
  std::size_t first = 0, count = 0;
  const auto place = [&](std::size_t k) { return table.place(rows[k], column); };
  for (std::size_t k = 0; k < rows.size(); ++k) {
    const bool back = !kept.empty() && times[k] <= kept.back();
    if (back) {
      if (count++ == 0) first = k;
      if (kept.back() - times[k] > kSmall || count > rows.size() / kFew)
        throw_error("{}: {} s after {} s, needed increasing", place(k), print_seconds(times[k]),
                    print_seconds(kept.back()));
      continue;
    }
    kept_rows.push_back(rows[k]);
    kept.push_back(times[k]);
  }
  if (count == 0) return;
  warnings.push_back(
      fmt::format("{}: {} of {} rows no later than the row before, by up to 1 us: "
                  "left out",
                  place(first), count, rows.size()));
  rows = std::move(kept_rows);
  times = std::move(kept);
}

std::int64_t TextTable::time_ns(std::size_t row, std::size_t column, double factor) const {
  std::int64_t time = 0;
  if (factor == 1 && !format_.decimal_comma && parse_seconds(cell(row, column), time)) return time;
  const double value = number(row, column) * factor * 1e9;
  if (!(std::fabs(value) < 9.2e18))
    throw_error("{}: \"{}\" in column {} is no time", place(row, column), shown(cell(row, column)),
                shown(names_[column]));
  return std::llround(value);
}

}  // namespace omentum

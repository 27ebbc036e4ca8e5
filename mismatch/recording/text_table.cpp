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
  bool headed = !format_.header;
  for (; begin < all.size();) {
    const std::size_t end = std::min(all.find('\n', begin), all.size());
    const std::string_view line = all.substr(begin, end - begin);
    const std::size_t at = begin;
    ++number;
    begin = end + 1;
    const bool comment = !format_.comment.empty() && line.starts_with(format_.comment);
    if (trim(line).empty()) continue;
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
      split(at, end, header_cells_);
      for (const auto& [from, to] : header_cells_) names_.emplace_back(all.substr(from, to - from));
      continue;
    }
    if (units < format_.unit_rows) {
      ++units;
      head_.emplace_back(trim(line));
      continue;
    }
    const std::size_t had = cells_.size();
    split(at, end, cells_);
    const std::size_t width = cells_.size() - had;
    if (names_.empty()) {
      for (std::size_t k = 1; k <= width; ++k) names_.push_back(fmt::format("{}", k));
    }
    if (width != names_.size())
      throw_error("{}:{}: row of {} cells, needed {}", path_, number, width, names_.size());
    lines_.push_back(static_cast<std::uint32_t>(number));
    line_begins_.push_back(static_cast<std::uint32_t>(at));
  }
  if (names_.empty()) {
    throw_error("{}:1: no header line{}", path_,
                format_.header_starts.empty()
                    ? ""
                    : fmt::format(" that begins with \"{}\"", shown(format_.header_starts)));
  }
}

void TextTable::split(std::size_t begin, std::size_t end, std::vector<Span>& cells) const {
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
  for (std::size_t at = 0; at <= line.size();) {
    if (blanks) at = std::min(line.find_first_not_of(kBlanks, at), line.size());
    if (blanks && at == line.size()) break;
    std::size_t stop = at;
    const std::size_t first = std::min(line.find_first_not_of(kBlanks, at), line.size());
    if (first < line.size() && line[first] == '"')  // delimiters within quotes are text
      stop = std::min(line.find('"', first + 1), line.size());
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
  const auto found = find(name);
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

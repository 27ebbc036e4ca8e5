#include "mismatch/recording/recording.h"

#include <fmt/format.h>
#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstring>

namespace omentum {
namespace {

bool same_number(double a, double b) { return a == b || (std::isnan(a) && std::isnan(b)); }

template <typename T>
std::string difference_of(const char* what, const Frames<T>& a, const Frames<T>& b) {
  if (a.time_ns != b.time_ns || a.number != b.number)
    return fmt::format("{}: {} and {} frames, or their times differ", what, a.size(), b.size());
  for (std::size_t k = 0; k < a.size(); ++k) {
    if (a.fetch(k) != b.fetch(k)) return fmt::format("{}: frame {} differs", what, k);
  }
  return "";
}

}  // namespace

std::size_t Series::find(std::string_view name) const {
  return static_cast<std::size_t>(std::find(columns.begin(), columns.end(), name) -
                                  columns.begin());
}

bool operator==(const Series& a, const Series& b) {
  return a.columns == b.columns && a.time_ns == b.time_ns &&
         std::equal(a.values.begin(), a.values.end(), b.values.begin(), b.values.end(),
                    same_number);
}

const Series* Recording::find(const std::string& topic) const {
  const auto found = series.find(topic);
  return found == series.end() ? nullptr : &found->second;
}

std::string difference(const Recording& a, const Recording& b) {
  google::protobuf::util::MessageDifferencer differ;
  std::string report;
  differ.ReportDifferencesToString(&report);
  if (!differ.Compare(a.info, b.info)) {
    std::replace(report.begin(), report.end(), '\n', ';');
    return "info: " + report;
  }
  for (const auto& [topic, one] : a.series) {
    const Series* other = b.find(topic);
    if (other == nullptr) return topic + ": only in the first";
    if (one.columns != other->columns) return topic + ": other columns";
    if (one.time_ns != other->time_ns) return topic + ": other times";
    if (!(one == *other)) return topic + ": other values";
  }
  for (const auto& [topic, one] : b.series) {
    if (a.find(topic) == nullptr) return topic + ": only in the second";
  }
  std::string found = difference_of("clouds", a.clouds, b.clouds);
  if (found.empty()) found = difference_of("depth", a.depth, b.depth);
  if (found.empty()) found = difference_of("color", a.color, b.color);
  return found;
}

std::string print_seconds(std::int64_t time_ns) {
  constexpr std::uint64_t kSecond = 1'000'000'000;
  const bool negative = time_ns < 0;
  // Of the least number there is the absolute value fits into 64 bits without sign only.
  const std::uint64_t size =
      negative ? ~static_cast<std::uint64_t>(time_ns) + 1 : static_cast<std::uint64_t>(time_ns);
  std::string text = fmt::format("{}{}", negative ? "-" : "", size / kSecond);
  if (size % kSecond == 0) return text;
  text += fmt::format(".{:09}", size % kSecond);
  return text.substr(0, text.find_last_not_of('0') + 1);
}

bool parse_seconds(std::string_view text, std::int64_t& time_ns) {
  // 64 bits of mantissa: a nanosecond in 292 years.
  long double seconds = 0;
  if (text.starts_with('+')) text.remove_prefix(1);
  const auto [end, code] = std::from_chars(text.data(), text.data() + text.size(), seconds);
  if (code != std::errc() || end != text.data() + text.size()) return false;
  const long double scaled = seconds * 1e9L;
  if (!(std::fabs(scaled) < 9.2e18L)) return false;
  time_ns = static_cast<std::int64_t>(std::llround(scaled));
  return true;
}

}  // namespace omentum

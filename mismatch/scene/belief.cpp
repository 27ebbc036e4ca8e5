#include "mismatch/scene/belief.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "core/constants.h"
#include "core/csv.h"
#include "core/table.h"

namespace omentum {

using Eigen::Vector3d;

namespace {

constexpr std::string_view kBlanks = " \t\r";

std::string_view trim(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(kBlanks), text.size()));
  while (!text.empty() && kBlanks.find(text.back()) != std::string_view::npos)
    text.remove_suffix(1);
  return text;
}

/// A key that is a number or a vector, and what it may be.
struct NumberKey {
  const char* name;
  int count;  ///< of numbers
  double min, max;
  bool single = false;  ///< one number may stand for all of them
};
constexpr double kAny = 1e9;
// Those of AddedMass in proto/tissue_effects.proto.
constexpr double kHeaviest = 1;  // [kg]
constexpr double kFarthest = 1;  // [m]
constexpr std::array kNumberKeys = {
    NumberKey{"sheet_size_x_m", 1, 0.002, 1},
    NumberKey{"sheet_size_y_m", 1, 0.002, 1},
    NumberKey{"sheet_thickness_m", 1, 1e-4, 0.5},
    NumberKey{"young_modulus_nominal_Pa", 1, 100, 1e8},
    NumberKey{"young_modulus_uncertainty_factor", 1, 1, 1000},
    NumberKey{"poisson_ratio_nominal", 1, 0, 0.5},
    NumberKey{"density_nominal_kg_per_m3", 1, 100, 5000},
    NumberKey{"sheet_origin_x_m", 1, -10, 10},
    NumberKey{"sheet_origin_y_m", 1, -10, 10},
    NumberKey{"sheet_origin_z_m", 1, -10, 10},
    NumberKey{"sheet_axis_x_in_W", 3, -kAny, kAny},
    NumberKey{"sheet_axis_y_in_W", 3, -kAny, kAny},
    NumberKey{"clamp_strip_width_m", 1, 0, 0.5},
    NumberKey{"board_plane_normal", 3, -kAny, kAny},
    NumberKey{"board_plane_z_m", 1, -10, 10},
    NumberKey{"board_friction_nominal", 1, 0, 5},
    NumberKey{"gravity_m_per_s2", 3, -20, 20, true},
    NumberKey{"gripper_patch_x_m", 1, 2e-4, 0.1},
    NumberKey{"gripper_patch_y_m", 1, 2e-4, 0.1},
    NumberKey{"camera_position_W_m", 3, -10, 10},
    NumberKey{"camera_view_direction_W", 3, -kAny, kAny},
    NumberKey{"sensor_depth_step_m", 1, 0, 0.1},
    NumberKey{"clock_offset_uncertainty_s", 1, 0, 100},
    NumberKey{"shaft_direction_W", 3, -kAny, kAny},
};
constexpr std::array<std::string_view, 11> kTextKeys = {"kind",
                                                        "mesh_file",
                                                        "rest_cloud_file",
                                                        "material",
                                                        "clamped_edge",
                                                        "tip_reference",
                                                        "cloud_content",
                                                        "force_sensor",
                                                        "camera_registration_uncertainty",
                                                        "sensor_noise_class",
                                                        "name"};

/// "pinch_point_12_sheet_m" for the stems "pinch_point_" and "_sheet_m"; the number.
std::optional<int> numbered(std::string_view key, std::string_view stem, std::string_view end) {
  if (!key.starts_with(stem) || !key.ends_with(end) || key.size() <= stem.size() + end.size())
    return std::nullopt;
  key.remove_prefix(stem.size());
  key.remove_suffix(end.size());
  if (key.size() > 4 ||
      !std::all_of(key.begin(), key.end(), [](char c) { return c >= '0' && c <= '9'; }))
    return std::nullopt;
  return std::stoi(std::string(key));
}

}  // namespace

Result<std::vector<double>> Belief::parse_numbers(std::size_t line, std::string_view key,
                                                  std::string_view value, int least,
                                                  int most) const {
  std::vector<double> numbers;
  for (std::size_t at = 0; at < value.size();) {
    at = std::min(value.find_first_not_of(" \t,", at), value.size());
    const std::size_t end = std::min(value.find_first_of(" \t,", at), value.size());
    if (at == end) break;
    const std::optional<double> number = parse_number(value.substr(at, end - at));
    if (!number || !std::isfinite(*number)) {
      return Failure{fmt::format("{}:{}: {}: \"{}\" is no finite number", name_, line, shown(key),
                                 shown(value.substr(at, end - at)))};
    }
    numbers.push_back(*number);
    at = end;
  }
  const int count = static_cast<int>(numbers.size());
  if (count < least || count > most) {
    return Failure{fmt::format(
        "{}:{}: {}: {} numbers, needed {}", name_, line, shown(key), count,
        least == most ? fmt::format("{}", most) : fmt::format("{} or {}", least, most))};
  }
  return numbers;
}

Result<bool> Belief::take_numbered(std::size_t line, const std::string& key,
                                   std::string_view value) {
  for (const auto& [end, points] : {std::pair{"_sheet_m", &pinch_sheet_}, {"_W_m", &pinch_W_}}) {
    const std::optional<int> number = numbered(key, "pinch_point_", end);
    if (!number) continue;
    const auto numbers = parse_numbers(line, key, value, 2, 3);
    if (!numbers) return Failure{numbers.error()};
    const std::vector<double>& p = numbers.value();
    (*points)[*number] = Vector3d(p[0], p[1], p.size() > 2 ? p[2] : 0);
    return true;
  }
  const auto refuse = [&](double number, double min, double max) {
    return Failure{fmt::format("{}:{}: {}: {:.6g}, allowed {:g} ... {:g}", name_, line, shown(key),
                               number, min, max)};
  };
  if (const std::optional<int> number = numbered(key, "mass_", "_kg")) {
    const auto kg = parse_numbers(line, key, value, 1, 1);
    if (!kg) return Failure{kg.error()};
    const double mass = kg.value().front();
    if (!(mass >= 0 && mass <= kHeaviest)) return refuse(mass, 0, kHeaviest);
    masses_[*number].kg = mass;
    return true;
  }
  if (const std::optional<int> number = numbered(key, "mass_", "_B_m")) {
    const auto place = parse_numbers(line, key, value, 2, 3);
    if (!place) return Failure{place.error()};
    const std::vector<double>& p = place.value();
    for (const double x : p) {
      if (!(std::fabs(x) <= kFarthest)) return refuse(x, -kFarthest, kFarthest);
    }
    masses_[*number].p_B = Vector3d(p[0], p[1], p.size() > 2 ? p[2] : 0);
    return true;
  }
  return false;
}

Result<void> Belief::take(std::size_t line, const std::string& key, std::string_view value) {
  if (!lines_.emplace(key, line).second) {
    return Failure{fmt::format("{}:{}: {}: given a second time, first on line {}", name_, line,
                               shown(key), lines_.at(key))};
  }
  if (std::find(kTextKeys.begin(), kTextKeys.end(), key) != kTextKeys.end()) {
    texts_[key] = std::string(value);
    return {};
  }
  const Result<bool> taken = take_numbered(line, key, value);
  if (!taken) return Failure{taken.error()};
  if (taken.value()) return {};
  double factor = 1;
  std::string name = key;
  auto known = std::find_if(kNumberKeys.begin(), kNumberKeys.end(),
                            [&](const NumberKey& k) { return name == k.name; });
  if (known == kNumberKeys.end()) {  // in another unit
    if (const Result<SiColumn> si = si_column(key)) {
      name = si.value().name;
      factor = si.value().factor;
      known = std::find_if(kNumberKeys.begin(), kNumberKeys.end(),
                           [&](const NumberKey& k) { return name == k.name; });
    }
  }
  if (known == kNumberKeys.end()) {
    unknown_.push_back(key);
    return {};
  }
  const auto parsed =
      parse_numbers(line, key, value, known->single ? 1 : known->count, known->count);
  if (!parsed) return Failure{parsed.error()};
  std::vector<double> numbers = parsed.value();
  if (known->single && numbers.size() > 1 && static_cast<int>(numbers.size()) < known->count) {
    return Failure{fmt::format("{}:{}: {}: {} numbers, needed 1 or {}", name_, line, shown(key),
                               numbers.size(), known->count)};
  }
  for (double& number : numbers) {
    number *= factor;
    if (number >= known->min && number <= known->max) continue;
    return Failure{fmt::format("{}:{}: {}: {:.6g}, allowed {:g} ... {:g}", name_, line, shown(key),
                               number, known->min, known->max)};
  }
  if (name != key && !lines_.emplace(name, line).second) {
    return Failure{fmt::format("{}:{}: {}: given a second time, first on line {}", name_, line,
                               shown(key), lines_.at(name))};
  }
  numbers_[name] = numbers;
  return {};
}

Result<void> Belief::read(std::string_view text) {
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
  if (text.find('\0') != std::string_view::npos)
    return Failure{name_ + ": bytes of zero, needed plain text (UTF-8)"};
  std::size_t line = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    std::string_view content = text.substr(at, end - at);
    content = trim(content.substr(0, content.find('#')));
    at = end + 1;
    ++line;
    if (content.empty()) continue;
    const std::size_t colon = content.find(':');
    if (colon == std::string_view::npos) {
      return Failure{
          fmt::format("{}:{}: \"{}\": no colon, needed key: value", name_, line, shown(content))};
    }
    const std::string key(trim(content.substr(0, colon)));
    const std::string_view value = trim(content.substr(colon + 1));
    if (key.empty()) return Failure{fmt::format("{}:{}: no key before the colon", name_, line)};
    if (value.empty()) {
      return Failure{fmt::format("{}:{}: {}: no value behind the colon", name_, line, shown(key))};
    }
    if (Result<void> taken = take(line, key, value); !taken) return taken;
  }
  return {};
}

StatedUncertainty uncertainty_in(std::string_view text) {
  constexpr std::string_view kBetween = " \t,;()+-~";
  StatedUncertainty found;
  double number = -1;  // below zero: none
  while (true) {
    text.remove_prefix(std::min(text.find_first_not_of(kBetween), text.size()));
    if (text.empty()) return found;
    if ((text.front() >= '0' && text.front() <= '9') || text.front() == '.') {
      const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
      if (error != std::errc()) number = -1;
      text.remove_prefix(std::max<std::size_t>(1, static_cast<std::size_t>(end - text.data())));
      continue;
    }
    const std::string_view word = text.substr(0, text.find_first_of(kBetween));
    text.remove_prefix(word.size());
    if (number >= 0 && number < 1e6) {
      const bool degrees = word == "deg" || word == "degree" || word == "degrees";
      if (word == "mm" && found.metres == 0) found.metres = 1e-3 * number;
      if (word == "m" && found.metres == 0) found.metres = number;
      if (degrees && found.radians == 0) found.radians = kDegree * number;
      if (word == "rad" && found.radians == 0) found.radians = number;
    }
    number = -1;
  }
}

}  // namespace omentum

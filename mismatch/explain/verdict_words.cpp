#include "mismatch/explain/verdict_words.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <map>
#include <optional>

#include "mismatch/calibrate/number_words.h"

namespace omentum {
namespace {

constexpr double kWorse = 1.1;  // of the squared error that the base has

/// Numbers by which effects are claimed and limits told, docs/mismatch.md 4.
const std::map<std::string, std::string>& words() {
  static const std::map<std::string, std::string> table = {
      {"actuation_delay.tau", "delay of the arm"},
      {"adhesion.G", "work that parts it, by area"},
      {"adhesion.delta_c", "stretch under its largest pull"},
      {"adhesion.half_size", "half of its side"},
      {"adhesion.half_x", "half of its side along x"},
      {"adhesion.half_y", "half of its side along y"},
      {"adhesion.k", "stiffness of what sticks, by area"},
      {"anchor_compliance.K_per_length", "stiffness of the clamped edge, by length"},
      {"anchor_compliance.inverse_K", "give of the clamped edge"},
      {"anchor_detachment.from", "where the free piece of the clamped edge begins"},
      {"anchor_detachment.length", "length of the clamped edge that is free"},
      {"anchor_detachment.to", "where the free piece of the clamped edge ends"},
      {"anisotropy.Ef_over_E", "stiffness of the fibres over that of the rest"},
      {"anisotropy.angle", "direction of the fibres from x"},
      {"grasp_offset.offset", "how far the patch lies from the tip"},
      {"grasp_offset.x", "how far the patch lies from the tip along x"},
      {"grasp_offset.y", "how far the patch lies from the tip along y"},
      {"grasp_slip.Fs", "pull above which it slips"},
      {"grasp_slip.total", "length after which it holds again"},
      {"grasp_slip.v0", "speed of the slip at twice that pull"},
      {"inclusion.k", "stiffness there over that of the rest"},
      {"inclusion.k_r2", "stiffness times radius squared"},
      {"inclusion.r", "its radius"},
      {"jaw_orientation.angle", "turn of the patch in the jaws"},
      {"jaw_orientation.lean", "turn of the patch in the jaws about y"},
      {"jaw_orientation.roll", "turn of the patch in the jaws about the shaft"},
      {"jaw_orientation.tilt", "turn of the patch in the jaws about x"},
      {"obstacle.height", "how high it is above what the sheet lies on"},
      {"obstacle.radius", "its radius"},
      {"rest_shape.kappa", "largest curvature at rest"},
      {"rest_shape.kappa_x", "curvature at rest along x"},
      {"rest_shape.kappa_y", "curvature at rest along y"},
      {"strain_stiffening.c2_over_mu", "stiffening with strain"},
      {"thickness.a_x", "change of the thickness along x"},
      {"thickness.a_y", "change of the thickness along y"},
      {"tool_backlash.b", "largest play of the tool"},
      {"tool_backlash.b_x", "play of the tool along x"},
      {"tool_backlash.b_y", "play of the tool along y"},
      {"tool_backlash.b_z", "play of the tool along z"},
      {"tool_compliance.C", "largest give of the tool"},
      {"tool_compliance.C_x", "give of the tool along x"},
      {"tool_compliance.C_y", "give of the tool along y"},
      {"tool_compliance.C_z", "give of the tool along z"},
      {"viscoelastic.g", "share of the stiffness that relaxes"},
      {"viscoelastic.tau", "time in which it relaxes"},
  };
  return table;
}

/// Effects as a sentence names them.
const std::map<std::string, std::string>& effect_words() {
  static const std::map<std::string, std::string> table = {
      {"actuation_delay", "a late arm"},
      {"adhesion", "a place that sticks"},
      {"anchor_compliance", "a clamped edge that gives way"},
      {"anchor_detachment", "a piece of the clamped edge that is free"},
      {"anisotropy", "fibres"},
      {"grasp_offset", "a displaced grasp"},
      {"grasp_slip", "slip in the jaws"},
      {"inclusion", "a stiffer place"},
      {"jaw_orientation", "turned jaws"},
      {"obstacle", "an obstacle"},
      {"rest_shape", "curvature at rest"},
      {"soft_spot", "a softer place"},
      {"strain_stiffening", "stiffening with strain"},
      {"thickness", "a sloping thickness"},
      {"tool_backlash", "play of the tool"},
      {"tool_compliance", "give of the tool"},
      {"viscoelastic", "stiffness that relaxes"},
  };
  return table;
}

/// The number of which a text consists.
std::optional<double> number_in(const std::string& text) {
  double value = 0;
  const char* const end = text.data() + text.size();
  const auto [stop, error] = std::from_chars(text.data(), end, value);
  if (error != std::errc() || stop != end || !std::isfinite(value)) return std::nullopt;
  return value;
}

std::vector<std::string> parts_of(const std::string& text, char at) {
  std::vector<std::string> parts(1);
  for (const char c : text) {
    if (c == at) {
      parts.emplace_back();
    } else {
      parts.back() += c;
    }
  }
  return parts;
}

}  // namespace

std::string words_of(const std::string& effect, const std::string& number) {
  const auto found = words().find((effect == "soft_spot" ? "inclusion" : effect) + "." + number);
  return found == words().end() ? "" : found->second;
}

std::string named(const std::string& effect, const std::string& number) {
  const std::string text = words_of(effect, number);
  return text.empty() ? number : number + ", " + text;
}

std::string key_text(const std::string& key) {
  const std::size_t at = key.find('@');
  if (at == std::string::npos) return key;
  std::string place, others;
  for (const std::string& setting : parts_of(key.substr(at + 1), ':')) {
    const std::size_t equals = setting.find('=');
    const std::string name = setting.substr(0, equals);
    const std::optional<double> value =
        equals == std::string::npos ? std::nullopt : number_in(setting.substr(equals + 1));
    if (value && (name == "x" || name == "y")) {
      place += fmt::format("{} {} = {:.1f}", place.empty() ? " at" : ",", name, 1e3 * *value);
    } else if (!value || (name == "tau" || name == "angle_deg")) {
      others += ", " + setting;  // others are sizes of the columns alone
    }
  }
  return key.substr(0, at) + others + (place.empty() ? "" : place + " mm");
}

std::string with_keys_read(const std::string& text) {
  std::string read;
  for (const std::string& word : parts_of(text, ' ')) {
    const bool is_key = word.find('.') < word.find('@') && word.find('@') < word.find('=');
    read += (read.empty() ? "" : " ") + (is_key ? key_text(word) : word);
  }
  return read;
}

std::string rival_number(const std::string& text) {
  const std::vector<std::string> parts = parts_of(text, ' ');
  constexpr std::size_t kName = 0, kValue = 2, kUnit = 3;
  if (parts.size() <= kUnit || parts[1] != "=") return text;
  const std::optional<double> value = number_in(parts[kValue]);
  if (!value) return text;
  std::string unit = parts[kUnit];
  for (std::size_t k = kUnit + 1; k < parts.size(); ++k) unit += " " + parts[k];
  const double none = std::nan("");
  return parts[kName] + " = " + number_in_line(*value, none, none, unit);
}

std::string numbers_of(const pb::VerdictRival& rival) {
  std::string text;
  for (const std::string& number : rival.numbers())
    text += (text.empty() ? "" : ", ") + rival_number(number);
  return text;
}

std::string least_size(double size, const pb::VerdictLimit& limit) {
  const double none = std::nan("");
  return number_in_line(size, none, none, limit.unit());
}

std::string anywhere_text(const pb::VerdictLimit& limit) {
  return limit.has_amplitude_anywhere() ? least_size(limit.amplitude_anywhere(), limit) : "";
}

std::string limit_words(const pb::VerdictLimit& limit) {
  const std::size_t dot = limit.effect().find('.');
  if (dot == std::string::npos) return "";
  return words_of(limit.effect().substr(0, dot), limit.effect().substr(dot + 1));
}

std::string figure(double value) {
  return std::isfinite(value) ? fmt::format("{:.3g}", value) : "-";
}

std::string mm(double metres) { return fmt::format("{:.2f}", 1e3 * metres); }

std::string nats(double gain) {
  constexpr double kLarge = 9.95;  // is written as 10.0 with a decimal
  return fmt::format("{:.{}f}", gain, std::fabs(gain) < kLarge ? 1 : 0);
}

ShownNumber shown(const pb::VerdictParameter& p) {
  return show_number(p.value(), p.low90(), p.high90(), p.unit());
}

// No place is known better than to a tenth of a millimetre.
std::string where_text(const pb::VerdictWhere& where) {
  if (where.edge_interval_m_size() == 2) {
    return fmt::format("on the clamped edge from x = {:.1f} to {:.1f} mm",
                       1e3 * where.edge_interval_m(0), 1e3 * where.edge_interval_m(1));
  }
  if (where.centre_m_size() < 2) return "";
  std::string text = fmt::format("at x = {:.1f}, y = {:.1f} mm from the middle of the sheet",
                                 1e3 * where.centre_m(0), 1e3 * where.centre_m(1));
  if (where.has_radius50_m())
    text += fmt::format(" (half of it within {:.1f} mm)", 1e3 * where.radius50_m());
  return text;
}

std::string channel_text(const pb::VerdictChannel& channel) {
  return fmt::format("{}: {} {} before, {} {} after, rms of {} frames that no fit saw; {}",
                     channel.name(), figure(channel.rms_base()), channel.unit(),
                     figure(channel.rms_model()), channel.unit(), channel.rows(),
                     channel.contradicts() ? "it contradicts the claim"
                                           : "it does not contradict what is claimed");
}

std::string pull_text(const Pull& pull) {
  return fmt::format("{}{} is {:.1f} standard deviations from what was believed",
                     pull.owner.empty() ? "" : pull.owner + ": ", nuisance_words(pull.key),
                     std::fabs(pull.pull));
}

std::vector<std::string> pull_lines(std::span<const Pull> pulls, double beyond) {
  struct Line {
    std::string owner, words, text;
    int others = 0;
  };
  std::vector<Line> lines;
  for (const Pull& pull : pulls) {
    if (!(std::fabs(pull.pull) > beyond)) continue;
    const std::string words = nuisance_words(pull.key);
    const auto same = std::ranges::find_if(
        lines, [&](const Line& line) { return line.owner == pull.owner && line.words == words; });
    if (same == lines.end()) {
      lines.push_back({pull.owner, words, pull_text(pull)});
    } else {
      ++same->others;
    }
  }
  std::vector<std::string> texts;
  for (const Line& line : lines) {
    texts.push_back(line.others == 0
                        ? line.text
                        : fmt::format("{}, and {} more like it", line.text, line.others));
  }
  return texts;
}

bool foretells_worse(const pb::Verdict& verdict) {
  double before = 0, after = 0;
  for (const pb::VerdictFit& row : verdict.fit()) {
    if (row.role() != "held_out" || !row.has_r()) continue;
    const double floor = row.floor() * row.floor();
    before += row.rmse_base() * row.rmse_base() - floor;
    after += row.rmse_model() * row.rmse_model() - floor;
  }
  return after > kWorse * before;
}

std::string contradiction_text(const pb::Verdict& verdict) {
  for (const pb::VerdictFit& row : verdict.fit()) {
    if (row.role() == "held_out" && row.has_r() && row.r() > kWorse)
      return fmt::format("{}, which was held out, is farther off with it, by {} mm instead of {}",
                         row.recording(), mm(row.rmse_model()), mm(row.rmse_base()));
  }
  return {};
}

std::string names_of(const pb::VerdictEffect& effect) {
  std::string names;
  for (const pb::VerdictMember& member : effect.class_().members())
    names += (names.empty() ? "" : " or ") + member.name();
  return names;
}

std::string told_names(const pb::VerdictEffect& effect) {
  std::string told;
  for (const pb::VerdictMember& member : effect.class_().members()) {
    const auto words = effect_words().find(member.name());
    told += told.empty() ? "" : " or ";
    told += words == effect_words().end() ? member.name()
                                          : fmt::format("{} ({})", words->second, member.name());
  }
  return told;
}

}  // namespace omentum

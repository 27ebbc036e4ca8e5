#include "mismatch/explain/verdict_words.h"

#include <fmt/format.h>

#include <cmath>

namespace omentum {

std::string figure(double value) {
  return std::isfinite(value) ? fmt::format("{:.4g}", value) : "-";
}

std::string mm(double metres) { return fmt::format("{:.2f}", 1e3 * metres); }

std::string with_unit(double value, const std::string& unit) {
  return unit == "m" ? mm(value) + " mm" : figure(value) + (unit == "1" ? "" : " " + unit);
}

std::string where_text(const pb::VerdictWhere& where) {
  if (where.edge_interval_m_size() == 2) {
    return fmt::format("on the clamped edge from x = {} to {} mm", mm(where.edge_interval_m(0)),
                       mm(where.edge_interval_m(1)));
  }
  if (where.centre_m_size() < 2) return "";
  std::string text = fmt::format("at x = {}, y = {} mm from the middle of the sheet",
                                 mm(where.centre_m(0)), mm(where.centre_m(1)));
  if (where.has_radius50_m())
    text += fmt::format(" (half of it within {} mm)", mm(where.radius50_m()));
  return text;
}

std::string channel_text(const pb::VerdictChannel& channel) {
  return fmt::format("{}: {} {} before, {} {} after, rms of {} frames that no fit saw; {}",
                     channel.name(), figure(channel.rms_base()), channel.unit(),
                     figure(channel.rms_model()), channel.unit(), channel.rows(),
                     channel.contradicts() ? "it contradicts the claim"
                                           : "it does not contradict what is claimed");
}

std::string names_of(const pb::VerdictEffect& effect) {
  std::string names;
  for (const pb::VerdictMember& member : effect.class_().members())
    names += (names.empty() ? "" : " or ") + member.name();
  return names;
}

}  // namespace omentum

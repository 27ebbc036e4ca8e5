#include "mismatch/explain/verdict_words.h"

#include <fmt/format.h>

#include <cmath>

namespace omentum {

std::string figure(double value) {
  return std::isfinite(value) ? fmt::format("{:.3g}", value) : "-";
}

std::string mm(double metres) { return fmt::format("{:.2f}", 1e3 * metres); }

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

std::string names_of(const pb::VerdictEffect& effect) {
  std::string names;
  for (const pb::VerdictMember& member : effect.class_().members())
    names += (names.empty() ? "" : " or ") + member.name();
  return names;
}

}  // namespace omentum

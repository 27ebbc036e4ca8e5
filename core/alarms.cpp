#include "core/alarms.h"

#include <fmt/format.h>

#include "core/log.h"

namespace omentum {

void Alarms::set(const std::string& name, bool holds, const std::string& text) {
  if (!holds) {
    if (holding_.erase(name) > 0) log().info("event=alarm_over name={}", name);
    return;
  }
  const auto [at, begins] = holding_.insert_or_assign(name, text);
  if (!begins) return;
  ++raised_;
  log().warn("event=alarm name={} text=\"{}\"", name, text);
}

std::vector<std::string> Alarms::texts() const {
  constexpr std::size_t kMost = 16;
  std::vector<std::string> texts;
  for (const auto& [name, text] : holding_) {
    if (texts.size() < kMost) texts.push_back(fmt::format("{}: {}", name, text));
  }
  return texts;
}

}  // namespace omentum

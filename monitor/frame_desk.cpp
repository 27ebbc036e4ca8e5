#include "monitor/frame_desk.h"

#include <algorithm>
#include <utility>

namespace omentum {
namespace {

ControlCommand frames_command(ControlAction action, std::uint32_t slot, float hz) {
  ControlCommand command;
  command.action = action;
  command.slot = slot;
  command.frames_hz = hz;
  return command;
}

}  // namespace

bool FrameDesk::look(std::uint32_t slot, float hz, std::int64_t now_ns) {
  if (!rows_.contains(slot) && rows_.size() >= kMaxSlots) return false;
  Row& row = rows_[slot];
  row.hz = std::max(row.hz, hz);  // of two viewers the faster one
  row.looked_at_ns = now_ns;
  return true;
}

std::vector<ControlCommand> FrameDesk::due(std::int64_t now_ns) {
  std::vector<ControlCommand> commands;
  for (auto at = rows_.begin(); at != rows_.end();) {
    auto& [slot, row] = *at;
    if (now_ns - row.looked_at_ns > kIdleNs) {
      if (row.told_hz > 0) commands.push_back(frames_command(ControlAction::kFramesOff, slot, 0));
      at = rows_.erase(at);
      continue;
    }
    // A learner that was restarted knows nothing of what it was told.
    const std::int64_t last = std::max(row.told_at_ns, row.frame_at_ns);
    if (row.told_hz != row.hz || now_ns - last > kMissingNs) {
      row.told_hz = row.hz;
      row.told_at_ns = now_ns;
      commands.push_back(frames_command(ControlAction::kFramesOn, slot, row.hz));
    }
    ++at;
  }
  return commands;
}

std::vector<ControlCommand> FrameDesk::all_off() {
  std::vector<ControlCommand> commands;
  for (const auto& [slot, row] : rows_) {
    if (row.told_hz > 0) commands.push_back(frames_command(ControlAction::kFramesOff, slot, 0));
  }
  rows_.clear();
  return commands;
}

void FrameDesk::put(SimFrame&& frame, std::int64_t now_ns) {
  const auto found = rows_.find(frame.slot);
  if (found == rows_.end()) return;
  found->second.frame_at_ns = now_ns;
  found->second.newest =
      std::make_shared<const NumberedFrame>(NumberedFrame{++numbers_, std::move(frame)});
}

std::shared_ptr<const NumberedFrame> FrameDesk::newest(std::uint32_t slot) const {
  const auto found = rows_.find(slot);
  return found == rows_.end() ? nullptr : found->second.newest;
}

}  // namespace omentum

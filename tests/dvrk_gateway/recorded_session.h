#pragma once

#include <memory>
#include <string>
#include <vector>

#include "dvrk_gateway/loop/control_loop.h"
#include "dvrk_gateway/recording/recording_file.h"
#include "tests/dvrk_gateway/double_session.h"

namespace omentum::test {

/// Turned and moved: a frame that is taken for another shows.
inline ToolMount turned_mount() {
  Eigen::Isometry3d X_WR = Eigen::Isometry3d::Identity();
  X_WR.translation() = Eigen::Vector3d(0.1, -0.2, 0.25);
  X_WR.linear() = Eigen::AngleAxisd(0.7, Eigen::Vector3d(1, 2, 3).normalized()).toRotationMatrix();
  return make_tool_mount(X_WR, 0, 0.0102, Eigen::Vector3d::Constant(-1),
                         Eigen::Vector3d::Constant(1));
}

inline RecordingSetup recording_setup(const ToolMount& mount) {
  RecordingSetup setup;
  setup.mount = mount;
  setup.info.set_name("test");
  setup.info.set_mode("twin");
  setup.info.set_control_period_s(0.02);
  setup.start_ns = 0;
  return setup;
}

/// Control periods of 20 ms with the double, homed, which follows goals that move along x_A by 0.1
/// mm a period while the jaw closes.
class RecordedSession {
 public:
  RecordedSession() : mount(turned_mount()), session_({}, {}, mount) { session_.home(); }

  Period next() {
    session_.run_for(0.02);
    Period period;
    period.number = ++number_;
    period.began_ns = static_cast<std::int64_t>(std::llround(1e9 * session_.now_s()));
    period.robot = session_.state;
    period.judgement.memory.phase = SafetyPhase::kActive;
    period.judgement.send = true;
    RobotCommand& command = period.judgement.command;
    command.kind = RobotCommand::Kind::kServoCp;
    const CartesianPose& at = session_.state.setpoint_cp.payload;
    if (goals.empty()) first_ = at;
    command.rotation = first_.rotation;
    command.translation =
        first_.translation + 1e-4 * static_cast<double>(goals.size()) * Eigen::Vector3d::UnitX();
    command.jaw = 0.5 - 0.001 * static_cast<double>(goals.size());
    period.sent_ns = period.began_ns + 1'000'000;
    period.sent_bytes = 300;
    session_.say(command);
    goals.push_back(command);
    return period;
  }
  std::vector<Period> take(int count) {
    std::vector<Period> periods;
    for (int k = 0; k < count; ++k) periods.push_back(next());
    return periods;
  }
  /// Of a pose of C in A, which is R.
  Eigen::Vector3d tip(const Eigen::Matrix3d& R_RC, const Eigen::Vector3d& p_RC) const {
    return mount.X_WR * (p_RC + R_RC * Eigen::Vector3d(0, 0, mount.tip_offset));
  }

  ToolMount mount;
  std::vector<RobotCommand> goals;

 private:
  DoubleSession session_;
  CartesianPose first_;
  std::uint64_t number_ = 0;
};

/// The messages of a topic, parsed.
template <typename Message>
std::vector<Message> messages_of(const McapContent& content, const char* topic) {
  std::vector<Message> messages;
  for (const McapMessage* message : content.of_topic(topic)) {
    EXPECT_TRUE(messages.emplace_back().ParseFromString(message->data)) << topic;
  }
  return messages;
}

}  // namespace omentum::test

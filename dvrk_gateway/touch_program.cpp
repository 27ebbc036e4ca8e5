#include "dvrk_gateway/touch_program.h"

#include <fmt/core.h>

#include <Eigen/Geometry>
#include <array>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "core/config.h"
#include "core/csv.h"
#include "dvrk_gateway/gateway_setup.h"
#include "dvrk_gateway/loop/session.h"
#include "dvrk_gateway/operator_screen.h"
#include "sim_worker/backend/sim_setup.h"

namespace omentum {
namespace {

struct Point {
  std::string name;
  Eigen::Vector3d p_W = Eigen::Vector3d::Zero();
};

std::vector<Point> read_points(const std::string& path) {
  const Result<CsvTable> table = load_csv(path);
  if (!table) throw_error("--points {}", table.error());
  const std::optional<std::size_t> name = table.value().column("name");
  std::vector<Point> points;
  for (std::size_t row = 0; row < table.value().rows.size() && name; ++row) {
    Point& point = points.emplace_back();
    point.name = table.value().rows[row][*name].text;
    for (int k = 0; k < 3; ++k) {
      constexpr std::array<const char*, 3> kColumns = {"world_x_m", "world_y_m", "world_z_m"};
      point.p_W[k] = table.value().number(row, kColumns[static_cast<std::size_t>(k)]);
    }
    if (point.name.empty() || !point.p_W.allFinite())
      throw_error("--points {}: needs a name and three finite numbers",
                  table.value().place(row, 0));
  }
  if (points.empty()) {
    throw_error(
        "--points {}: needs the columns name, world_x_m, world_y_m, world_z_m and a row for each "
        "point",
        path);
  }
  return points;
}

/// What the robot says of its control point, and whether it stood still while it said it.
class TouchWatch final : public GatewayObserver {
 public:
  void on_period(const Period& period) override {
    const CartesianPose& pose = period.robot.local_measured_cp.payload;
    const bool fresh = pose.valid && period.robot.has_source &&
                       period.began_ns - period.robot.local_measured_cp.advanced_ns < kFresh_ns;
    const std::scoped_lock lock(mutex_);
    still_ = fresh && (pose.translation - pose_.translation).norm() < kStill_m ? still_ + 1 : 0;
    pose_ = pose;
  }
  /// Nothing where the robot is silent, invalid or moving.
  std::optional<CartesianPose> pose() {
    const std::scoped_lock lock(mutex_);
    if (still_ < kPeriods) return std::nullopt;
    return pose_;
  }

 private:
  static constexpr std::int64_t kFresh_ns = 100'000'000;
  static constexpr double kStill_m = 5e-5;
  static constexpr int kPeriods = 10;  // 0.2 s
  std::mutex mutex_;
  CartesianPose pose_;
  int still_ = 0;
};

std::string row_of(const Point& point, const CartesianPose& pose) {
  const Eigen::Quaterniond q(pose.rotation);
  return fmt::format("{},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g},{:.9g}\n",
                     point.name, point.p_W.x(), point.p_W.y(), point.p_W.z(), pose.translation.x(),
                     pose.translation.y(), pose.translation.z(), q.w(), q.x(), q.y(), q.z());
}

}  // namespace

int write_touches(const GatewayOptions& options) {
  const std::vector<Point> points = read_points(options.points);
  if (std::filesystem::exists(options.touches))
    throw_error("--out {}: exists; touches are not written over", options.touches);
  const SavedPolicy saved = policy_of(options);
  const SafetySetup safety = safety_of(options, make_sim_setup(saved.config)->mount, saved.config);
  catch_operator_signals();
  GatewaySession session(robot_address(options), options.robot_port, safety, true);
  std::ofstream out(options.touches);
  out << "name,world_x_m,world_y_m,world_z_m,control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z\n"
      << std::flush;
  if (!out) throw_error("--out {}: cannot be made", options.touches);
  TouchWatch watch;
  OperatorDesk desk;
  std::atomic<char> key{0};
  session.attend(
      [&] {
        OperatorWishes wishes = desk.ask();
        if (wishes.arm) key = 'a';  // nothing is armed: it takes the touch
        if (wishes.key == 's') key = 's';
        wishes.arm = false;
        return wishes;
      },
      {&watch});
  std::size_t next = 0;
  std::size_t written = 0;
  const auto ask = [&] {
    if (next == points.size()) return;
    const Point& point = points[next];
    fmt::print(
        "bring the tip to {} at {:.1f}, {:.1f}, {:.1f} mm in W and press a; s leaves it out, q "
        "ends\n",
        point.name, 1e3 * point.p_W.x(), 1e3 * point.p_W.y(), 1e3 * point.p_W.z());
    std::fflush(stdout);
  };
  ask();
  while (next < points.size() && !session.ended()) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    const char pressed = key.exchange(0);
    if (pressed == 0) continue;
    if (pressed == 'a') {
      const std::optional<CartesianPose> pose = watch.pose();
      if (!pose) {
        fmt::print("no touch: the robot is silent, not homed, or moves\n");
        std::fflush(stdout);
        continue;
      }
      out << row_of(points[next], *pose) << std::flush;
      if (!out) throw_error("--out {}: cannot be written", options.touches);
      ++written;
    }
    ++next;
    ask();
  }
  session.end();
  fmt::print("{}: {} of {} points\n", options.touches, written, points.size());
  return next == points.size() ? 0 : 1;
}

}  // namespace omentum

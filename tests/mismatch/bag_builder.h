#pragma once

#include <fmt/format.h>

#include <cmath>
#include <map>
#include <string>
#include <vector>

#include "support/ros_bag.h"

namespace omentum::test {

inline constexpr std::int64_t kStart = 1'700'000'000'000'000'000, kMs = 1'000'000;

/// Definitions as they stand in bags, of either version.
class Definitions {
 public:
  explicit Definitions(bool ros1) : ros1_(ros1) {}
  std::string joints() const {
    return "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
           "float64[] effort\n" +
           header();
  }
  std::string pose() const {
    return "std_msgs/Header header\nPose pose\n" + header() + part("geometry_msgs/Pose") +
           "Point position\nQuaternion orientation\n" + vectors();
  }
  std::string wrench() const {
    return "std_msgs/Header header\nWrench wrench\n" + header() + part("geometry_msgs/Wrench") +
           "Vector3 force\nVector3 torque\n" + vectors();
  }
  std::string transforms() const {
    return "geometry_msgs/TransformStamped[] transforms\n" +
           part("geometry_msgs/TransformStamped") +
           "std_msgs/Header header\nstring child_frame_id\nTransform transform\n" + header() +
           part("geometry_msgs/Transform") + "Vector3 translation\nQuaternion rotation\n" +
           vectors();
  }
  std::string image() const {
    return "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n"
           "uint8 is_bigendian\nuint32 step\nuint8[] data\n" +
           header();
  }
  std::string camera() const {
    const std::string k = ros1_ ? "K" : "k", d = ros1_ ? "D" : "d";
    return "std_msgs/Header header\nuint32 height\nuint32 width\nfloat64[] " + d + "\nfloat64[9] " +
           k + "\n" + header();
  }
  std::string packed() const {
    return "std_msgs/Header header\nstring format\nuint8[] data\n" + header();
  }
  std::string text() const { return "string data\n"; }

 private:
  static std::string part(const std::string& name) {
    return fmt::format("{:=<80}\nMSG: {}\n", "", name);
  }
  std::string header() const {
    return part("std_msgs/Header") + (ros1_ ? "uint32 seq\ntime stamp\nstring frame_id\n"
                                            : "builtin_interfaces/Time stamp\nstring frame_id\n");
  }
  static std::string vectors() {
    return part("geometry_msgs/Point") + "float64 x\nfloat64 y\nfloat64 z\n" +
           part("geometry_msgs/Vector3") + "float64 x\nfloat64 y\nfloat64 z\n" +
           part("geometry_msgs/Quaternion") + "float64 x 0\nfloat64 y\nfloat64 z\nfloat64 w\n";
  }
  bool ros1_;
};

/// A bag that is written message by message.
class Bag {
 public:
  explicit Bag(bool ros1, RosBytes::Form form = RosBytes::kLittle)
      : ros1_(ros1), form_(ros1 ? RosBytes::kPacked : form), file_(ros1), definitions_(ros1) {}

  std::string type(const std::string& package, const std::string& name) const {
    return package + (ros1_ ? "/" : "/msg/") + name;
  }
  RosBytes at(std::int64_t time_ns, const std::string& frame) const {
    RosBytes bytes(form_);
    bytes.header(time_ns, frame);
    return bytes;
  }
  void write(const std::string& topic, const std::string& type, const std::string& definition,
             std::int64_t log_ns, const RosBytes& bytes) {
    if (!channels_.contains(topic)) {
      std::string text = definition;
      // Defaults are of ROS 2.
      if (ros1_ && text.find(" x 0") != std::string::npos) text.erase(text.find(" x 0") + 2, 2);
      channels_[topic] = file_.topic(topic, type, text);
    }
    file_.message(channels_[topic], log_ns, bytes.bytes());
  }

  void pose(const std::string& topic, std::int64_t t, const std::string& frame,
            const std::vector<double>& p, const std::vector<double>& xyzw = {0, 0, 0, 1}) {
    write(topic, type("geometry_msgs", "PoseStamped"), definitions_.pose(), t + 3 * kMs,
          at(t, frame).fixed(p).fixed(xyzw));
  }
  void wrench(const std::string& topic, std::int64_t t, const std::string& frame,
              const std::vector<double>& force, const std::vector<double>& torque) {
    write(topic, type("geometry_msgs", "WrenchStamped"), definitions_.wrench(), t,
          at(t, frame).fixed(force).fixed(torque));
  }
  void joints(const std::string& topic, std::int64_t t, const std::vector<std::string>& names,
              const std::vector<double>& q, const std::vector<double>& dq = {},
              const std::vector<double>& effort = {}) {
    write(topic, type("sensor_msgs", "JointState"), definitions_.joints(), t,
          at(t, "").texts(names).open(q).open(dq).open(effort));
  }
  void transform(const std::string& topic, std::int64_t t, const std::string& parent,
                 const std::string& child, const std::vector<double>& p,
                 const std::vector<double>& xyzw) {
    RosBytes bytes(form_);
    bytes.put(std::uint32_t{1}).header(t, parent).text(child).fixed(p).fixed(xyzw);
    write(topic, type("tf2_msgs", "TFMessage"), definitions_.transforms(), t, bytes);
  }
  /// 3 x 2 pixels.
  void depth(const std::string& topic, std::int64_t t, const std::string& frame,
             const std::vector<std::uint16_t>& mm) {
    std::string data(12, '\0');
    std::memcpy(data.data(), mm.data(), 12);
    image(topic, t, frame, "16UC1", 6, data);
  }
  void image(const std::string& topic, std::int64_t t, const std::string& frame,
             const std::string& encoding, std::uint32_t step, const std::string& data) {
    write(topic, type("sensor_msgs", "Image"), definitions_.image(), t + 40 * kMs,
          at(t, frame)
              .put(std::uint32_t{2})
              .put(std::uint32_t{3})
              .text(encoding)
              .put(std::uint8_t{0})
              .put(step)
              .blob(data));
  }
  void camera(const std::string& topic, std::int64_t t, const std::string& frame) {
    write(topic, type("sensor_msgs", "CameraInfo"), definitions_.camera(), t,
          at(t, frame)
              .put(std::uint32_t{2})
              .put(std::uint32_t{3})
              .open<double>({0, 0, 0, 0, 0})
              .fixed<double>({2, 0, 1, 0, 2.5, 0.5, 0, 0, 1}));
  }
  void packed(const std::string& topic, std::int64_t t, const std::string& format,
              const std::string& data) {
    write(topic, type("sensor_msgs", "CompressedImage"), definitions_.packed(), t,
          at(t, "cam").text(format).blob(data));
  }
  void text(const std::string& topic, std::int64_t t) {
    write(topic, type("std_msgs", "String"), definitions_.text(), t, RosBytes(form_).text("hi"));
  }
  BagFile& file() { return file_; }

 private:
  bool ros1_;
  RosBytes::Form form_;
  BagFile file_;
  Definitions definitions_;
  std::map<std::string, std::uint16_t> channels_;
};

inline const std::vector<std::string> kNames = {"yaw", "pitch", "insertion"};

/// Everything that CRTK names, a camera and its pose.
inline Bag robot(bool ros1, RosBytes::Form form = RosBytes::kLittle,
                 const std::string& frame = "W") {
  Bag bag(ros1, form);
  bag.transform("/tf_static", kStart, frame, "cam", {0, 0, 0.5}, {1, 0, 0, 0});
  bag.camera("/cam/depth/camera_info", kStart, "cam");
  for (int k = 0; k < 5; ++k) {
    const std::int64_t t = kStart + k * 20 * kMs;
    const double x = 0.001 * k;
    bag.pose("/PSM1/measured_cp", t, frame, {x, 0.02, 0.03},
             {0, 0, std::sqrt(0.5), std::sqrt(0.5)});
    bag.pose("/PSM1/setpoint_cp", t + kMs, frame, {x + 1e-5, 0.02, 0.03});
    bag.pose("/PSM1/servo_cp", t + 2 * kMs, frame, {x + 2e-5, 0.02, 0.03});
    bag.joints("/PSM1/measured_js", t, kNames, {0.1, -0.2, 0.1 + x}, {1, 2, 3}, {0.5, 0.6, 0.7});
    bag.joints("/PSM1/jaw/measured_js", t, {"jaw"}, {0.3 - x}, {-0.05}, {0.01});
    bag.joints("/PSM1/jaw/setpoint_js", t, {"jaw"}, {0.3});
    bag.joints("/PSM1/jaw/servo_jp", t + 5 * kMs, {}, {0.25});
    bag.wrench("/PSM1/body/measured_cf", t, "tip", {1, 0, 0}, {0, 0.1, 0});
    bag.depth("/cam/depth/image_raw", t, "cam",
              {0, 400, 500, static_cast<std::uint16_t>(500 + k), 65535, 1});
    bag.text("/rosout", t);
  }
  return bag;
}

}  // namespace omentum::test

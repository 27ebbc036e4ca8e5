#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "core/check.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/ros/bag_topic.h"

// A definition and a message of ROS: the first byte says which type and encoding, then the text of
// the definition up to a byte of zero (none: the usual one), then the message. Each gives a whole
// result or one line; pictures that are made are PNG of their size.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

using omentum::BagTopic;
using omentum::RosKind;

void require(bool good) {
  if (!good) __builtin_trap();
}

constexpr const char* kHeader =
    "\n===\nMSG: std_msgs/Header\nTime stamp\nstring frame_id\n===\nMSG: std_msgs/Time\n"
    "uint32 sec\nuint32 nanosec\n===\nMSG: a/V\nfloat64 x\nfloat64 y\nfloat64 z\n===\nMSG: a/Q\n"
    "float64 x\nfloat64 y\nfloat64 z\nfloat64 w\n===\nMSG: a/P\na/V position\na/Q orientation\n"
    "===\nMSG: a/T\na/V translation\na/Q rotation\n===\nMSG: a/W\na/V force\na/V torque\n"
    "===\nMSG: a/S\nstd_msgs/Header header\nstring child_frame_id\na/T transform\n"
    "===\nMSG: a/F\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n";

/// Type, topic, usual definition.
struct Kind {
  const char* type;
  const char* topic;
  const char* definition;
};
constexpr std::array<Kind, 9> kKinds = {
    {{"geometry_msgs/PoseStamped", "/a/measured_cp", "std_msgs/Header header\na/P pose"},
     {"geometry_msgs/TransformStamped", "/a/measured_cp", "std_msgs/Header header\na/T transform"},
     {"tf2_msgs/TFMessage", "/tf", "a/S[] transforms"},
     {"sensor_msgs/JointState", "/a/measured_js",
      "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\n"
      "float64[] effort"},
     {"geometry_msgs/WrenchStamped", "/a/body/measured_cf", "std_msgs/Header header\na/W wrench"},
     {"sensor_msgs/PointCloud2", "/c",
      "std_msgs/Header header\nuint32 height\nuint32 width\na/F[] fields\nbool is_bigendian\n"
      "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense"},
     {"sensor_msgs/Image", "/i",
      "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\n"
      "uint32 step\nuint8[] data"},
     {"sensor_msgs/CompressedImage", "/p", "std_msgs/Header header\nstring format\nuint8[] data"},
     {"sensor_msgs/CameraInfo", "/k",
      "std_msgs/Header header\nuint32 height\nuint32 width\nfloat64[] d\nfloat64[9] k"}}};

void require_png(const std::string& png, int bits, std::uint32_t width, std::uint32_t height) {
  const auto size = omentum::parse_png_size("fuzz", png);
  require(size.has_value() && size.value().bits == bits);
  require(width == 0 || (size.value().width == width && size.value().height == height));
}

/// What would be fetched of a picture or cloud.
void make_picture(const BagTopic& topic, std::string_view message) {
  const omentum::RosValue value = topic.decode(message);
  if (topic.kind == RosKind::kCloud) {
    for (const auto& p : omentum::ros_cloud(value, Eigen::Isometry3d::Identity()))
      require(p.allFinite());
  } else if (topic.kind == RosKind::kImage) {
    const omentum::RosImage image = omentum::ros_image(value);
    if (topic.is_depth) require_png(omentum::depth_png(image, 1e-4), 16, image.width, image.height);
    if (topic.is_color) require_png(omentum::color_png(image), 8, image.width, image.height);
  } else {
    if (topic.is_depth) require_png(omentum::unpacked_depth_png(value, 1e-4), 16, 0, 0);
    if (topic.is_color) omentum::packed_color_png(value);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size == 0) return 0;
  std::string bytes;
  for (std::size_t k = 1; k < size; ++k) bytes.push_back(static_cast<char>(data[k]));
  const Kind& kind = kKinds[data[0] / 2 % kKinds.size()];
  const bool ros1 = data[0] % 2 == 0;
  const std::size_t zero = std::min(bytes.find('\0'), bytes.size());
  omentum::McapChannel channel;
  channel.topic = kind.topic;
  channel.encoding = ros1 ? "ros1" : "cdr";
  channel.schema.name = kind.type;
  channel.schema.encoding = ros1 ? "ros1msg" : "ros2msg";
  channel.schema.data = zero > 0 ? bytes.substr(0, zero) : std::string(kind.definition) + kHeader;
  omentum::pb::RosMap map;
  omentum::FrameTree tree;
  BagTopic topic(channel, map);
  require(topic.left_out.find('\n') == std::string::npos);
  if (topic.schema == nullptr) return 0;
  omentum::McapView message;
  message.log_time = 1;
  message.data = std::string_view(bytes).substr(std::min(zero + 1, bytes.size()));
  try {
    topic.take(message, 0, tree);
    require(topic.first_damage.find('\n') == std::string::npos);
    topic.settle();
    for (std::size_t role = 0; role < topic.rows.size(); ++role) {
      for (auto& [frame, rows] : topic.rows[role]) {
        const omentum::Series series = topic.rows_of(role, rows);
        require(series.values.size() == series.rows() * series.columns.size());
        const auto X = tree.to_world(frame);
        require(X.has_value() || X.error().find('\n') == std::string::npos);
      }
    }
    if (!topic.frames.empty() && topic.left_out.empty()) make_picture(topic, message.data);
  } catch (const omentum::Error& error) {
    const std::string said = error.what();
    require(!said.empty() && said.find('\n') == std::string::npos);
  }
  return 0;
}

#include "core/cloud_message.h"

#include <google/protobuf/util/time_util.h>

#include <utility>

namespace omentum {

foxglove::PointCloud make_cloud(const float* positions, std::uint32_t points,
                                std::uint64_t time_ns) {
  foxglove::PointCloud cloud;
  *cloud.mutable_timestamp() =
      google::protobuf::util::TimeUtil::NanosecondsToTimestamp(static_cast<std::int64_t>(time_ns));
  cloud.set_frame_id("W");
  cloud.mutable_pose()->mutable_orientation()->set_w(1);
  cloud.set_point_stride(kCloudPointBytes);
  for (const auto& [name, offset] : {std::pair{"x", 0U}, {"y", 4U}, {"z", 8U}}) {
    foxglove::PackedElementField& field = *cloud.add_fields();
    field.set_name(name);
    field.set_offset(offset);
    field.set_type(foxglove::PackedElementField::FLOAT32);
  }
  cloud.set_data(positions, std::size_t{kCloudPointBytes} * points);
  return cloud;
}

}  // namespace omentum

#pragma once

#include <string>
#include <vector>

namespace omentum {

/// The files .mcap of a folder that rosbag2 recorded, in the order of its metadata.yaml; without it
/// NAME_0.mcap, NAME_1.mcap ... of a folder NAME, in the order of their first stamps; none where it
/// is no such folder. Those that it names and that are not there go to `missing`. Throws Error,
/// naming the conversion, where they are compressed as whole files or no MCAP.
std::vector<std::string> parts_of_bag(const std::string& folder,
                                      std::vector<std::string>* missing = nullptr);

/// Throws Error, naming the conversion, for a bag in a container of ROS itself.
[[noreturn]] void refuse_bag_container(const char* kind, const std::string& path);

}  // namespace omentum

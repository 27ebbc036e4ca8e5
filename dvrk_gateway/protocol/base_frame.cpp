#include "dvrk_gateway/protocol/base_frame.h"

#include <array>
#include <cmath>
#include <string_view>

#include "core/check.h"
#include "core/csv.h"

namespace omentum {

Eigen::Isometry3d parse_base_frame(const std::string& text) {
  std::array<double, 7> numbers{};
  std::size_t count = 0;
  bool good = true;
  for (std::string_view rest = text; good; ++count) {
    const std::size_t comma = rest.find(',');
    const std::optional<double> value = parse_number(rest.substr(0, comma));
    good = count < numbers.size() && value && std::isfinite(*value);
    if (good) numbers[count] = *value;
    if (comma == std::string_view::npos) break;
    rest.remove_prefix(comma + 1);
  }
  const Eigen::Quaterniond q(numbers[3], numbers[4], numbers[5], numbers[6]);
  if (!good || count + 1 != numbers.size() || !(std::abs(q.norm() - 1) <= 1e-6)) {
    throw_error("--base-frame {}: allowed x,y,z,qw,qx,qy,qz, metres and a quaternion of length 1",
                text);
  }
  Eigen::Isometry3d X_AR = Eigen::Isometry3d::Identity();
  X_AR.linear() = q.normalized().toRotationMatrix();
  X_AR.translation() = Eigen::Vector3d(numbers[0], numbers[1], numbers[2]);
  return X_AR;
}

}  // namespace omentum

#include "core/recording_info.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <set>
#include <sstream>
#include <string_view>
#include <vector>

#include "core/check.h"
#include "core/config.h"

namespace omentum {
namespace {

constexpr std::array<std::string_view, 8> kUnits = {"m", "s", "N", "rad", "kg", "Nm", "Pa", "Hz"};
constexpr std::array<std::string_view, 9> kFiles = {"tool.csv",   "joints.csv",  "tracker.csv",
                                                    "force.csv",  "markers.csv", "coupon.csv",
                                                    "clouds.csv", "depth.csv",   "color.csv"};

template <typename List>
bool lists(const List& list, std::string_view name) {
  return std::find(list.begin(), list.end(), name) != list.end();
}

/// Tells what is wrong with the fields of a file, each at its place.
class InfoCheck {
 public:
  InfoCheck(const std::string& path, const pb::RecordingInfo& info) : path_(path), info_(info) {}

  void run() const {
    units();
    std::set<std::string> files;
    for (int k = 0; k < info_.transform_size(); ++k) {
      transform(k);
      if (!files.insert(info_.transform(k).file()).second)
        refuse(fmt::format("transform[{}].file", k), "a second transform of {}, allowed one",
               info_.transform(k).file());
    }
    if (info_.frame() != "W" && files.count("tool.csv") == 0)
      refuse("frame", "\"{}\", allowed \"W\", or a transform of tool.csv", info_.frame());
  }

 private:
  template <typename... Args>
  [[noreturn]] void refuse(const std::string& field, fmt::format_string<Args...> format,
                           Args&&... args) const {
    throw_error("{}{}: {}", place_of_field(path_, info_, field), field,
                fmt::format(format, std::forward<Args>(args)...));
  }

  void units() const {
    std::string text = info_.units();
    std::replace(text.begin(), text.end(), ',', ' ');
    std::istringstream words(text);
    const std::vector<std::string> names{std::istream_iterator<std::string>(words), {}};
    if (names.empty()) refuse("units", "\"\", allowed {}", fmt::join(kUnits, ", "));
    for (const std::string& name : names) {
      if (lists(kUnits, name)) continue;
      refuse("units", "\"{}\", allowed {}; other units stand in the names of columns", name,
             fmt::join(kUnits, ", "));
    }
  }

  void transform(int k) const {
    const pb::FileTransform& t = info_.transform(k);
    const std::string name = fmt::format("transform[{}]", k);
    if (!lists(kFiles, t.file()))
      refuse(name + ".file", "\"{}\", allowed {}", t.file(), fmt::join(kFiles, ", "));
    if (t.p_m_size() != 3) refuse(name + ".p_m", "{} numbers, allowed 3", t.p_m_size());
    for (const double p : t.p_m()) {
      if (!(std::fabs(p) <= 100)) refuse(name + ".p_m", "{} m, allowed -100 ... 100 m", p);
    }
    if (t.q_wxyz_size() != 4) refuse(name + ".q_wxyz", "{} numbers, allowed 4", t.q_wxyz_size());
    double square = 0;
    for (const double q : t.q_wxyz()) square += q * q;
    // 1e-3: four numbers written with three digits.
    if (!(std::fabs(std::sqrt(square) - 1) <= 1e-3))
      refuse(name + ".q_wxyz", "length {:.6g}, allowed 1: no rotation", std::sqrt(square));
  }

  const std::string& path_;
  const pb::RecordingInfo& info_;
};

}  // namespace

pb::RecordingInfo read_recording_info(const std::string& folder) {
  pb::RecordingInfo info;
  const std::string path = folder + "/recording.txtpb";
  // A link to nothing is a file that cannot be read, not an absent one.
  std::error_code ignored;
  if (!std::filesystem::exists(std::filesystem::symlink_status(path, ignored))) return info;
  read_text_proto(path, info);
  InfoCheck(path, info).run();
  return info;
}

Eigen::Isometry3d transform_to_world(const pb::RecordingInfo& info, const std::string& file) {
  Eigen::Isometry3d X_WF = Eigen::Isometry3d::Identity();
  for (const pb::FileTransform& t : info.transform()) {
    if (t.file() != file) continue;
    X_WF.translation() = Eigen::Vector3d(t.p_m(0), t.p_m(1), t.p_m(2));
    X_WF.linear() = Eigen::Quaterniond(t.q_wxyz(0), t.q_wxyz(1), t.q_wxyz(2), t.q_wxyz(3))
                        .normalized()
                        .toRotationMatrix();
  }
  return X_WF;
}

}  // namespace omentum

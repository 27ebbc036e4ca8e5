#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// What a point of a cloud may be, by the believed scene.
enum class CloudPart { kTissue, kTool, kBoard, kBackground };

/// How many points of clouds are which.
struct CloudParts {
  std::array<std::size_t, 4> count = {};  ///< by CloudPart
  std::size_t all() const { return count[0] + count[1] + count[2] + count[3]; }
};
/// "30 frames, 36000 points: tissue 83.2 %, tool 2.1 %, board 9.0 %, background 5.7 %"
std::string print_parts(std::size_t frames, const CloudParts& parts);

/// Nothing holds the body: a clamp has none of its particles.
bool lies_free(const Scene& scene);

/// Takes out of a cloud what is no tissue, before anything is fitted to it: the tool around the
/// recorded tip (shaft; jaws between tip and shaft, above the tissue that they hold), the board,
/// and what is farther from the tissue at rest than it can have come. Of a point that may be either
/// the tissue keeps it: over the board only what lies three standard deviations of the sensor below
/// the upper face is board, beside the sheet at rest all in the lower half of its thickness.
class CloudMask {
 public:
  /// `travel`: how far the tip goes from where it began; `registration`: how sure the place of the
  /// camera is [m]. What it may have moved the tissue by is not taken for board.
  CloudMask(const Scene& scene, double travel, double registration);

  /// `tip`: p_WT at the time of the cloud [m].
  CloudPart part_of(const Eigen::Vector3d& p_W, const Eigen::Vector3d& tip) const;

  /// Share of the believed body at rest, in cells of 5 mm seen along z_B, with a point in them. A
  /// lifted part counts where it hangs: with it the share falls.
  double share_seen(std::span<const Eigen::Vector3d> tissue) const;

 private:
  bool on_tool(const Eigen::Vector3d& p_W, const Eigen::Vector3d& tip) const;
  bool on_board(const Eigen::Vector3d& p_W) const;
  std::optional<std::size_t> cell_of(const Eigen::Vector3d& p_W) const;

  Eigen::Isometry3d X_BW_;
  Eigen::AlignedBox3d rest_W_, rest_B_;
  Eigen::Vector3d up_the_shaft_ = Eigen::Vector3d::UnitZ();
  double noise_, height_noise_, thickness_, farthest_, shaft_radius_, shaft_start_;
  std::vector<Eigen::Hyperplane<double, 3>> boards_;  ///< upper side positive
  Eigen::Vector2i cells_;
  std::vector<std::uint8_t> in_body_;  ///< cells that hold a part of the body at rest
};

/// The clouds of a recording (those of its depth images too) against a believed scene.
struct SeenFigures {
  std::size_t frames = 0;
  CloudParts parts;
  std::vector<double> share_seen;  ///< of each frame
};
/// Looks at `most_frames`, evenly chosen. Without a path of the tool nothing is taken for it.
/// Throws Error where a cloud cannot be read.
SeenFigures look_at_clouds(const Recording& recording, const std::string& path, const Scene& scene,
                           std::size_t most_frames);
/// One line for people, and one of the share.
std::string print_seen(const SeenFigures& figures);

/// The scene that a recording states of itself: its scene, else its believed scene. Nothing where
/// it states none, or none with tissue; what is odd is appended to `warnings`. Throws Error.
std::optional<Scene> stated_scene(const Recording& recording, std::vector<std::string>& warnings);

}  // namespace omentum

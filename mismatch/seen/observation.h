#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <cstddef>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/recording/recording.h"
#include "mismatch/seen/cloud_mask.h"
#include "mismatch/simulate/tool_track.h"
#include "sim_worker/playback/simulate.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// What a force sensor showed around a frame.
struct SeenForce {
  Eigen::Vector3d value = Eigen::Vector3d::Zero();  ///< of the tissue on the tool, in W [N]
  double change = 0;                                ///< how fast it changes there [N/s]
};

/// A marker where motion capture saw it.
struct SeenMarker {
  int marker = 0;     ///< of Observation::markers
  Eigen::Vector3d p;  ///< p_W as the cameras have it [m]
};

/// What was seen at one time, as far as it may be tissue: a cloud of a depth camera, or markers.
struct SeenFrame {
  double t = 0;                         ///< on the clock of the camera [s]
  std::vector<Eigen::Vector3d> points;  ///< p_W as the camera has them [m]
  std::optional<SeenForce> force;       ///< less that before the jaws closed
  std::vector<SeenMarker> markers = {};
};

/// A recording as a calibration looks at it.
struct Observation {
  std::string name;
  ToolTrack track;  ///< no longer than the last frame needs
  GraspSettings grasp;
  double period = 0.02;                                ///< of control steps [s]
  Eigen::Vector3d p_WC = Eigen::Vector3d::Zero();      ///< the camera [m]
  Eigen::Matrix3d R_WC = Eigen::Matrix3d::Identity();  ///< x right, y up, looks along -z
  std::vector<SeenFrame> frames;
  std::size_t clouds = 0;                           ///< looked at
  CloudParts parts;                                 ///< of their points
  std::vector<double> share_seen;                   ///< of the believed body, of each of them
  Eigen::Vector2d pinch = Eigen::Vector2d::Zero();  ///< where the jaws close, x_B, y_B at rest [m]
  bool pinched = false;
  int condition = 0;      ///< recordings of one pinch point share it
  bool held_out = false;  ///< scored, never fitted
  std::string repeat_of;
  double clock_sd = 0;  ///< stated uncertainty of the camera's clock [s]; 0: none stated
  /// Names of what may be markers on tissue, the same of all recordings of a fit.
  std::vector<std::string> markers = {};
  std::size_t marker_rows = 0;  ///< in which some are seen
  double marker_noise = 0;      ///< standard deviation of a number of theirs in holds [m]
  bool held = false;            ///< the body is held at the start (pb::HeldStart) and let go
  double released = 0;          ///< then, on the clock of the commands [s]
  std::vector<std::string> overrides = {};  ///< of the scene, for this recording alone
  /// Of clouds whose camera nobody states, fused ones among them, no ray is known.
  bool rays = true;
  /// What lies below is compared with nothing, as the camera has it: colour may not tell a sheet
  /// from the table.
  std::optional<Eigen::Hyperplane<double, 3>> lowest = {};

  bool has_force() const;  ///< at some frame
  bool has_points() const;
};

/// At most so many frames of a recording and points of a frame are looked at, evenly chosen.
inline constexpr std::size_t kMostFrames = 80, kMostPoints = 1200;

/// Indices evenly chosen of so many, at most `most`, the first and the last among them.
std::vector<std::size_t> evenly_chosen(std::size_t count, std::size_t most);

struct MarkerNotes;

/// What of the clouds is looked at.
struct CloudChoice {
  std::size_t skipped = 0;                 ///< clouds of the beginning that are not
  bool fused = false;                      ///< of several cameras: no ray is known
  std::optional<double> above_board = {};  ///< points nearer to the board are not [m]
};

/// Throws Error: no path of the tool, neither cloud nor marker, a cloud that is not in metres or
/// nowhere near the tissue, jaws that never close near it. What is odd is appended to `warnings`.
Observation observe(const std::string& name, const std::string& path, const Recording& recording,
                    const Scene& scene, std::vector<std::string>& warnings);
/// With what is known of its markers, and of chosen clouds.
Observation observe(const std::string& name, const std::string& path, const Recording& recording,
                    const Scene& scene, const MarkerNotes& notes, const CloudChoice& chosen,
                    std::vector<std::string>& warnings);

/// Commands and frames `factor` times as long after time 0; without what was seen.
Observation stretched(const Observation& observation, double factor);
/// The same of a whole recording, whose frames, clouds or images, are `period` apart then (median)
/// [s]. Throws Error where it has less than two. `path`: of the recording.
void set_frame_period(const std::string& path, double period, Recording& recording);

/// At most so many clouds and frames of markers of every recording, the last among them: where a
/// search begins need not be exact.
std::vector<Observation> few_frames(std::vector<Observation> observations, std::size_t most);

/// Of every recording what was seen up to so long after the body was let go, at most so many
/// frames, and of its commands what is done until then. `all`: whether nothing was cut.
struct FirstFrames {
  std::vector<Observation> observations;
  bool all = true;
};
FirstFrames first_frames(std::vector<Observation> observations, double seconds, std::size_t most);

/// Numbers the conditions: recordings whose jaws close within 6 mm of each other are one.
void number_conditions(std::vector<Observation>& observations);

}  // namespace omentum

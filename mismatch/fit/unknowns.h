#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "mismatch/evidence/evidence.h"
#include "proto/prior.pb.h"
#include "proto/scene.pb.h"

namespace omentum {

/// A number that all recordings share and the simulation depends on, as x: 0 where it is believed.
/// Numerics act to first order alone; atoms are held at zero, and only their score is wanted.
struct Unknown {
  enum class Scale {
    kFactor,  ///< value = believed exp(x)
    kChange,  ///< a field that holds a relative change: 1 + value = (1 + believed) exp(x)
    kShift,   ///< value = believed + x
  };
  std::string path;    ///< of the field, "scene.tissue.material.young_modulus_pa"
  std::string unit;    ///< of the value
  std::string column;  ///< name of its derivative (sim_worker/playback/parameters.h); none: empty
  Scale scale = Scale::kFactor;
  double believed = 0;
  double sd = 1;      ///< of x before anything is seen
  std::string prior;  ///< where sd is from, in words
  NumberRole role = NumberRole::kBase;

  bool in_scene() const { return role == NumberRole::kBase; }
  bool simulated() const { return role == NumberRole::kBase || role == NumberRole::kNuisance; }

  double value(double x) const;
  /// dvalue/dx
  double slope(double x) const;
  /// x of a value.
  double at(double value) const;
};

/// The first unknown of every fit is Young's modulus.
inline constexpr int kStiffnessUnknown = 0;

/// Path of the thickness of a sheet, and of the distance of its places.
inline constexpr const char* kThicknessPath = "scene.tissue.thickness_m";
inline constexpr const char* kPitchPath = "scene.tissue.grid.pitch_m";
/// No field, but what the axes of scene.tissue.pose are turned by about z_B [deg].
inline constexpr const char* kTurnPath = "scene.tissue.pose.turn_deg";
/// No number of a scene: time between the frames of all recordings (stretched()).
inline constexpr const char* kFramePeriodPath = "frame_period_s";

/// Stiffness, bending, damping, friction, Poisson's ratio and thickness, as far as the scene can
/// have them, and with a force the density. Stated priors go before those of docs/calibrate.md 2.
std::vector<Unknown> unknowns_of(const pb::Scene& scene, const pb::Priors& priors, bool with_force);

/// Of those the ones that are not looked for because they are believed to be zero, of which every
/// factor is zero, and what to state instead; one line each.
std::vector<std::string> told_not_looked_for(const pb::Scene& scene, const pb::Priors& priors);

/// Appends every other number that a prior names. Throws Error where the scene has none of that
/// path or a factor meets a value that is not positive.
void add_named_unknowns(const pb::Scene& scene, const pb::Priors& priors,
                        std::vector<Unknown>& unknowns);

/// Numbers of a scene that a recording has of its own.
struct OwnNumbers {
  Eigen::Vector2d pinch = Eigen::Vector2d::Zero();  ///< held patch from the tip, x_B, y_B [m]
  double stiffness = 0;                             ///< ln of a factor on E
  double clock = 0;                                 ///< added to the common clock [s]
};

/// Least and largest x that are looked at: three standard deviations, inside the range of the knob.
struct Range {
  double low = 0, high = 0;
};
Range range_of(const Unknown& unknown);

/// A scene for one recording: parameters at x, its own numbers beside them. Values stay inside the
/// range of their knobs. A sheet of another thickness lies on the same board; one of another size
/// or turn has the same part at `about`, in B as believed [m].
pb::Scene scene_at(const pb::Scene& believed, const std::vector<Unknown>& unknowns,
                   const Eigen::VectorXd& x, const OwnNumbers& own,
                   const Eigen::Vector2d& about = Eigen::Vector2d::Zero());

/// The number of a field by its path below the scene; throws Error where there is none.
double scene_number(const pb::Scene& scene, const std::string& path);
void set_scene_number(pb::Scene& scene, const std::string& path, double value);

}  // namespace omentum

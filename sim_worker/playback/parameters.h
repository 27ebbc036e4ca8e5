#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "proto/scene.pb.h"
#include "sim_worker/reference/reference_columns.h"

namespace omentum {

/// A point of the surface as a camera sees it.
struct SeenPoint {
  Eigen::Vector3d p_W, v_W;  ///< [m], [m/s]
  Eigen::Vector3d p_WC;      ///< the camera [m]
};

/// A number that the simulation of a recording is differentiated by, under its name of
/// docs/mismatch.md 1.
struct Parameter {
  enum class Kind {
    kScene,       ///< of the tissue, the grasp or the numerics
    kArm,         ///< of what lies between command and tip
    kToolOffset,  ///< constant offset of the tip along `axis` of W
    kHeldPlace,   ///< of scene.held_start.position_m along `axis` of W
    kSite,        ///< `site`
    kSensor,      ///< `sensor`
  };
  std::string name, unit;  ///< the name with its settings: "viscoelastic.g@tau=0.3"
  Kind kind = Kind::kScene;
  std::vector<std::string> overrides;  ///< of the scene where the parameter is `step` larger
  std::string effect;                  ///< or one of its effects (set_effect) set to `value`
  double value = 0;
  double step = 1;  ///< in `unit`
  int axis = 0;
  ColumnParameter site;
  bool from_all = false;  ///< left out where the scene cannot have it
  Eigen::Vector3d (*sensor)(const SeenPoint& point) = nullptr;  ///< change of the point per unit
};

/// The parameters of a list "name,name@key=value:key=value,...", in its order; "all" is every name
/// that this scene has, "sites" a grid of 7 x 7 places for stiffness, density and force. Throws
/// Error, one line with name and reason, for what is unknown, has no column or is named twice.
std::vector<Parameter> parse_parameters(const std::string& list, const pb::Scene& scene);

/// One line per name: unit, settings; then what has no column, and why.
std::string describe_parameters();

}  // namespace omentum

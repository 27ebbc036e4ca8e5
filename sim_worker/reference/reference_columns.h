#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <array>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "sim_worker/reference/reference_model.h"

namespace omentum {

class ReferenceTissue;

/// How a simulation depends on a number (docs/tissue.md 13).
enum class ColumnKind {
  kScene,          ///< a number of the scene: `changed` differs in it by `step`
  kToolPath,       ///< what moves the tip, told by set_tip_columns()
  kStiffnessSite,  ///< relative change of stiffness at a place, as `inclusion`, unit 1
  kDensitySite,    ///< relative change of density at a place, unit 1
  kForceSite,      ///< force along `axis` of W spread over a place, unit N
  kClampGive,      ///< 1 / K of springs per length of the rigid clamp, unit m^2/N
  kClampFree,      ///< length of a detached piece of it around place.x(), unit m
  kObstacle,       ///< contact stiffness of a sphere that is not there yet, unit Pa/m
  kStartVelocity,  ///< of every free node along `axis` of W (start_moving), unit m/s
};

struct ColumnParameter {
  ColumnKind kind = ColumnKind::kScene;
  /// A model on the same mesh (make_reference_model's `mesh_of`), `step` units of the parameter
  /// away; small against what the simulation is linear over, large against rounding.
  std::shared_ptr<const ReferenceTissueModel> changed;
  double step = 1;
  Eigen::Vector2d place = Eigen::Vector2d::Zero();   ///< of sites: x_B, y_B at rest [m]
  double radius = 0.01;                              ///< of sites and kObstacle [m]
  int axis = 2;                                      ///< of kForceSite, kStartVelocity
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();  ///< of kObstacle, in W [m]
};

/// Throws Error where a scene of this model has no column of a parameter.
void check_column(const ReferenceTissueModel& model, const ColumnParameter& parameter);

/// Weight of a site at a place of the rest sheet: 1 inside, falling smoothly from 3/4 to 5/4 of the
/// radius, as the catalogue's inclusion.
double site_weight(const ColumnParameter& site, const Eigen::Vector3d& p_B);

/// Derivatives of the state of a ReferenceTissue by parameters, carried beside it step by step: one
/// column each. The converged step solves R(x, history; theta) = 0, so a column s = dx/dtheta obeys
///
///   (dR/dx) s = -dR/dtheta - (dR/dhistory) s_history
///
/// with the factor of dR/dx at the converged state. The history are the last two states and, at a
/// grasp, the place of the patch. dR/dtheta is the residual of a tissue of the changed scene that
/// follows the path of the base, with memory, friction and grasp of its own, less that of one of
/// the same scene: both are functions of the path, so the difference is exact to rounding. The base
/// keeps its bits. Friction's limit follows the normal force by a few more solves. One-sided where
/// the base is at a kink: a node that begins to touch or to slip, an effect that only adds.
struct ReferenceColumns {
  ReferenceColumns(std::vector<ColumnParameter> list,
                   const std::shared_ptr<const ReferenceTissueModel>& model);
  ~ReferenceColumns();
  Eigen::Index count() const { return static_cast<Eigen::Index>(parameters.size()); }

  std::vector<ColumnParameter> parameters;
  // Rows: unknowns of the model; columns: parameters.
  RightSides x, v, x_before, v_before;  ///< per unit of the parameter
  RightSides mode;       ///< of the elements, [9 element + mode]; see recover_modes()
  RightSides mode_load;  ///< -dR/dtheta of the modes in the last step
  bool modes_recovered = true;
  RightSides limit_load;  ///< of friction, whose limits follow the normal forces, in the last step
  RightSides pressed;     ///< added to the normal forces of friction where nothing moves, per point
  /// Of the grasp, [3 row + axis]; of a pad force and moment, and the way from the tip to its
  /// centre.
  Eigen::MatrixXd multiplier, offset;
  Eigen::MatrixXd arm;  ///< of the nodes of a pad, [3 node + axis]
  /// Of all nodes at rest, [3 node]: what changes the mesh moves them. Of a clamp that gives way
  /// where its nodes are now.
  Eigen::MatrixXd rest;
  Eigen::Matrix3Xd tip_from, tip_to;  ///< of the tip at the ends of the control step
  bool valid = true;                  ///< false from the first step on that has no columns
  std::string reason;                 ///< of that

  std::unique_ptr<ReferenceTissue> same;                  ///< follows the base in its own scene
  std::vector<std::unique_ptr<ReferenceTissue>> changed;  ///< of kScene, else null
  std::vector<std::uint8_t> same_elements;  ///< per column: its scene changes no element
  /// Pinched kAside further along x_B and y_B: what a parameter that moves the tissue before the
  /// grasp, or the tip, does to the place of the patch, `aside` [m per unit].
  static constexpr double kAside = 1e-7;  // [m]
  std::array<std::unique_ptr<ReferenceTissue>, 2> pinched_aside;
  Eigen::Matrix2Xd aside;
  /// Of the elements in a stiffness site, and the weights of their Gauss points; one list per
  /// parameter.
  using PointWeights = std::array<double, kHexPoints>;
  std::vector<std::vector<std::pair<int, PointWeights>>> site_elements;

  std::vector<std::size_t> clamp_batches;  ///< batches with a clamped node

  // Scratch of a step.
  RightSides x_tilde, loads, next_limit_load, part;
  FrontalCholesky factor;
  std::vector<HexInner> inner;
  std::vector<Eigen::Matrix3d> body_blocks;
  /// Y = L^-1 of the columns that border the matrix, and S Y.
  Eigen::MatrixXd border, signed_border;
  Eigen::PartialPivLU<Eigen::MatrixXd> border_solver;
  Eigen::Matrix<double, 6, 6> softness;  ///< of a pad (reference_pad_columns.cpp)
};

}  // namespace omentum

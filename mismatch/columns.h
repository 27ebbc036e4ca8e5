#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "mismatch/npz.h"
#include "mismatch/parameters.h"
#include "sim_worker/instrument/arm.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// A parameter of a recording, made ready: the tissue's part, or a changed arm.
struct PreparedParameter {
  Parameter parameter;
  ColumnParameter tissue;
  std::shared_ptr<const Arm> arm;  ///< of Kind::kArm
};

/// Derivatives of what a recording would hold, written while it is simulated (docs/formats.md 3):
/// of the upper face of the sheet at the places of its grid, and of the force on the tool. One
/// thread; several recordings at a time may each have their own.
class ColumnRecorder {
 public:
  /// `base`: the arm of the scene. Frames go to a file in `folder`, not into memory.
  ColumnRecorder(std::vector<PreparedParameter> parameters, const Scene& scene,
                 std::shared_ptr<const ReferenceTissueModel> model, const Arm& base,
                 std::string folder, std::size_t frames);

  /// The tissue carries the columns from here on; arms at rest at the tip. Throws Error.
  void begin(ReferenceTissue& tissue, const Eigen::Vector3d& tip);
  /// Before the grasps of a control step, whose command ends at `tip`.
  void begin_step(ReferenceTissue& tissue, const Eigen::Vector3d& tip);
  /// The state at time t [s] is the next frame.
  void add_frame(double t, const ReferenceTissue& tissue);
  /// columns.npz in the folder; frames that never came are NaN. Throws Error.
  void finish();
  std::size_t frames() const { return time_.size(); }
  /// Why there are none from some time on; empty where there are.
  const std::string& failure() const { return failure_; }
  /// Parameters whose columns end before the others', a line each.
  const std::vector<std::string>& warnings() const { return warnings_; }

 private:
  Eigen::Matrix3Xd tip_columns();

  std::vector<PreparedParameter> parameters_;
  std::shared_ptr<const ReferenceTissueModel> model_;
  const Arm& base_;
  Eigen::Vector3d camera_;
  std::string folder_;
  std::size_t planned_;
  std::vector<double> uv_;
  ArmState base_arm_{};
  std::vector<ArmState> arms_;       ///< one per parameter; those of other kinds unused
  std::vector<std::uint8_t> ended_;  ///< per parameter: warned of
  Eigen::Matrix3Xd tip_;             ///< of the columns, now
  std::vector<double> time_, force_;
  std::string failure_;
  std::vector<std::string> warnings_;
  NpyFile upper_;
};

}  // namespace omentum

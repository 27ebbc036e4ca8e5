#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "sim_worker/instrument/arm.h"
#include "sim_worker/playback/npz.h"
#include "sim_worker/playback/parameters.h"
#include "sim_worker/reference/reference_tissue.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// A parameter of a recording, made ready: the tissue's part, or a changed arm.
struct PreparedParameter {
  Parameter parameter;
  ColumnParameter tissue;
  std::shared_ptr<const Arm> arm;  ///< of Kind::kArm
};

/// Derivatives of what a recording would hold, carried beside its simulation. One thread; several
/// recordings at a time may each have their own.
class ColumnCarrier {
 public:
  /// `base`: the arm of the scene.
  ColumnCarrier(std::vector<PreparedParameter> parameters, const Scene& scene,
                std::shared_ptr<const ReferenceTissueModel> model, const Arm& base);
  virtual ~ColumnCarrier() = default;

  /// The tissue carries the columns from here on; arms at rest at the tip. Throws Error.
  void begin(ReferenceTissue& tissue, const Eigen::Vector3d& tip);
  /// The state at time t [s], after so many control steps.
  void add_state(std::size_t step, double t, const ReferenceTissue& tissue);
  /// Before the grasps of a control step, whose command ends at `tip`.
  void begin_step(ReferenceTissue& tissue, const Eigen::Vector3d& tip);
  /// While tissue is held at the start (HeldBody), whose place alone moves it then.
  void hold_at_start(ReferenceTissue& tissue) const;
  /// Why there are none from some time on; empty where there are.
  const std::string& failure() const { return failure_; }
  /// Parameters whose columns end before the others', a line each.
  const std::vector<std::string>& warnings() const { return warnings_; }

 protected:
  virtual bool wants(std::size_t step) const = 0;
  /// A state that is wanted and has columns.
  virtual void take(std::size_t step, double t, const ReferenceTissue& tissue) = 0;
  /// Derivatives of a face of the tissue at the places of the grid, of each parameter
  /// [3 point + axis].
  std::vector<std::vector<float>> columns_at(std::vector<BodyPoint> ReferenceTissueModel::*face,
                                             const ReferenceTissue& tissue) const;
  /// Warns of parameters whose columns are no numbers any more.
  void tell_ends(double t, const std::vector<std::vector<float>>& values);
  const std::vector<PreparedParameter>& parameters() const { return parameters_; }
  const ReferenceTissueModel& model() const { return *model_; }

 private:
  Eigen::Matrix3Xd tip_columns();

  std::vector<PreparedParameter> parameters_;
  std::shared_ptr<const ReferenceTissueModel> model_;
  const Arm& base_;
  Eigen::Vector3d camera_;
  ArmState base_arm_{};
  std::vector<ArmState> arms_;       ///< one per parameter; those of other kinds unused
  std::vector<std::uint8_t> ended_;  ///< per parameter: warned of
  Eigen::Matrix3Xd tip_;             ///< of the columns, now
  std::string failure_;
  std::vector<std::string> warnings_;
};

/// Writes them while the recording is simulated (docs/formats.md 3): of the upper face of the sheet
/// at the places of its grid, and of the force on the tool, every `stride` control steps.
class ColumnRecorder : public ColumnCarrier {
 public:
  /// Frames go to a file in `folder`, not into memory.
  ColumnRecorder(std::vector<PreparedParameter> parameters, const Scene& scene,
                 std::shared_ptr<const ReferenceTissueModel> model, const Arm& base,
                 std::string folder, std::size_t frames, std::size_t stride);
  /// columns.npz in the folder; frames that never came are NaN. Throws Error.
  void finish();
  std::size_t frames() const { return time_.size(); }

 protected:
  bool wants(std::size_t step) const override { return step % stride_ == 0; }
  void take(std::size_t step, double t, const ReferenceTissue& tissue) override;

 private:
  std::string folder_;
  std::size_t planned_, stride_;
  std::vector<double> uv_;
  std::vector<double> time_, force_;
  NpyFile upper_;
};

/// Derivatives of one state, held in memory.
struct StateColumns {
  /// Of each parameter, of the upper and then the lower face at the places of the grid
  /// [3 point + axis].
  std::vector<std::vector<float>> surface;
  std::vector<Eigen::Vector3d> force;  ///< of each parameter, on the tool [N]
};

/// Keeps the columns at chosen control steps.
class ColumnKeeper : public ColumnCarrier {
 public:
  ColumnKeeper(std::vector<PreparedParameter> parameters, const Scene& scene,
               std::shared_ptr<const ReferenceTissueModel> model, const Arm& base,
               std::vector<std::size_t> steps);
  std::map<std::size_t, StateColumns> kept;  ///< by control step

 protected:
  bool wants(std::size_t step) const override;
  void take(std::size_t step, double t, const ReferenceTissue& tissue) override;

 private:
  std::vector<std::size_t> steps_;  ///< ascending
};

}  // namespace omentum

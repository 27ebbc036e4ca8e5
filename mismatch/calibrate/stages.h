#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "mismatch/calibrate/calibration.h"
#include "mismatch/calibrate/descent.h"
#include "mismatch/calibrate/surface_fit.h"

namespace omentum {

/// A calibration in its stages, each a function of the one before: those that all models share.
class Stages {
 public:
  /// `plan`: work of its stages, in simulations of all recordings without derivatives.
  Stages(std::unique_ptr<SurfaceFit> fit, const CalibrationOptions& options,
         const std::string& method, std::vector<double> plan);
  virtual ~Stages() = default;
  Stages(const Stages&) = delete;
  Stages& operator=(const Stages&) = delete;

  Calibration run();

 protected:
  using Which = std::vector<std::size_t>;

  /// All up to where the numbers and their covariances stand. Begins its stages.
  virtual void fit_recordings() = 0;
  /// How the answer is simulated.
  virtual Numerics fine() const = 0;

  void next_stage();
  void say(const std::string& stage, double passes);
  void warn_of_missing(std::size_t r, const Prediction& prediction, const std::string& where);
  std::vector<Prediction> begin_descent(const SimulateState& simulate, bool told);
  void bind_markers(const Numerics& numerics);
  void descend(const Numerics& numerics, int most, double small, double work,
               const std::string& stage);
  void take(Descent d);
  void measure_step(double fall);
  void settle_beliefs();
  void settle(double work);
  double numerics() const;
  /// What the numerics may be off by, part by part.
  virtual void tell_numerics();

  const std::unique_ptr<SurfaceFit> owned_fit_;
  SurfaceFit& fit_;
  CalibrationOptions options_;
  Which fitted_;  ///< recordings that can be simulated
  Calibration result_;
  FitState state_, at_;  ///< `at_`: where predictions_ were simulated
  std::vector<Prediction> predictions_;
  ArrowStep sure_;
  Range clock_;          ///< of 90 % of the camera's [s]
  bool settled_ = true;  ///< the last descend() came to rest
  double mesh_rms_ = 0, step_rms_ = 0, law_rms_ = 0;

 private:
  void drop_failing(const std::vector<Prediction>& predictions, bool told);
  std::map<int, Which> conditions() const;
  void add_marker_table(std::size_t r, const Prediction& prediction, const FitState& at,
                        const FitState& state);
  void collect_fit();
  void place_held(const Which& left, FitState& state);
  void predict_unseen(const Which& left, const FitState& without, const std::string& role);
  void leave_out();
  void collect();

  std::vector<Prediction> base_;  ///< as believed
  std::vector<double> plan_;
  std::size_t stage_ = 0;            ///< of the plan
  double done_ = 0, stage_end_ = 0;  ///< passes
};

}  // namespace omentum

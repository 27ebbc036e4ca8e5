#pragma once

#include <array>
#include <vector>

#include "mismatch/fit/fit_data.h"

namespace omentum {

/// A model that recordings are simulated by, and where its derivatives are from. One fit's: what it
/// learns on the way of friction that is too sharp, or of steps, stays with that fit.
class ForwardModel {
 public:
  virtual ~ForwardModel() = default;

  /// Surfaces of the recordings in `which` at a state, others stay empty; with the derivatives of
  /// the model and those of FitData::differences. A recording that cannot be simulated has no valid
  /// frames, and the reason as its failure. Does not depend on the number of threads.
  std::vector<Prediction> simulate(const FitData& data, const FitState& state,
                                   const Numerics& numerics, bool with_columns, const Which& which);
  /// The same with derivatives.
  Linearisation linearise(const FitData& data, const FitState& state, const Numerics& numerics,
                          const Which& which);

 private:
  virtual std::vector<Prediction> predict_all(const FitData& data, const FitState& state,
                                              const Numerics& numerics, bool with_columns,
                                              const Which& which) = 0;
};

/// The converged solid and its columns. Where a recording cannot be simulated all are tried with
/// smoother friction, which stays if it helps. By the place of a pad the derivatives are
/// differences of simulations, made once for a mesh and some frames.
class ReferenceForward : public ForwardModel {
 public:
  /// Derivatives by the place of a pad are made anew, where it is now.
  void forget_pads() { pad_columns_.clear(); }

 private:
  std::vector<Prediction> predict_all(const FitData& data, const FitState& state,
                                      const Numerics& numerics, bool with_columns,
                                      const Which& which) override;

  void add_pad_columns(const FitData& data, const FitState& state, const Numerics& numerics,
                       const Which& which, std::vector<Prediction>& predictions);

  double slip_speed_ = 0;  ///< of friction, where the scene's is too sharp to be solved [m/s]
  /// Of recordings [recording][frame][axis] by the place of the pad, on the mesh `pad_elements_`.
  std::vector<std::vector<std::array<Eigen::VectorXf, kOwnColumns>>> pad_columns_;
  std::array<int, 3> pad_elements_ = {};
};

/// Of a step in the logarithm of the stiffness, which should change nothing that is seen.
inline constexpr double kRoundingStep = 1e-6;

/// The shell of the scene, whose derivatives are differences of simulations. So any number of the
/// scene that a prior names can be looked for, and the time between frames. Where the jaws closed
/// is as recorded: on one recording of a free sheet that cannot be told from where it lay.
class ShellForward : public ForwardModel {
 public:
  /// Steps of the differences from now on move the sheet so many times as far as rounding does,
  /// where that is less than half a standard deviation of the belief; 5 at first.
  void set_step_over_rounding(double ratio) { step_over_rounding_ = ratio; }

 private:
  std::vector<Prediction> predict_all(const FitData& data, const FitState& state,
                                      const Numerics& numerics, bool with_columns,
                                      const Which& which) override;
  double step_of(const FitData& data, std::size_t number) const;

  double step_over_rounding_ = 5;
  std::vector<double> moved_;  ///< what a step of 1 in each number moves [m, rms]; 0: not known
  double rounding_ = 0;        ///< what a step that should move nothing does [m, rms]
};

/// What the shell looks for: the numbers of the reference, those that a prior names and the time
/// between frames, but none that is known well, since each costs a simulation at every state.
/// Throws Error for a body that is held at its start.
std::vector<Unknown> shell_unknowns(const FitData& data);

}  // namespace omentum

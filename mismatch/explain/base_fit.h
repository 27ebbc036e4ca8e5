#pragma once

#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "mismatch/calibrate/calibration.h"
#include "mismatch/explain/candidates.h"
#include "mismatch/explain/left_out_gains.h"
#include "mismatch/fit/forward_model.h"
#include "mismatch/fit/search.h"

namespace omentum {

struct ExplainOptions : FitSetup {
  double tolerance_m = 6e-4;         ///< of the mesh of surfaces; rms error
  double coarse_tolerance_m = 2e-3;  ///< of the mesh of columns and of the search
  double floor_factor = 0.5;         ///< f of docs/mismatch.md 5.2
  double discrepancy_m = 3e-4;       ///< stated rms of the smooth discrepancy at full lift
  Thresholds thresholds = {6, 2, 1, 5, true};  ///< docs/decisions/0046-dispersion.md
  std::vector<std::string> ruled_out;          ///< effects that the user excludes
  std::uint64_t seed = 1;
  ProgressOf progress;
};

/// The believed scene refitted to recordings before anything is blamed (docs/mismatch.md 5.6).
struct BaseFit {
  explicit BaseFit(FitData fitted_data) : data(std::move(fitted_data)) {}
  FitData data;  ///< after add_columns() with numerics and candidates among the unknowns
  Numerics fine, coarse;
  double discrepancy_m = 0;  ///< stated
  Which fitted, held_out;
  SearchState found;
  SearchLimits limits;
  std::vector<Prediction> surfaces;         ///< of all recordings at `found`, on the fine mesh
  std::vector<Prediction> coarse_surfaces;  ///< the same on the coarse one
  Which failed;                             ///< recordings that cannot be simulated to their end
  /// Of every frame of every recording; the fit does not see them.
  std::vector<std::vector<std::optional<SeenForce>>> forces;
  /// Unknowns whose column is that of the pinch along x_B or y_B: displaced alike in all
  /// recordings.
  std::vector<std::pair<Eigen::Index, int>> pinch_atoms;
  /// Unknown whose column is that of the clocks: an arm that is late shows everything late.
  std::optional<Eigen::Index> delay_atom;
};

/// Looks at every recording; those that are held out are simulated at numbers that never saw them.
/// Throws Error where nothing can be fitted.
BaseFit fit_base(const pb::Scene& scene, std::vector<Observation> observations,
                 const ExplainOptions& options, ReferenceForward& model);

/// Numerics and candidates join the unknowns, at zero, with differences of simulations as columns
/// where there is no other. Candidates that cannot be simulated are left out of both and returned.
std::vector<Candidate> add_columns(std::vector<Candidate>& candidates,
                                   const ExplainOptions& options, ReferenceForward& model,
                                   BaseFit& base);

/// All recordings, fitted and held out.
Which all_recordings(const BaseFit& base);

/// Surfaces of the fine mesh with columns of the coarse one, of recordings in `which`.
Linearisation with_columns(const BaseFit& base, ReferenceForward& model, const Which& which);

/// Evidence of every recording at `base.found`, with all candidates. `model` simulates columns on
/// the coarse mesh; recordings one after the other, so that columns of few are held at a time.
std::vector<Evidence> gather_evidence(const BaseFit& base, ReferenceForward& model,
                                      const ExplainOptions& options);

/// How much of a step is taken whose end is simulated: after one that fitted worse as much as
/// gains most by the parabola through what was foretold and what was found, twice as much again
/// after one that fitted better.
class StepLength {
 public:
  /// A new step, which gains so many nats as a whole where surfaces are linear.
  void aim(double foretold);
  double share() const { return share_; }
  /// Whether the step stands that gained so many nats; not finite: it could not be simulated.
  bool accept(double gained);
  bool refused() const { return refused_; }  ///< the last one
  bool settled() const { return settled_; }  ///< nothing is left to gain

 private:
  static constexpr double kSettled = 0.2;  // [nats] what can gain no more is not simulated
  double share_ = 1, foretold_ = 0;
  int refusals_ = 0;
  bool refused_ = false, settled_ = false;
};

/// The way from one state to another, a share of it.
FitState between(const FitState& from, const FitState& to, double share);

/// Whether nearly all frames of the recordings in `which` are there that `before` has.
bool is_simulated(const std::vector<Prediction>& now, const std::vector<Prediction>& before,
                  const Which& which);

/// Surfaces of the fine mesh with an effect, moved by what those of `base` are extrapolated by:
/// what an effect changes is less smooth, and its errors do not fall as fast with the cells.
std::vector<Prediction> extrapolated_as_base(const BaseFit& base, std::vector<Prediction> fine);

/// `other` as a change from `coarse`, put on top of `fine`: what a coarse mesh says of a change.
std::vector<Prediction> changed_surfaces(const std::vector<Prediction>& fine,
                                         const std::vector<Prediction>& coarse,
                                         const std::vector<Prediction>& other);

}  // namespace omentum

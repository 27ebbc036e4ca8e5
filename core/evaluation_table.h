#pragma once

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/csv.h"
#include "core/result.h"
#include "core/types.h"

// The tables of an evaluation (docs/formats.md 7) and every figure that is told of them. Learner
// and report count here, so that console, summary.json, table and report agree.

namespace omentum {

/// Share of the best grasp's exposure that counts as exposed.
inline constexpr double kExposedShare = 0.9;

/// How one episode ended: a row of evaluation/<set>.csv.
struct EvaluationRow {
  std::uint32_t index = 0;            ///< start of the set; of the grasp lattice: the particle
  std::uint32_t row = 0, column = 0;  ///< from 1, row 1 at the anchored edge; 0 on the lattice
  std::array<double, 3> start{};      ///< tip in W [m]; lattice of a grid: rest position in B [m]
  bool greedy = false;
  bool reached = false;     ///< tissue held within success_radius of p_T at some step
  bool held = false;        ///< at the end of the hold
  bool grasp_held = false;  ///< tissue was grasped and never lost
  bool exposed = false;     ///< is_exposed()
  bool lost = false;
  bool failed = false;            ///< the simulation diverged; all above is false then
  double exposure = 0;            ///< after the hold
  double best_exposure = 0;       ///< of the grasp lattice; 0 = none was evaluated
  double episode_return = 0;      ///< of the policy's decisions, hold left out
  std::uint32_t length = 0;       ///< decisions until reached or ended, hold left out
  std::array<double, 3> grasp{};  ///< tip at the first grasp in W [m], NaN if none
  /// Value of the parameter that alone was drawn for the scene, in its unit; NaN if none
  double drawn = std::numeric_limits<double>::quiet_NaN();
};

/// What the one episode of a segment says: all fields but index, row, column, greedy and those of
/// exposure measured by the best. `failed` where the segment is or has no episode.
EvaluationRow row_of_episode(const RolloutSegment& segment);

/// Reached, held, and of at least kExposedShare of the best grasp's exposure; false without one.
bool is_exposed(const EvaluationRow& row, double best_exposure);

/// What is told of a table.
struct EvaluationFigures {
  std::uint64_t starts = 0, target_reached = 0, held = 0, grasp_held = 0, exposed = 0, lost = 0,
                failed = 0;
  double mean_exposure = 0;  ///< over all starts; 0 without any
  double mean_return = 0;    ///< over all starts; 0 without any
};
EvaluationFigures figures_of(std::span<const EvaluationRow> rows);

/// The grasp that the exposures of a run are measured by: most exposure among those that reached
/// p_T and kept the tissue. Nothing if none did.
std::optional<std::size_t> best_grasp(std::span<const EvaluationRow> lattice);

/// Text of a table: of a start grid, or of the grasp lattice.
std::string grid_table(std::span<const EvaluationRow> rows);
std::string lattice_table(std::span<const EvaluationRow> rows);

/// Reads either back. Fails with path:line[:character] on a cell that is no number and on a missing
/// column of those that all tables have had: index or particle, exposure, reached.
Result<std::vector<EvaluationRow>> read_evaluation(const CsvTable& table);

}  // namespace omentum

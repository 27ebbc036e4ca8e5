#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <ctime>
#include <limits>
#include <map>

#include "core/check.h"
#include "mismatch/calibrate/calibration.h"
#include "mismatch/calibrate/genetic_search.h"
#include "mismatch/calibrate/number_words.h"
#include "mismatch/fit/search.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

// Bounds of the search (docs/calibrate.md 5): the paper takes them from another one, unprinted.
constexpr double kSpacingLow = 1, kSpacingHigh = 7;    // of the distance of particles
constexpr double kRadiusLow = 1.2, kRadiusHigh = 2.5;  // of the spacing
constexpr double kStiffnessLow = 0.05, kStiffnessHigh = 0.9;
constexpr double kFarPoint = 0.03;  // [m] from the surface: no tissue, in figures of fit
constexpr double kNoShape = 1.0;    // [m] cost of numbers with orphans or of tissue that fails

double between(double low, double high, double share) { return low + (high - low) * share; }

pb::Scene scene_of(const pb::Scene& believed, const Candidate& candidate) {
  pb::Scene scene = believed;
  const double pitch = believed.tissue().grid().pitch_m();
  pb::ClusterModel& cluster = *scene.mutable_tissue()->mutable_cluster();
  const double spacing = pitch * between(kSpacingLow, kSpacingHigh, candidate.gene[0]);
  cluster.set_cluster_spacing_m(spacing);
  cluster.set_cluster_radius_m(spacing * between(kRadiusLow, kRadiusHigh, candidate.gene[1]));
  cluster.set_cluster_stiffness(between(kStiffnessLow, kStiffnessHigh, candidate.gene[2]));
  cluster.set_orphan_policy(pb::ORPHANS_REJECT);
  return scene;
}

/// Points in cells, for the nearest one.
class PointGrid {
 public:
  PointGrid(const std::vector<Vector3d>& points, std::size_t most) {
    const std::size_t wanted = std::min(points.size(), most);
    for (std::size_t k = 0; k < wanted; ++k) {
      const Vector3d& p = points[wanted > 1 ? k * (points.size() - 1) / (wanted - 1) : 0];
      cells_[key(p)].push_back(p);
      box_.extend(p);
    }
  }
  double distance(const Vector3d& q) const {
    // Rings of cells until no nearer point can come.
    double least = std::numeric_limits<double>::infinity();
    const double outside = box_.exteriorDistance(q);
    const int farthest = static_cast<int>((outside + box_.diagonal().norm()) / kCell) + 1;
    const std::array<int, 3> at = key(q);
    for (int ring = static_cast<int>(outside / (kCell * std::sqrt(3.0))); ring <= farthest;
         ++ring) {
      if (least <= (ring - 1) * kCell) break;
      for (int x = -ring; x <= ring; ++x) {
        for (int y = -ring; y <= ring; ++y) {
          const bool inside = std::abs(x) < ring && std::abs(y) < ring;
          for (int z = -ring; z <= ring; z += inside && ring > 0 ? 2 * ring : 1) {
            const auto found = cells_.find({at[0] + x, at[1] + y, at[2] + z});
            if (found == cells_.end()) continue;
            for (const Vector3d& p : found->second) least = std::min(least, (p - q).norm());
          }
        }
      }
    }
    return least;
  }

 private:
  static constexpr double kCell = 0.004;  // [m]
  static std::array<int, 3> key(const Vector3d& p) {
    std::array<int, 3> k{};
    for (int axis = 0; axis < 3; ++axis)
      k[static_cast<std::size_t>(axis)] = static_cast<int>(std::floor(p[axis] / kCell));
    return k;
  }
  std::map<std::array<int, 3>, std::vector<Vector3d>> cells_;
  Eigen::AlignedBox3d box_;
};

double rms_of(const std::vector<double>& distances) {
  double squares = 0, count = 0;
  for (const double d : distances) {
    if (!std::isfinite(d)) continue;
    squares += d * d;
    ++count;
  }
  return count > 0 ? std::sqrt(squares / count) : 0;
}

/// What a candidate makes of every recording.
struct Tried {
  Candidate candidate;
  std::vector<double> cost;  ///< per recording, sum over its frames of the mean distance [m]
};

class PaperSearch {
 public:
  PaperSearch(const pb::Scene& scene, std::vector<Observation> observations,
              const CalibrationOptions& options)
      : data_(make_fit_data(scene, std::move(observations), options)),
        scene_(scene),
        options_(options) {
    if (!scene.tissue().has_grid())
      throw_error("--method paper: scene.tissue has no grid: clusters of a sheet are looked for");
    for (std::size_t r = 0; r < data_.observations.size(); ++r) {
      if (!data_.observations[r].held_out) fitted_.push_back(r);
    }
    if (!std::ranges::all_of(data_.observations, &Observation::has_points))
      throw_error(
          "--method paper: a recording without clouds, which it compares; markers are none");
    if (fitted_.empty()) throw_error("every recording is held out: nothing can be fitted");
    for (const Observation& o : data_.observations) {
      std::vector<PointGrid>& grids = grids_.emplace_back();
      for (const SeenFrame& frame : o.frames)
        grids.emplace_back(frame.points, data_.made.tissue.particles.size());
    }
  }

  Calibration run();

 private:
  Prediction simulate(const pb::Scene& scene, std::size_t r) const {
    return predict(data_.observations[r], scene, options_.folder, {}, {}, 0,
                   {pb::TISSUE_CLUSTER, 0, 1}, false, *data_.setup.simulator);
  }
  Prediction simulate_or_throw(const pb::Scene& scene, std::size_t r) const {
    Prediction prediction = simulate(scene, r);
    if (prediction.refused) throw_error("{}", prediction.failure);
    return prediction;
  }
  /// From the points of every frame to the surface [m].
  std::vector<std::vector<double>> distances_of(const Prediction& prediction, std::size_t r) const {
    const FitState state = believed_state(data_);
    Linearisation linear{state, std::vector<Prediction>(data_.observations.size())};
    linear.predictions[r] = prediction;
    return distances(data_, linear, state, r, kFarPoint);
  }
  double cost_of(const Prediction& prediction, std::size_t r) const;
  void judge(std::vector<Candidate>& candidates);
  const Tried& best_of(const std::vector<std::size_t>& which) const;
  void score(const std::vector<std::size_t>& left, const Candidate& candidate,
             const std::string& role, Calibration& result);

  FitData data_;
  pb::Scene scene_;
  CalibrationOptions options_;
  std::vector<std::size_t> fitted_;
  std::vector<std::vector<PointGrid>> grids_;
  std::vector<Tried> tried_;
  GeneticSettings settings_;
  std::size_t orphans_ = 0;
};

/// Equation 3 of one pinch point, divided by the particles: sum over the levels [m].
double PaperSearch::cost_of(const Prediction& prediction, std::size_t r) const {
  double sum = 0;
  const std::size_t particles = data_.made.tissue.particles.size();
  for (std::size_t f = 0; f < prediction.frames.size(); ++f) {
    const PredictedFrame& frame = prediction.frames[f];
    if (!frame.valid) {
      sum += kNoShape;
      continue;
    }
    for (std::size_t m = 0; m < particles; ++m) {
      const Vector3d middle = 0.5 * (frame.vertices[m] + frame.vertices[m + particles]);
      sum += grids_[r][f].distance(middle) / static_cast<double>(particles);
    }
  }
  return sum;
}

void PaperSearch::judge(std::vector<Candidate>& candidates) {
  const std::size_t jobs = candidates.size() * fitted_.size();
  std::vector<std::vector<double>> costs(candidates.size(),
                                         std::vector<double>(data_.observations.size(), 0));
  std::vector<std::uint8_t> orphans(candidates.size(), 0);
  run_parallel(jobs, data_.setup.simulator->at_once(), [&](std::size_t job) {
    const std::size_t c = job / fitted_.size(), r = fitted_[job % fitted_.size()];
    const Prediction prediction = simulate(scene_of(scene_, candidates[c]), r);
    costs[c][r] = cost_of(prediction, r);
    if (prediction.refused) orphans[c] = 1;  // particles in no cluster
  });
  for (std::size_t c = 0; c < candidates.size(); ++c) {
    candidates[c].cost = 0;
    for (const std::size_t r : fitted_) candidates[c].cost += costs[c][r];
    orphans_ += orphans[c];
    tried_.push_back({candidates[c], costs[c]});
  }
  if (options_.progress) {
    const double planned = static_cast<double>(settings_.population) +
                           static_cast<double>(settings_.generations - 1) *
                               static_cast<double>(settings_.population - 2);
    options_.progress(std::min(0.95, static_cast<double>(tried_.size()) / planned), "generations");
  }
}

/// The candidate with the least error over some recordings; of equals the first tried.
const Tried& PaperSearch::best_of(const std::vector<std::size_t>& which) const {
  const Tried* best = nullptr;
  double least = 0;
  for (const Tried& tried : tried_) {
    double cost = 0;
    for (const std::size_t r : which) cost += tried.cost[r];
    if (best != nullptr && !(cost < least)) continue;
    best = &tried;
    least = cost;
  }
  return *best;
}

void PaperSearch::score(const std::vector<std::size_t>& left, const Candidate& candidate,
                        const std::string& role, Calibration& result) {
  for (const std::size_t r : left) {
    const Prediction base = simulate_or_throw(scene_, r);
    const Prediction model = simulate_or_throw(scene_of(scene_, candidate), r);
    FitRow row;
    row.recording = data_.observations[r].name;
    row.role = role;
    const auto rms = [&](const Prediction& p, double* mean) {
      double squares = 0, sum = 0, count = 0;
      for (const auto& frame : distances_of(p, r)) {
        for (const double d : frame) {
          if (!std::isfinite(d)) continue;
          squares += d * d;
          sum += std::fabs(d);
          ++count;
        }
      }
      if (mean != nullptr && count > 0) *mean = sum / count;
      return count > 0 ? std::sqrt(squares / count) : 0;
    };
    row.rmse_base = rms(base, nullptr);
    row.rmse_model = rms(model, &row.mean_model);
    row.paper = cost_of(model, r) / static_cast<double>(grids_[r].size());
    result.fit.push_back(row);
    if (role == "left_out") {
      pb::Scene scene = scene_of(scene_, candidate);
      scene.mutable_tissue()->set_model(pb::TISSUE_CLUSTER);
      result.left_out.push_back({row.recording, scene});
    }
    if (role != "fitted") continue;
    ShownRecording shown;
    shown.name = row.recording;
    for (std::size_t f = 0; f < base.frames.size(); ++f) {
      if (!base.frames[f].valid || !model.frames[f].valid) continue;
      const Observation& seen = data_.observations[r];
      shown.times.push_back(seen.frames[f].t);
      shown.before.push_back(base.frames[f].vertices);
      shown.after.push_back(model.frames[f].vertices);
      shown.tip.push_back(model.frames[f].tip);
      shown.seen.push_back(seen.frames[f].points);
      shown.rmse_before.push_back(rms_of(distances_of(base, r)[f]));
      shown.rmse_after.push_back(rms_of(distances_of(model, r)[f]));
    }
    result.shown.push_back(std::move(shown));
  }
}

Calibration PaperSearch::run() {
  const std::clock_t begin = std::clock();
  settings_.seed = options_.seed;
  search_genetically(settings_, [&](std::vector<Candidate>& c) { judge(c); });
  Calibration result;
  result.method = "paper";
  const Tried& best = best_of(fitted_);
  if (best.candidate.cost >= kNoShape)
    throw_error("--method paper: no candidate holds all particles and stays whole");
  // A fold's winner is the best of all candidates on the other pinch points: no search of its own.
  std::map<int, std::vector<std::size_t>> groups;
  for (const std::size_t r : fitted_) groups[data_.observations[r].condition].push_back(r);
  std::vector<const Tried*> winners = {&best};
  score(fitted_, best.candidate, "fitted", result);
  if (groups.size() > 1 && options_.leave_out) {
    for (const auto& [condition, left] : groups) {
      std::vector<std::size_t> others;
      for (const std::size_t r : fitted_) {
        if (data_.observations[r].condition != condition) others.push_back(r);
      }
      winners.push_back(&best_of(others));
      score(left, winners.back()->candidate, "left_out", result);
    }
  }
  std::vector<std::size_t> held;
  for (std::size_t r = 0; r < data_.observations.size(); ++r) {
    if (data_.observations[r].held_out) held.push_back(r);
  }
  score(held, best.candidate, "held_out", result);
  const auto field = [](const pb::Scene& scene, std::size_t g) {
    const pb::ClusterModel& cluster = scene.tissue().cluster();
    return g == 0   ? cluster.cluster_spacing_m()
           : g == 1 ? cluster.cluster_radius_m()
                    : cluster.cluster_stiffness();
  };
  constexpr std::array<const char*, 3> kNames = {"scene.tissue.cluster.cluster_spacing_m",
                                                 "scene.tissue.cluster.cluster_radius_m",
                                                 "scene.tissue.cluster.cluster_stiffness"};
  for (std::size_t g = 0; g < 3; ++g) {
    CalibratedNumber number;
    number.name = kNames[g];
    number.unit.assign(1, g < 2 ? 'm' : '1');
    number.value = field(scene_of(scene_, best.candidate), g);
    number.low90 = number.high90 = number.value;
    for (const Tried* winner : winners) {
      const double value = field(scene_of(scene_, winner->candidate), g);
      number.low90 = std::min(number.low90, value);
      number.high90 = std::max(number.high90, value);
    }
    Candidate low, high;
    high.gene = {1, 1, 1};
    number.prior_low90 = field(scene_of(scene_, low), g);
    number.prior_high90 = field(scene_of(scene_, high), g);
    number.prior_value = field(scene_, g);
    number.prior_source = "bounds of docs/calibrate.md 5; interval: winners without a pinch point";
    constexpr double kBound = 0.01;
    number.at_bound = best.candidate.gene[g] < kBound || best.candidate.gene[g] > 1 - kBound;
    if (number.at_bound) {
      result.warnings.push_back(
          fmt::format("{}: {} is at the bound of the search", number.name, told(number)));
    }
    result.parameters.push_back(number);
  }
  NumberGroup group;
  group.name = "stiffness of the clusters";
  group.unit.assign(1, '1');
  group.value = result.parameters[2].value;
  group.low90 = result.parameters[2].low90;
  group.high90 = result.parameters[2].high90;
  group.members = {kNames[0], kNames[1], kNames[2], "scene.tissue.density_kg_per_m3"};
  group.text =
      "Shapes at rest see one number of the three, the stiffness they make together against the "
      "weight; it holds for this step and these iterations alone (docs/tissue.md 5).";
  result.groups.push_back(group);
  if (orphans_ > 0) {
    result.warnings.push_back(fmt::format(
        "{} of {} candidates were refused: particles in no cluster", orphans_, tried_.size()));
  }
  result.scene = scene_of(scene_, best.candidate);
  result.scene.mutable_tissue()->set_model(pb::TISSUE_CLUSTER);
  result.triangles = close_sheet(data_.made.tissue.surface_triangles,
                                 static_cast<int>(data_.made.tissue.particles.size()));
  result.core_seconds = core_seconds_since(begin, *data_.setup.simulator);
  return result;
}

}  // namespace

Calibration calibrate_paper(const pb::Scene& scene, std::vector<Observation> observations,
                            const CalibrationOptions& options) {
  return PaperSearch(scene, std::move(observations), options).run();
}

}  // namespace omentum

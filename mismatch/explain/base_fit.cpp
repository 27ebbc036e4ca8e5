#include "mismatch/explain/base_fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/check.h"
#include "mismatch/calibrate/scores.h"
#include "mismatch/explain/believed_base.h"
#include "mismatch/explain/dispersion.h"
#include "mismatch/fit/descent.h"
#include "mismatch/fit/recording_evidence.h"
#include "mismatch/fit/starts.h"
#include "sim_worker/playback/simulation.h"

namespace omentum {
namespace {

constexpr std::size_t kSearchFrames = 12;  // of a recording, while numbers are far from the truth
constexpr std::size_t kStartRecordings = 3;
// Of the coarse mesh, which tells changes alone.
constexpr double kCoarsePeriod = 2;  // control steps are so many times as long
constexpr double kCoarseTolerance =
    1e-6;  // of the weight: 1e-6 of a sag is nothing beside a change

/// What two correct models may differ in, by columns (docs/mismatch.md 5.2).
std::vector<Unknown> numerics_of(const pb::Scene& scene) {
  std::vector<Unknown> list;
  const auto add = [&](const std::string& column, const std::string& unit, double sd) {
    Unknown unknown;
    unknown.path = "numerics." + column;
    unknown.unit = unit;
    unknown.column = column;
    unknown.scale = Unknown::Scale::kShift;
    unknown.sd = sd;
    unknown.prior = "docs/mismatch.md 5.2";
    unknown.role = NumberRole::kNumerics;
    list.push_back(unknown);
  };
  const pb::ElasticLaw law = scene.tissue().material().law();
  constexpr double kLaw = 0.2;  // of the distance between two laws
  if (law != pb::LAW_COROTATED) add("law.corotated", "1", kLaw);
  if (law != pb::LAW_NEO_HOOKE) add("law.neo_hooke", "1", kLaw);
  if (law != pb::LAW_ST_VENANT_KIRCHHOFF) add("law.st_venant_kirchhoff", "1", kLaw);
  add("viscoelastic.g@tau=0.02", "1", 0.3);  // damping by rate
  if (scene.rigid_body_size() > 0) add("slip_speed", "m/s", 1e-4);
  if (holds_pad(scene)) {
    constexpr double kGive = 3.3e-4;  // [m/N] a third of the stiff end of row 21
    const pb::Grip& grip = scene.tool().grip();
    const double square =
        (grip.half_x_m() * grip.half_x_m() + grip.half_y_m() * grip.half_y_m()) / 6;
    add("grasp_compliance.C", "m/N", kGive);
    add("grasp_compliance.C_turn", "rad/(N m)", kGive / square);
  }
  add("camera_bias.scale", "1", 0.01);
  add("camera_bias.quadratic", "1/m", 0.1);  // 0.1 mm at 30 mm from the middle of its range
  return list;
}

std::vector<Unknown> atoms_of(const std::vector<Candidate>& candidates) {
  std::vector<Unknown> list;
  for (const Candidate& c : candidates) {
    Unknown unknown;
    unknown.path = c.key;
    unknown.unit = c.unit;
    unknown.column = c.column;
    unknown.scale = Unknown::Scale::kShift;
    unknown.sd = c.sd;
    unknown.role = NumberRole::kAtom;
    list.push_back(unknown);
  }
  return list;
}

/// A rigid pad has no derivative by its give: it begins to give way.
pb::Scene with_soft_pad(pb::Scene scene) {
  constexpr double kGive = 1e-4;  // [m/N]
  pb::TissueEffects& effects = *scene.mutable_tissue()->mutable_effects();
  const pb::Grip& grip = scene.tool().grip();
  if (!holds_pad(scene) || effects.grasp_compliance_m_per_n() > 0) return scene;
  const double square = (grip.half_x_m() * grip.half_x_m() + grip.half_y_m() * grip.half_y_m()) / 6;
  effects.set_grasp_compliance_m_per_n(kGive);
  effects.set_grasp_turn_rad_per_n_m(kGive / square);
  return scene;
}

/// Shared numbers of a state that has other unknowns now; new ones are at 0.
FitState carried(const FitState& state, const Layout& from, const Layout& to) {
  FitState made = state;
  made.shared = Eigen::VectorXd::Zero(to.shared());
  const int common = std::min(from.unknowns.count, to.unknowns.count);
  made.shared.head(common) = state.shared.head(common);
  const int rest = from.shared() - from.unknowns.count;
  made.shared.tail(rest) = state.shared.tail(rest);
  return made;
}

/// Stated, never adapted to what the fit leaves: there an effect hides itself. Two correct models
/// differ by something smooth: the variance of a cosine falls with the square of its wave number.
Scales stated_scales(const FitData& data, const ExplainOptions& options) {
  Scales scales = first_scales(data);
  const int modes = data.layout.among_own(data.layout.modes);
  const int cosines = data.layout.cosines(), per_side = data.setup.cosines_per_side;
  Eigen::VectorXd variance(cosines);
  for (int k = 0; k < cosines; ++k) {
    const int along_x = k / per_side, along_y = k % per_side;
    variance[k] = 1.0 / (1 + along_x * along_x + along_y * along_y);
  }
  // The first function of time is that at rest, where models agree.
  const double all = (kTimeFunctions - 1) * variance.sum();
  for (int time = 1; time < kTimeFunctions; ++time) {
    scales.own_sd.segment(modes + time * cosines, cosines) =
        options.discrepancy_m * (variance / all).cwiseSqrt();
  }
  return scales;
}

/// The white part of the sensor's noise along a ray, of all recordings [m].
double sensor_noise(const FitData& data, const Linearisation& linear, const Which& which,
                    const SearchState& found) {
  constexpr double kLeast = 2e-4;
  std::vector<double> levels;
  const auto compared = compare(data, linear, which, found.state, found.scales.noise, false);
  for (std::size_t k = 0; k < which.size(); ++k)
    levels.push_back(floor_of(data.observations[which[k]], compared[k]));
  const auto middle = levels.begin() + static_cast<std::ptrdiff_t>(levels.size() / 2);
  std::nth_element(levels.begin(), middle, levels.end());
  return std::max(kLeast, *middle);
}

/// The error of the fine mesh, of what the coarse one differs from it by: both fall with the same
/// power of the cells.
double mesh_error(const BaseFit& base) {
  constexpr double kOrder = 2.5;
  const double ratio =
      std::sqrt(static_cast<double>(base.fine.elements[0]) * base.fine.elements[1] /
                (static_cast<double>(base.coarse.elements[0]) * base.coarse.elements[1]));
  return 1 / (std::pow(std::max(ratio, 1.1), kOrder) - 1);
}

/// Meshes that hardly differ do not tell their error.
double extrapolated_share(const BaseFit& base) { return std::min(1.0, mesh_error(base)); }

/// Numerics that no column tells: mesh, step, clamp and pad.
void add_numerics(const FitData& plain, const FitState& at, ReferenceForward& model, BaseFit& base,
                  Linearisation& linear, FitState& state) {
  const Which all = all_recordings(base);
  const auto add = [&](const std::string& name, double slope, double sd,
                       const std::vector<Prediction>& other) {
    Unknown unknown;
    unknown.path = "numerics." + name;
    unknown.unit.assign(1, '1');
    unknown.scale = Unknown::Scale::kShift;
    unknown.sd = sd;
    unknown.prior = "docs/mismatch.md 5.2";
    unknown.role = NumberRole::kNumerics;
    set_difference(unknown, other, slope, base.data, linear, state);
  };
  constexpr double kErrors = 1.5;  // of mesh and step
  Numerics half = base.coarse;
  half.substeps *= 2;
  // Of second order (BDF2), and the fine mesh has the shorter steps.
  add("step", 4.0 / 3 / (kCoarsePeriod * kCoarsePeriod), kErrors,
      changed_surfaces(base.surfaces, base.coarse_surfaces,
                       model.simulate(plain, at, half, false, all)));
  FitData bedded = plain;
  constexpr double kBed = 3e-5;  // [m2/N] a third of the stiff end of row 17
  bedded.scene.mutable_tissue()->mutable_effects()->mutable_anchor()->set_compliance_m2_per_n(kBed);
  add("clamp_on_a_bed", 1, 1,
      changed_surfaces(base.surfaces, base.coarse_surfaces,
                       model.simulate(bedded, at, base.coarse, false, all)));
  if (holds_pad(plain.scene)) {
    constexpr double kWider = 5e-4, kSd = 1e-3;  // [m]
    FitData wide = plain;
    pb::Grip& grip = *wide.scene.mutable_tool()->mutable_grip();
    grip.set_half_x_m(grip.half_x_m() + kWider);
    grip.set_half_y_m(grip.half_y_m() + kWider);
    for (Observation& seen : wide.observations) seen.grasp.patch_radius_m += kWider;
    add("pad_size", kSd / kWider, 1,
        changed_surfaces(base.surfaces, base.coarse_surfaces,
                         model.simulate(wide, at, base.coarse, false, all)));
  }
  // The fine mesh is extrapolated; that of another solver, which floors are to stand for, is not.
  const double error = mesh_error(base) / (1 + extrapolated_share(base));
  add("mesh", -error, kErrors, base.coarse_surfaces);
}

/// The frames of `fine` with the columns of `coarse`, in place of the latter.
void put_columns_on(const Prediction& fine, Prediction& coarse) {
  for (std::size_t f = 0; f < coarse.frames.size(); ++f) {
    Eigen::MatrixXf columns = std::move(coarse.frames[f].columns);
    coarse.frames[f] = fine.frames[f];
    if (coarse.frames[f].valid) coarse.frames[f].columns = std::move(columns);
  }
}

/// Surfaces alone: columns are of the unknowns of their time.
std::vector<Prediction> without_columns(std::vector<Prediction> predictions) {
  for (Prediction& prediction : predictions) {
    for (PredictedFrame& frame : prediction.frames) frame.columns.resize(0, 0);
  }
  return predictions;
}

/// Moves valid frames of `moved` by `share` of what `fine` and `coarse` differ by.
void move_apart(const std::vector<Prediction>& fine, const std::vector<Prediction>& coarse,
                double share, std::vector<Prediction>& moved) {
  for (std::size_t r = 0; r < moved.size(); ++r) {
    for (std::size_t f = 0; f < moved[r].frames.size(); ++f) {
      PredictedFrame& frame = moved[r].frames[f];
      if (f >= fine[r].frames.size() || f >= coarse[r].frames.size()) continue;
      frame.valid = frame.valid && fine[r].frames[f].valid && coarse[r].frames[f].valid;
      if (!frame.valid) continue;
      frame.correction.resize(frame.vertices.size());
      for (std::size_t v = 0; v < frame.vertices.size(); ++v) {
        frame.correction[v] =
            share * (fine[r].frames[f].vertices[v] - coarse[r].frames[f].vertices[v]);
        frame.vertices[v] += frame.correction[v];
      }
    }
  }
}

/// Surfaces for cells of no size (Richardson), from those of the fine and of the coarse mesh.
std::vector<Prediction> extrapolated(const BaseFit& base, const std::vector<Prediction>& fine,
                                     const std::vector<Prediction>& coarse) {
  std::vector<Prediction> made = fine;
  move_apart(fine, coarse, extrapolated_share(base), made);
  return made;
}

class BaseSearch {
 public:
  BaseSearch(const ExplainOptions& options, ReferenceForward& model, BaseFit& base)
      : options_(options), model_(model), base_(base) {}

  void run() {
    say(0.02, "starts");
    start();
    say(0.1, "coarse mesh");
    descend_coarsely();
    say(0.25, "fine mesh");
    settle_finely();
    say(0.4, "held out");
    simulate_held_out();
  }

 private:
  void say(double share, const std::string& stage) const {
    if (options_.progress) options_.progress(share, stage);
  }

  void start() {
    Which few = base_.fitted;
    few.resize(std::min(few.size(), kStartRecordings));
    const Start start = find_start(base_.data, model_, few, [](double) {});
    base_.found.state = start.failure.empty() ? start.state : believed_state(base_.data);
  }

  void descend_coarsely() {
    FitData few = base_.data;
    few.observations = few_frames(few.observations, kSearchFrames);
    const LineariseAt linearise = [&](const FitState& state) {
      return model_.linearise(few, state, base_.coarse, base_.fitted);
    };
    DescentOptions search;
    search.most_simulations = 4;
    search.small_move = 1;
    Scales scales = stated_scales(base_.data, options_);
    scales.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
    Linearisation begin = linearise(base_.found.state);
    drop_failing(begin);
    base_.found = descend(few, linearise, base_.fitted, search, std::move(begin), scales).found;
  }

  void drop_failing(const Linearisation& linear) {
    std::erase_if(base_.fitted, [&](std::size_t r) {
      const bool fails = count_valid(linear.predictions[r]) == 0;
      if (fails) base_.failed.push_back(r);
      return fails;
    });
    if (base_.fitted.empty())
      throw_error("no recording can be simulated: {}", linear.predictions[base_.failed[0]].failure);
  }

  /// On surfaces of the fine mesh with columns of the coarse one. The fine mesh is simulated once:
  /// what it differs by changes little with the state, and a coarse one tells the rest.
  void settle_finely() {
    constexpr int kSteps = 8;
    const auto simulate = [&](const Numerics& numerics) {
      return model_.simulate(base_.data, base_.found.state, numerics, false, base_.fitted);
    };
    base_.found.scales.own_sd = stated_scales(base_.data, options_).own_sd;
    Linearisation linear = linearise_coarsely();
    const std::vector<Prediction> coarse = without_columns(linear.predictions);
    const std::vector<Prediction> fine = extrapolated(base_, simulate(base_.fine), coarse);
    for (const std::size_t r : base_.fitted) put_columns_on(fine[r], linear.predictions[r]);
    NoiseModel& noise = base_.found.scales.noise;
    noise.sigma = sensor_noise(base_.data, linear, base_.fitted, base_.found);
    noise.reach = kTissueReach;
    base_.limits.hold_noise = true;
    base_.found = improve(base_.data, linear, base_.fitted, kSteps, base_.limits, base_.found);
    model_.forget_pads();  // derivatives by where the pad began are of another mesh now
    linear = linearise_coarsely();
    base_.coarse_surfaces = without_columns(linear.predictions);
    base_.surfaces = changed_surfaces(fine, coarse, base_.coarse_surfaces);
    for (const std::size_t r : base_.fitted)
      put_columns_on(base_.surfaces[r], linear.predictions[r]);
    refine(fine, coarse, std::move(linear));
  }

  /// Derivatives stay, every step is simulated; what does not fit better is tried again, shorter.
  void refine(const std::vector<Prediction>& fine, const std::vector<Prediction>& coarse,
              Linearisation linear) {
    constexpr int kRounds = 8, kSteps = 8;
    const auto cost = [&](const FitState& at, const std::vector<Prediction>& surfaces) {
      return cost_of(base_.data, {at, surfaces}, base_.fitted, at, base_.found.scales);
    };
    double least = cost(base_.found.state, base_.surfaces);
    StepLength length;
    FitState led;
    for (int round = 0; round < kRounds; ++round) {
      if (!length.refused()) {
        led = improve(base_.data, linear, base_.fitted, kSteps, base_.limits, base_.found).state;
        const SearchState& found = base_.found;
        length.aim(least - cost_of(base_.data, linear, base_.fitted, led, found.scales));
      }
      if (length.settled()) break;
      const FitState next = between(base_.found.state, led, length.share());
      const std::vector<Prediction> trial =
          model_.simulate(base_.data, next, base_.coarse, false, base_.fitted);
      std::vector<Prediction> surfaces = changed_surfaces(fine, coarse, trial);
      const double gained = least - cost(next, surfaces);
      if (!length.accept(gained)) continue;
      base_.found.state = next;
      least -= gained;
      base_.coarse_surfaces = trial;
      base_.surfaces = std::move(surfaces);
      linear.at = next;
      for (const std::size_t r : base_.fitted)
        put_columns_on(base_.surfaces[r], linear.predictions[r]);
    }
  }

  Linearisation linearise_coarsely() {
    return model_.linearise(base_.data, base_.found.state, base_.coarse, base_.fitted);
  }

  void simulate_held_out() {
    for (const std::size_t r : base_.held_out) base_.found.state.own[r].setZero();
    if (base_.held_out.empty()) return;
    const auto fine =
        model_.simulate(base_.data, base_.found.state, base_.fine, false, base_.held_out);
    const auto coarse =
        model_.simulate(base_.data, base_.found.state, base_.coarse, false, base_.held_out);
    const auto better = extrapolated(base_, fine, coarse);
    for (const std::size_t r : base_.held_out) {
      base_.surfaces[r] = better[r];
      base_.coarse_surfaces[r] = coarse[r];
    }
  }

  const ExplainOptions& options_;
  ReferenceForward& model_;
  BaseFit& base_;
};

}  // namespace

bool is_simulated(const std::vector<Prediction>& now, const std::vector<Prediction>& before,
                  const Which& which) {
  constexpr double kEnough = 0.9;  // of the frames
  return std::ranges::all_of(which, [&](std::size_t r) {
    return static_cast<double>(count_valid(now[r])) >=
           kEnough * static_cast<double>(count_valid(before[r]));
  });
}

void StepLength::aim(double foretold) {
  foretold_ = foretold;
  settled_ = !(foretold > kSettled);
}

bool StepLength::accept(double gained) {
  constexpr double kLeast = 0.1, kLonger = 2;
  constexpr int kMostRefused = 3;
  refused_ = !(gained > 0);
  if (!refused_) {
    share_ = std::min(1.0, kLonger * share_);
    refusals_ = 0;
    return true;
  }
  // The parabola that begins as foretold, by twice of it per share, and ends where the trial did.
  const double bend = (2 * foretold_ * share_ - gained) / (share_ * share_);
  const double top = foretold_ / bend, most = foretold_ * top;
  // One that fell off a cliff says little of where the top is.
  const bool known = top > kLeast * share_;
  settled_ = ++refusals_ >= kMostRefused || (known && most < kSettled);
  share_ = known ? top : kLeast * share_;
  return false;
}

FitState between(const FitState& from, const FitState& to, double share) {
  FitState made = from;
  made.shared += share * (to.shared - from.shared);
  for (std::size_t r = 0; r < from.own.size(); ++r)
    made.own[r] += share * (to.own[r] - from.own[r]);
  return made;
}

std::vector<Prediction> changed_surfaces(const std::vector<Prediction>& fine,
                                         const std::vector<Prediction>& coarse,
                                         const std::vector<Prediction>& other) {
  std::vector<Prediction> made = other;
  move_apart(fine, coarse, 1, made);
  return made;
}

std::vector<Prediction> extrapolated_as_base(const BaseFit& base, std::vector<Prediction> fine) {
  const double share = extrapolated_share(base) / (1 + extrapolated_share(base));
  move_apart(base.surfaces, base.coarse_surfaces, share, fine);
  return fine;
}

BaseFit believed_base(const pb::Scene& scene, std::vector<Observation> observations,
                      const ExplainOptions& options) {
  // The clouds alone decide; forces are compared with what they find (compare_forces()).
  std::vector<std::vector<std::optional<SeenForce>>> forces;
  for (Observation& o : observations) {
    std::vector<std::optional<SeenForce>>& of_frames = forces.emplace_back();
    for (SeenFrame& frame : o.frames) of_frames.push_back(std::exchange(frame.force, {}));
  }
  const pb::Scene believed = with_soft_pad(scene);
  FitSetup setup = options;
  setup.independent_clocks = true;
  setup.row_worth = 1 / kDispersion;
  BaseFit base(make_fit_data(believed, std::move(observations), setup));
  base.forces = std::move(forces);
  const auto mesh_of = [&](double tolerance_m) -> Numerics {
    return {pb::TISSUE_REFERENCE,
            count_elements(believed, options.folder, base.data.observations, tolerance_m), 1};
  };
  base.discrepancy_m = options.discrepancy_m;
  base.fine = mesh_of(options.tolerance_m);
  base.coarse = mesh_of(options.coarse_tolerance_m);
  base.coarse.period = kCoarsePeriod;
  base.coarse.newton_tolerance = kCoarseTolerance;
  for (std::size_t r = 0; r < base.data.observations.size(); ++r)
    (base.data.observations[r].held_out ? base.held_out : base.fitted).push_back(r);
  if (base.fitted.empty()) throw_error("every recording is held out: nothing can be fitted");
  base.found = {believed_state(base.data), stated_scales(base.data, options)};
  return base;
}

BaseFit fit_base(const pb::Scene& scene, std::vector<Observation> observations,
                 const ExplainOptions& options, ReferenceForward& model) {
  BaseFit base = believed_base(scene, std::move(observations), options);
  BaseSearch(options, model, base).run();
  return base;
}

Which all_recordings(const BaseFit& base) {
  Which all = base.fitted;
  all.insert(all.end(), base.held_out.begin(), base.held_out.end());
  std::ranges::sort(all);
  return all;
}

std::vector<Candidate> add_columns(std::vector<Candidate>& candidates,
                                   const ExplainOptions& options, ReferenceForward& model,
                                   BaseFit& base) {
  const Layout before = base.data.layout;
  std::vector<Unknown> unknowns = base.data.unknowns;
  std::vector<Candidate> with_column = candidates, failed;
  std::erase_if(with_column, [](const Candidate& c) { return c.secant != 0; });
  for (const auto& more : {numerics_of(base.data.scene), atoms_of(with_column)})
    unknowns.insert(unknowns.end(), more.begin(), more.end());
  set_unknowns(std::move(unknowns), base.data);
  base.found.state = carried(base.found.state, before, base.data.layout);
  for (const Candidate& c : with_column) {
    const auto found = std::ranges::find(base.data.unknowns, c.key, &Unknown::path);
    if (c.pinch_axis >= 0)
      base.pinch_atoms.emplace_back(found - base.data.unknowns.begin(), c.pinch_axis);
    if (c.effect == "actuation_delay") base.delay_atom = found - base.data.unknowns.begin();
  }
  const Which all = all_recordings(base);
  const FitState at = base.found.state;
  const FitData plain = base.data;
  Linearisation linear{at, base.surfaces};
  FitState widened = at;
  add_numerics(plain, at, model, base, linear, widened);
  for (const Candidate& c : candidates) {
    if (c.secant == 0) continue;
    if (options.progress) options.progress(0.5, "simulated effects: " + c.effect);
    FitData moved = plain;
    apply_effects({secant_effect(c, moved.made)}, moved.scene);
    const auto other = model.simulate(moved, at, base.coarse, false, all);
    if (!is_simulated(other, base.coarse_surfaces, all)) {
      failed.push_back(c);
      continue;
    }
    set_difference(atoms_of({c}).front(),
                   changed_surfaces(base.surfaces, base.coarse_surfaces, other), 1 / c.secant,
                   base.data, linear, widened);
  }
  base.found.state = widened;
  std::erase_if(candidates, [&](const Candidate& c) {
    return std::ranges::count(failed, c.key, &Candidate::key) > 0;
  });
  return failed;
}

Linearisation with_columns(const BaseFit& base, ReferenceForward& model, const Which& which) {
  Linearisation linear = model.linearise(base.data, base.found.state, base.coarse, which);
  for (const std::size_t r : which) {
    put_columns_on(base.surfaces[r], linear.predictions[r]);
    for (PredictedFrame& frame : linear.predictions[r].frames) {
      if (frame.columns.size() == 0) continue;
      for (const auto& [column, axis] : base.pinch_atoms)
        frame.columns.col(column) = frame.columns.col(base.data.layout.unknowns.count + axis);
      if (!base.delay_atom) continue;
      auto late = frame.columns.col(*base.delay_atom);
      for (std::size_t v = 0; v < frame.velocity.size(); ++v)
        late.segment<3>(3 * static_cast<Eigen::Index>(v)) = -frame.velocity[v].cast<float>();
    }
  }
  return linear;
}

std::vector<Evidence> gather_evidence(const BaseFit& base, ReferenceForward& model,
                                      const ExplainOptions& options) {
  const Which all = all_recordings(base);
  std::vector<Evidence> evidence;
  const std::size_t at_once = std::max<std::size_t>(1, base.data.setup.simulator->at_once());
  for (std::size_t first = 0; first < all.size(); first += at_once) {
    const Which some(
        all.begin() + static_cast<std::ptrdiff_t>(first),
        all.begin() + static_cast<std::ptrdiff_t>(std::min(all.size(), first + at_once)));
    const Linearisation linear = with_columns(base, model, some);
    const NoiseModel& noise = base.found.scales.noise;
    const auto equations = compare(base.data, linear, some, base.found.state, noise, true);
    for (std::size_t k = 0; k < some.size(); ++k) {
      evidence.push_back(evidence_of(base.data, equations[k], base.found, some[k],
                                     row_information({&equations[k], 1}, noise)));
    }
    if (options.progress) {
      const double share =
          static_cast<double>(first + some.size()) / static_cast<double>(all.size());
      options.progress(0.55 + 0.1 * share, "columns of effects");
    }
  }
  return evidence;
}

}  // namespace omentum

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <ctime>
#include <memory>
#include <optional>
#include <utility>

#include "core/check.h"
#include "mismatch/calibrate/law_choice.h"
#include "mismatch/calibrate/stages.h"
#include "mismatch/fit/clock_posterior.h"
#include "mismatch/fit/starts.h"

namespace omentum {
namespace {

constexpr double kMeshRatio = 1.5;
// Work of simulating all recordings once, against the fine mesh without derivatives: with them on
// the coarse and the fine mesh, and without on the one that measures the error of the mesh.
constexpr double kCoarseWork = 0.4, kFineWork = 1.6, kMeshWork = 0.4;
// Work of most calibrations: starts, coarse mesh, fine mesh, mesh and step, settling, laws,
// settling again, before and left out.
constexpr std::array<double, 8> kPlan = {3.5,           5 * kCoarseWork,
                                         3 * kFineWork, kMeshWork + 2,
                                         kFineWork,     2 * (3 * kFineWork + kMeshWork),
                                         2 * kFineWork, 2.2};

/// Of bodies that are let go: a swing that is looked at for long has as many best fits as it has
/// periods, so the search begins with what is seen at first and goes on with ever more of it.
void begin_held(const Numerics& coarse, CalibrationRun& run) {
  constexpr double kFirst = 0.05, kLonger = 2;  // [s]
  constexpr double kNear = 1;                   // standard deviations
  constexpr std::size_t kFrames = 60;
  run.found.state = believed_state(run.data);
  run.found.scales.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
  bool all = false;
  for (double seconds = kFirst; !all; seconds *= kLonger) {
    const FirstFrames first = first_frames(run.data.observations, seconds, kFrames);
    descend({coarse, 6, kNear, kCoarseWork, "starts"}, run, &first.observations);
    all = first.all;
  }
}

/// Begins by the shell; recordings that are mirrored are named and left out.
void begin_by_shell(CalibrationRun& run) {
  const Start start = find_start(run.data, run.model, run.fitted, [&](double share) {
    run.work.add("starts", kPlan.front() * share * static_cast<double>(run.fitted.size()));
  });
  std::vector<std::string>& warnings = run.result.warnings;
  if (!start.failure.empty()) {
    warnings.push_back(
        fmt::format("the shell cannot be simulated and the search begins at what is believed: {}",
                    start.failure));
  }
  for (const std::size_t r : start.mirrored) {
    const Observation& seen = run.data.observations[r];
    warnings.push_back(
        fmt::format("recording {}: the cloud shows the sheet held on the other side of its middle: "
                    "the jaws are "
                    "recorded at x_B = {:.1f} mm, seen at {:.1f} mm; it is left out of the fit",
                    seen.name, 1e3 * seen.pinch.x(), -1e3 * seen.pinch.x()));
  }
  if (start.mirrored.size() == run.fitted.size())
    throw_error("every recording shows the sheet held on the other side: is x mirrored?");
  std::erase_if(run.fitted,
                [&](std::size_t r) { return std::ranges::count(start.mirrored, r) > 0; });
  run.found.state = start.state;
  run.found.scales.noise = NoiseModel{0.003, 5e-4, 0.02, 4};
}

/// Large cells move the numbers as far as they are told: neither all frames are needed there nor
/// rest.
void descend_coarsely(const Numerics& coarse, CalibrationRun& run) {
  constexpr double kNear = 1;
  const bool held = run.data.layout.held_place.count > 0;
  const std::size_t frames = held ? kMostFrames : 12;  // a swing needs more
  const std::vector<Observation> few = few_frames(run.data.observations, frames);
  const Which usable = run.fitted;
  descend({coarse, 6, kNear, kCoarseWork, "coarse mesh"}, run, &few);
  settle_scales(run, &few);
  descend({coarse, 6, kNear, kCoarseWork, "coarse mesh"}, run, &few);
  run.fitted = usable;  // what fails on large cells may not on small ones
}

/// The mesh as a nuisance, by a simulation with larger cells.
void measure_mesh(CalibrationRun& run) {
  const std::array<int, 3>& elements = run.fine.elements;
  const std::array<int, 3> fewer = fewer_elements(elements, kMeshRatio);
  const double ratio = std::sqrt(static_cast<double>(elements[0]) * elements[1] /
                                 (static_cast<double>(fewer[0]) * fewer[1]));
  const double fall = 1 / (std::pow(ratio, 2.5) - 1);  // docs/results/tissue.md: error ~ cell^2.5
  const auto mesh = run.model.simulate(run.data, run.linear.at, {pb::TISSUE_REFERENCE, fewer, 1},
                                       false, run.fitted);
  run.mesh_rms = fall * surfaces_apart(mesh, run.linear.predictions);
  run.work.add("mesh", kMeshWork * static_cast<double>(run.fitted.size()));
  set_difference({"numerics.mesh", "1", "", Unknown::Scale::kShift, 0, 1.5,
                  "1.5 times its estimated error", NumberRole::kNumerics},
                 mesh, -fall, run.data, run.linear, run.found.state);
}

pb::ElasticLaw law_of(const CalibrationRun& run) {
  return run.data.scene.tissue().material().law();
}
void set_law(pb::ElasticLaw law, CalibrationRun& run) {
  run.data.scene.mutable_tissue()->mutable_material()->set_law(law);
}

LawFit keep_law(const CalibrationRun& run) {
  return {law_of(run),
          {run.linear, run.found, run.posterior, run.settled},
          run.data.differences,
          run.mesh_rms,
          0};
}

/// Goes on where a law ended, at the scales of now.
void restore_law(const LawFit& fit, CalibrationRun& run) {
  set_law(fit.law, run);
  run.data.differences = fit.differences;
  run.mesh_rms = fit.mesh_rms;
  Descent d = fit.d;
  d.found.scales = run.found.scales;
  take(std::move(d), run);
}

/// Costs of all laws at the noise and the beliefs found so far.
void compare_laws(const CalibrationRun& run, std::vector<LawFit>& laws) {
  const Scales& scales = run.found.scales;
  for (LawFit& law : laws) {
    law.d.found.state = improve(run.data, law.d.linear, run.fitted, 8, run.search.limits,
                                {law.d.found.state, scales})
                            .state;
    law.cost = cost_of(run.data, law.d.linear, run.fitted, law.d.found.state, scales);
  }
}

/// Another law, fitted from where the first one led, on the same mesh and with its own error of the
/// mesh. Nothing where it cannot be simulated as far as the first.
std::optional<LawFit> fit_law(pb::ElasticLaw law, const LawFit& first, CalibrationRun& run) {
  restore_law(first, run);
  set_law(law, run);
  const LineariseAt linearise = [&](const FitState& state) {
    Linearisation linear = run.model.linearise(run.data, state, run.fine, run.fitted);
    run.work.add("laws of elasticity", kFineWork * static_cast<double>(run.fitted.size()));
    return linear;
  };
  Linearisation begin = linearise(run.found.state);
  const bool fails = std::ranges::any_of(run.fitted, [&](std::size_t r) {
    return count_valid(begin.predictions[r]) < count_valid(first.d.linear.predictions[r]);
  });
  if (fails) {
    run.result.warnings.push_back(
        fmt::format("law of elasticity: that of {} cannot be simulated where the recordings lead "
                    "with that of {}; it is not compared",
                    law_name(law), law_name(first.law)));
    return std::nullopt;
  }
  take(omentum::descend(run.data, linearise, run.fitted, run.search, std::move(begin),
                        run.found.scales),
       run);
  measure_mesh(run);
  return keep_law(run);
}

/// Every law of elasticity; goes on with the one that is chosen.
std::vector<LawFit> fit_laws(CalibrationRun& run) {
  const LawFit first = keep_law(run);
  const Scales scales = run.found.scales;
  std::vector<LawFit> laws = {first};
  for (const pb::ElasticLaw law : kLaws) {
    if (law == first.law) continue;
    if (std::optional<LawFit> fit = fit_law(law, first, run)) laws.push_back(*std::move(fit));
  }
  run.found.scales = scales;
  restore_law(first, run);
  compare_laws(run, laws);
  restore_law(choose_law(laws, first.law), run);
  return laws;
}

/// What the law is worth at the end: told from the others, or not.
void judge_laws(CalibrationRun& run, std::vector<LawFit>& laws) {
  LawFit& chosen = *std::ranges::find(laws, law_of(run), &LawFit::law);
  chosen = keep_law(run);
  compare_laws(run, laws);
  chosen.d.found.state = run.found.state;
  for (const LawFit& fit : laws) {
    LawRow& row =
        run.result.laws.emplace_back(LawRow{law_name(fit.law), fit.cost - chosen.cost, {}});
    for (std::size_t k = 0; k < run.data.unknowns.size(); ++k) {
      const Unknown& unknown = run.data.unknowns[k];
      const double x = fit.d.found.state.shared[static_cast<Eigen::Index>(k)];
      if (unknown.in_scene()) row.parameters.emplace_back(unknown.path, unknown.value(x));
    }
  }
  std::string names;
  for (const LawFit* other : laws_alike(laws, chosen, run.numerics_rms())) {
    const double less = other->cost - chosen.cost;
    names += fmt::format("{}{} (log likelihood {} by {:.1f})", names.empty() ? "" : ", ",
                         law_name(other->law), less < 0 ? "more" : "less", std::fabs(less));
    run.law_rms =
        std::max(run.law_rms, surfaces_apart(other->d.linear.predictions, run.linear.predictions));
  }
  if (names.empty()) return;
  run.result.warnings.push_back(fmt::format(
      "law of elasticity: that of {} is not told from {}: no better, or no farther from "
      "it than mesh and step may be off. Values are those of the first, intervals reach "
      "over all of them; lift higher to tell them apart",
      law_name(chosen.law), names));
}

/// Intervals over the clocks and the laws that may be.
void integrate(const std::vector<LawFit>& laws, CalibrationRun& run) {
  ClockPosterior over = integrate_clock(run.data, run.linear, run.fitted, run.found, run.posterior);
  run.found.state = std::move(over.state);
  run.posterior = std::move(over.posterior);
  run.clock = over.clock;
  const LawFit& chosen = *std::ranges::find(laws, law_of(run), &LawFit::law);
  widen_over_laws(chosen, laws_alike(laws, chosen, run.numerics_rms()), run.fitted, run.posterior);
}

}  // namespace

Calibration calibrate_reference(const pb::Scene& scene, std::vector<Observation> observations,
                                const CalibrationOptions& options) {
  const std::clock_t started = std::clock();
  ReferenceForward model;
  CalibrationRun run = begin_calibration("reference", options,
                                         make_fit_data(scene, std::move(observations), options),
                                         model, {kPlan.begin(), kPlan.end()});
  const auto mesh_of = [&](double tolerance_m) -> Numerics {
    return {pb::TISSUE_REFERENCE,
            count_elements(scene, options.folder, run.data.observations, tolerance_m), 1};
  };
  run.fine = mesh_of(options.tolerance_m);
  const Numerics coarse = mesh_of(6 * options.tolerance_m);

  run.work.begin_stage();
  bind_markers(coarse, run);
  if (run.data.layout.held_place.count > 0) {
    begin_held(coarse, run);
  } else {
    begin_by_shell(run);
  }
  run.work.begin_stage();
  descend_coarsely(coarse, run);
  run.work.begin_stage();
  descend({run.fine, 4, kSmallMove, kFineWork, "fine mesh"}, run);
  run.work.begin_stage();
  measure_mesh(run);
  measure_step(4.0 / 3, run);  // the error falls with its square
  run.work.begin_stage();
  settle(kFineWork, run);  // else the other laws, which are simulated further, look better
  run.work.begin_stage();
  std::vector<LawFit> laws = fit_laws(run);
  run.work.begin_stage();
  settle(kFineWork, run);
  judge_laws(run, laws);
  integrate(laws, run);
  const double mesh = run.mesh_rms, step = run.step_rms, law = run.law_rms;
  const std::shared_ptr<const Simulator> simulator = run.data.setup.simulator;
  Calibration result = finish(std::move(run));
  result.numerics = {fmt::format("mesh {:.3f} mm", 1e3 * mesh),
                     fmt::format("step {:.3f} mm", 1e3 * step),
                     fmt::format("law of elasticity {:.3f} mm", 1e3 * law)};
  result.core_seconds = core_seconds_since(started, *simulator);
  return result;
}

}  // namespace omentum

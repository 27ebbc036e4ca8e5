#include "mismatch/explain/planned_limits.h"

#include <fmt/format.h>

#include <algorithm>
#include <ctime>

#include "core/check.h"
#include "mismatch/calibrate/scores.h"
#include "mismatch/explain/believed_base.h"
#include "mismatch/explain/proposals.h"
#include "mismatch/explain/verdict_parts.h"

namespace omentum {
namespace {

/// Surfaces of both meshes at what is believed; what cannot be simulated is left out.
void simulate_commands(ReferenceForward& model, BaseFit& base) {
  const Which all = all_recordings(base);
  const auto simulate = [&](const Numerics& numerics) {
    return model.simulate(base.data, base.found.state, numerics, false, all);
  };
  base.coarse_surfaces = simulate(base.coarse);
  base.surfaces = simulate(base.fine);
  for (Which* which : {&base.fitted, &base.held_out}) {
    std::erase_if(*which, [&](std::size_t r) {
      const bool fails =
          count_valid(base.surfaces[r]) == 0 || count_valid(base.coarse_surfaces[r]) == 0;
      if (fails) base.failed.push_back(r);
      return fails;
    });
  }
  if (base.fitted.empty())
    throw_error("no recording can be simulated: {}", base.surfaces[base.failed[0]].failure);
}

void draw_all(const DrawnClouds& clouds, BaseFit& base) {
  for (const std::size_t r : all_recordings(base)) {
    draw_clouds(clouds, r, base);
    if (!base.data.observations[r].has_points())
      throw_error("{}: its camera sees nothing of the sheet", base.data.observations[r].name);
  }
  base.found.scales.noise.sigma = clouds.noise_m;
  base.found.scales.noise.reach = kTissueReach;
}

}  // namespace

pb::Verdict planned_limits(const pb::Scene& scene, std::vector<Observation> observations,
                           const ExplainOptions& options, const DrawnClouds& clouds) {
  const std::clock_t started = std::clock();
  const auto say = [&](double share, const std::string& stage) {
    if (options.progress) options.progress(share, stage);
  };
  ReferenceForward model;
  Case made{
      options, believed_base(scene, std::move(observations), options), {}, {}, {}, {}, 1, {}, {},
      {}};
  say(0.02, "commands");
  simulate_commands(model, made.base);
  draw_all(clouds, made.base);
  made.candidates = candidates_of(made.base.data.made, options.ruled_out);
  const std::vector<Candidate> simulated =
      simulated_candidates(made.base, residual_map(made.base), options.ruled_out);
  made.candidates.insert(made.candidates.end(), simulated.begin(), simulated.end());
  say(0.2, "numerics");
  const std::vector<Candidate> failed = add_columns(made.candidates, options, model, made.base);
  for (Evidence& evidence : gather_evidence(made.base, model, options)) {
    const Observation& seen =
        *std::ranges::find(made.base.data.observations, evidence.name, &Observation::name);
    if (seen.held_out) continue;
    evidence.b.setZero();  // only what could be known counts
    made.folds.push_back(seen.repeat_of.empty() ? seen.name : seen.repeat_of);
    made.fitted.push_back(std::move(evidence));
  }
  Result<Floors> floors = amplitude_floors(made.fitted, options.floor_factor);
  if (!floors) throw_error("limits: {}", floors.error());
  made.floors = std::move(floors).value();
  pb::Verdict verdict;
  add_settings(made, verdict);
  add_limits(made, verdict);
  for (const Candidate& c : failed)
    verdict.add_warnings(c.key + " cannot be simulated and was not asked");
  for (const std::size_t r : made.base.failed) {
    verdict.add_warnings(fmt::format("recording {} cannot be simulated and is left out",
                                     made.base.data.observations[r].name));
  }
  verdict.set_core_seconds(core_seconds_since(started, *made.base.data.setup.simulator));
  return verdict;
}

}  // namespace omentum

#include <fmt/format.h>

#include <cstdio>

#include "core/build_id.h"
#include "core/clock.h"
#include "core/durable_file.h"
#include "core/episode_recording.h"
#include "core/log.h"
#include "learner/learner.h"

namespace omentum {
namespace {

double exposure_of_best(const std::vector<EvaluationRow>& lattice) {
  const std::optional<std::size_t> best = best_grasp(lattice);
  return best ? lattice[*best].exposure : 0;
}

}  // namespace

bool Learner::run_evaluation_set(const EvaluationSet& set, const std::function<bool()>& stop,
                                 Evaluated& result) {
  book_->evaluate(evaluation_tasks(config_, set, current_.policy_version));
  while (!book_->evaluation_complete()) {
    obey_commands();
    if (stop() || bus_->superseded() || book_->audit_difference()) return false;
    bus_->serve(*book_, steady_now_ns());
    if (!book_->evaluation_complete()) bus_->wait(std::int64_t{20'000'000});
  }
  result.tasks = book_->granted_evaluation();
  result.segments = book_->take_evaluation();
  return true;
}

bool Learner::run_lattice(EvaluationSet& set, std::uint32_t particles,
                          const std::function<bool()>& stop) {
  if (!lattice_.empty()) return true;
  fill_lattice(config_, particles, set);
  Evaluated result;
  if (set.start_indices.empty()) return true;
  if (!run_evaluation_set(set, stop, result)) return false;
  const double best = exposure_of_best(judge(config_, set, result.segments, 0));
  lattice_ = judge(config_, set, result.segments, best);
  return true;
}

std::optional<std::vector<EvaluationSummary>> Learner::evaluate(std::vector<EvaluationSet> sets,
                                                                const std::string& folder,
                                                                bool record,
                                                                const std::function<bool()>& stop) {
  const std::int64_t began = steady_now_ns();
  say_phase(LearnerPhase::kEvaluating);
  std::vector<Evaluated> results(sets.size());
  // The recorded set comes first: the number of particles, for the lattice, is read off its frames.
  for (std::size_t i = 0; i < sets.size(); ++i) {
    const bool done =
        sets[i].start_set == StartSet::kGraspLattice
            ? run_lattice(sets[i],
                          particles_of(results[0].segments, config_.evaluation().frame_stride()),
                          stop)
            : run_evaluation_set(sets[i], stop, results[i]);
    if (!done) return std::nullopt;
  }
  const double best_exposure = exposure_of_best(lattice_);
  std::vector<EvaluationSummary> summaries;
  for (std::size_t i = 0; i < sets.size(); ++i) {
    const EvaluationSet& set = sets[i];
    const bool is_lattice = set.start_set == StartSet::kGraspLattice;
    const std::vector<EvaluationRow> judged =
        is_lattice ? lattice_ : judge(config_, set, results[i].segments, best_exposure);
    if (judged.empty()) continue;
    const auto write = [&] {
      const std::string table = folder + "/" + set.name + ".csv";
      Result<void> written =
          write_durably(table, is_lattice ? lattice_table(judged) : grid_table(judged));
      return written && record && set.record ? record_evaluation(set, results[i]) : written;
    };
    if (!until_written(write, stop)) return std::nullopt;
    const EvaluationSummary entry{set.name, figures_of(judged), best_exposure};
    const EvaluationFigures& f = entry.figures;
    if (!options_.quiet) {
      fmt::print(
          "evaluation {:<16} starts {:3}  target_reached {:3}  exposed {:3}  grasp_held {:3}  "
          "best_exposure {:.3f}\n",
          set.name, f.starts, f.target_reached, f.exposed, f.grasp_held, best_exposure);
      std::fflush(stdout);
    }
    summaries.push_back(entry);
  }
  timings_["evaluation"] += seconds_since(began);
  return summaries;
}

bool Learner::evaluate_on_the_way(const std::function<bool()>& stop) {
  const pb::Evaluation& knobs = config_.evaluation();
  const std::uint64_t updates = ppo_->version();
  const bool due = knobs.enabled() && knobs.interval_updates() > 0 && updates > 0 &&
                   updates % knobs.interval_updates() == 0;
  const bool wanted = std::exchange(evaluation_wanted_, false);
  if (!wanted && !due) return true;
  std::vector<EvaluationSet> sets = evaluation_sets(config_);
  // The recorded grid is the first, the grasp lattice behind it.
  if (!wanted && knobs.interval_grid_only()) {
    std::erase_if(sets, [&](const EvaluationSet& set) {
      return set.start_set != StartSet::kGraspLattice && set.name != sets.front().name;
    });
  }
  const std::string folder = fmt::format("{}/evaluation/update-{}", options_.run_dir, updates);
  if (!options_.quiet) fmt::print("after update {}:\n", updates);
  return evaluate(std::move(sets), folder, false, stop).has_value();
}

RunSummary Learner::summary() const {
  RunSummary summary;
  summary.run_id = config_.run().name();
  summary.weights_hash = hex(current_.weights_hash);
  summary.config_hash = fmt::format("{:016x}", config_hash_);
  summary.git_revision = git_revision();
  summary.run_seed = config_.rollout().run_seed();
  summary.steps = ppo_->steps_total();
  summary.physics_steps = physics_ticks_;
  summary.updates = ppo_->version();
  summary.episodes = episodes_.total;
  summary.wall_s = wall_s();
  summary.mean_return = episodes_.mean([](const auto& o) { return o.return_sum; });
  summary.compared = book_->ledger().duplicate;
  summary.timings = timings_;
  return summary;
}

bool Learner::finish_run(RunSummary& results, const std::function<bool()>& stop) {
  std::vector<EvaluationSummary> evaluations;
  if (config_.evaluation().enabled()) {
    auto evaluated =
        evaluate(evaluation_sets(config_), options_.run_dir + "/evaluation", true, stop);
    if (!evaluated) return false;
    evaluations = std::move(*evaluated);
  }
  results = summary();
  results.evaluations = std::move(evaluations);
  return true;
}

Result<void> Learner::record_evaluation(const EvaluationSet& set, const Evaluated& result) {
  RecordingContext context = recording_context(config_, set.name, git_revision());
  for (std::size_t i = 0; i < result.segments.size(); ++i) {
    const RolloutSegment& segment = result.segments[i];
    const RolloutTask& task = result.tasks[i];
    if (segment.failed != 0) continue;
    context.particles = particles_of(std::span(&segment, 1), task.frame_stride);
    const std::string path =
        fmt::format("{}/recordings/{}_{}.mcap", options_.run_dir, set.name, task.start_index);
    if (Result<void> saved = save_episode(path, task, segment, context); !saved) return saved;
  }
  return {};
}

}  // namespace omentum

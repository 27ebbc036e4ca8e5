#include <fmt/format.h>

#include <algorithm>
#include <cstdio>

#include "core/clock.h"
#include "core/config.h"
#include "core/log.h"
#include "core/task.h"
#include "learner/learner.h"

namespace omentum {
namespace {

std::string duration_text(double seconds) {
  const auto s = static_cast<long>(std::max(0.0, seconds));
  return s >= 3600 ? fmt::format("{}:{:02}:{:02}", s / 3600, s / 60 % 60, s % 60)
                   : fmt::format("{}:{:02}", s / 60, s % 60);
}

/// Sets the metric if there is one of this name.
void set_listed(MetricsRow& row, const std::string& name, double value) {
  if (row.has(name)) row.set(name, value);
}

}  // namespace

void Learner::count_episodes(std::span<const RolloutSegment> segments) {
  for (const RolloutSegment& s : segments) {
    physics_ticks_ += s.physics_ticks;
    for (std::size_t i = 0; i < s.episode_end_step.size(); ++i) {
      const auto outcome = static_cast<Outcome>(s.episode_outcome[i]);
      RecentEpisodes::One one{};
      one.return_sum = s.episode_return[i];
      one.length = s.episode_length[i];
      one.exposure = static_cast<double>(s.episode_exposure[i]);
      one.success = outcome == Outcome::kTargetReached;
      one.held = s.episode_held[i] != 0;
      one.lost = outcome == Outcome::kGraspLost;
      episodes_.add(one);

      EpisodeSummary summary = summary_of(s, i);
      summary.episode = s.end_episode - (s.episode_end_step.size() - i);
      if (const Result<void> sent = bus_->publish_summary(summary); !sent)
        log().debug("summary: {}", sent.error());
    }
  }
}

void Learner::report_update(const UpdateStats& stats) {
  const double spent = seconds_since(started_ns_);
  const double rate =
      static_cast<double>(ppo_->steps_total() - steps_before_) / std::max(spent, 1e-9);
  const double left =
      static_cast<double>(config_.rollout().max_steps() -
                          std::min(config_.rollout().max_steps(), ppo_->steps_total())) /
      std::max(rate, 1e-9);
  const RecentEpisodes& e = episodes_;
  const double mean_return = e.mean([](const auto& o) { return o.return_sum; });
  const double mean_length = e.mean([](const auto& o) { return o.length; });
  const double exposure = e.mean([](const auto& o) { return o.exposure; });
  const double success = e.mean([](const auto& o) { return o.success ? 1.0 : 0.0; });
  const double held = e.mean([](const auto& o) { return o.held ? 1.0 : 0.0; });

  const BusStatistics bus = bus_->statistics();
  MetricsRow row(action_names(config_.task()));
  row.set_update(stats);
  row.set("charts/episodic_return", mean_return);
  row.set("charts/episodic_length", mean_length);
  row.set("charts/SPS", rate);
  row.set("charts/steps_total", static_cast<double>(ppo_->steps_total()));
  row.set("charts/physics_steps_total", static_cast<double>(physics_ticks_));
  row.set("charts/success_rate", success);
  row.set("charts/exposure_fraction", exposure);
  const double lag = config_.rollout().lead() == pb::LEAD_1 && stats.version > 1 ? 1 : 0;
  row.set("policy/lag_min", lag);
  row.set("policy/lag_mean", lag);
  row.set("policy/lag_max", lag);
  row.set("policy/logp_check_max", log_prob_check_max_);
  const Ledger ledger = book_->ledger();
  for (const auto& [name, value] : kLedgerCounters)
    set_listed(row, fmt::format("ledger/{}", name), static_cast<double>(ledger.*value));
  set_workers(row, bus);
  for (const auto& [name, seconds] : timings_) set_listed(row, "time/" + name + "_s", seconds);
  if (const Result<void> written = metrics_->write(stats.version, wall_s(), row); !written) {
    log().warn("metrics: {}", written.error());
  }

  status_.steps_per_s = rate;
  status_.mean_return = mean_return;
  status_.mean_length = mean_length;
  status_.approx_kl = stats.approx_kl;
  status_.entropy = stats.entropy;
  status_.explained_variance = stats.explained_variance;
  say_phase(LearnerPhase::kWaiting);

  if (options_.quiet) return;
  fmt::print(
      "update {}/{}  steps {}  {:5.1f} %  {:.0f} steps/s  left {}  reward/step {:.4f}  exposure "
      "{:.3f}  success {:.2f}  held {:.2f}  entropy {:.3f}  kl {:.4f}  clip {:.3f}  value_loss "
      "{:.4f}  workers {}  weights {}\n",
      stats.version, updates_wanted_, ppo_->steps_total(),
      100.0 * static_cast<double>(stats.version) / static_cast<double>(updates_wanted_), rate,
      duration_text(left), mean_length > 0 ? mean_return / mean_length : 0.0, exposure, success,
      held, stats.entropy, stats.approx_kl, stats.clip_fraction, stats.value_loss,
      bus.workers_alive, hex(current_.weights_hash).substr(0, 8));
  std::fflush(stdout);
}

void Learner::set_workers(MetricsRow& row, const BusStatistics& bus) const {
  double lanes = 0;
  double rate = 0;
  double simulating = 0;
  double declined = 0;
  const std::vector<WorkerStatus> workers = bus_->worker_statuses();
  for (const WorkerStatus& w : workers) {
    lanes += w.lanes;
    rate += w.steps_per_s;
    simulating += w.sim_time_fraction / static_cast<double>(workers.size());
    declined += static_cast<double>(w.tasks_declined_config + w.tasks_declined_epoch +
                                    w.tasks_declined_no_weights + w.tasks_declined_state);
  }
  row.set("workers/alive", bus.workers_alive);
  row.set("workers/lanes", lanes);
  row.set("workers/steps_per_s", rate);
  row.set("workers/sim_time_fraction", simulating);
  row.set("workers/wait_fraction", workers.empty() ? 0 : 1 - simulating);
  row.set("workers/lost_leases", static_cast<double>(bus.worker_crashes));
  row.set("workers/declined", declined);
}

}  // namespace omentum

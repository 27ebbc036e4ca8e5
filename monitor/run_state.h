#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/types.h"
#include "core/wire.h"

namespace omentum {

/// What became of a worker, as far as its status tells.
enum class Presence {
  kAlive,
  kSilent,  ///< its writer is there, but nothing came for kSilentNs: hung or stopped
  kLost,    ///< crashed or unreachable
};

/// A worker's or learner's status is published once a second or more often, a robot's ten times;
/// the deadline of its topic is 2 s (docs/wire.md 3).
inline constexpr std::int64_t kSilentNs = 5'000'000'000;

/// A worker as last heard of.
struct WorkerRow {
  WorkerStatus status;
  std::int64_t heard_at_ns = 0;  ///< steady clock
  bool lost = false;
};

/// A robot as its gateway was last heard of.
struct RobotRow {
  RobotStatus status;
  std::int64_t heard_at_ns = 0;  ///< steady clock
  bool lost = false;
};

/// The learner's figures after one update.
struct CurvePoint {
  std::uint64_t steps = 0;  ///< of the run, so far
  double mean_return = 0, mean_length = 0, approx_kl = 0, entropy = 0, explained_variance = 0;
  double steps_per_s = 0;
};

/// Everything the topics of one run told, as plain values; the newest learner counts. Not
/// thread-safe.
class RunState {
 public:
  explicit RunState(std::string run) : run_(std::move(run)) {}

  void apply(Arrival<LearnerStatus>&& arrival, std::int64_t now_ns);
  void apply(Arrival<WorkerStatus>&& arrival, std::int64_t now_ns);
  void apply(Arrival<RunManifest>&& arrival, std::int64_t now_ns);
  void apply(Arrival<EpisodeSummary>&& arrival, std::int64_t now_ns);
  void apply(Arrival<RobotStatus>&& arrival, std::int64_t now_ns);

  const std::string& run() const { return run_; }
  const std::optional<LearnerStatus>& learner() const { return learner_; }
  const std::optional<RunManifest>& manifest() const { return manifest_; }
  /// By id; those that left on purpose are gone from it.
  const std::map<std::uint32_t, WorkerRow>& workers() const { return workers_; }
  /// By gateway; those that left on purpose are gone from it.
  const std::map<std::uint32_t, RobotRow>& robots() const { return robots_; }
  const std::vector<CurvePoint>& curve() const { return curve_; }
  std::uint64_t episodes() const { return episodes_; }
  std::uint64_t targets_reached() const { return targets_reached_; }

  Presence learner_presence(std::int64_t now_ns) const;
  static Presence presence_of(const WorkerRow& row, std::int64_t now_ns);
  static Presence presence_of(const RobotRow& row, std::int64_t now_ns);

 private:
  void add_to_curve();

  std::string run_;
  std::optional<LearnerStatus> learner_;
  std::int64_t learner_heard_at_ns_ = 0;
  bool learner_lost_ = false;
  std::optional<RunManifest> manifest_;
  std::map<std::uint32_t, WorkerRow> workers_;
  std::map<std::uint32_t, RobotRow> robots_;
  std::vector<CurvePoint> curve_;
  std::size_t curve_stride_ = 1;  ///< updates per point that is kept
  std::size_t updates_seen_ = 0;
  std::uint64_t episodes_ = 0, targets_reached_ = 0;
};

/// What should be zero in a ledger (docs/wire.md 4.3).
struct LedgerBalance {
  std::int64_t received = 0;  ///< received - (admitted + duplicate + stale + invalid + ...)
  std::int64_t granted = 0;   ///< granted - (admitted + outstanding + cancelled + regranted)
  bool balanced() const { return received == 0 && granted == 0; }
};
LedgerBalance balance_of(const Ledger& ledger);

/// Versions that a worker is behind the learner; 0 where either is unknown.
std::uint64_t version_lag(const RunState& state, const WorkerStatus& worker);
/// Share of the run's steps that is done, 0 ... 1; 0 where the learner does not say how many.
double share_done(const LearnerStatus& learner);
/// At the present rate [s]; nothing while nothing moves.
std::optional<double> seconds_left(const LearnerStatus& learner);

/// Alarms that hold now, one line each: those of learner and workers, and what the tool sees itself
/// (nobody speaks, a ledger out of balance).
std::vector<std::string> alarms_of(const RunState& state, std::int64_t now_ns);

const char* name_of(LearnerPhase phase);
const char* name_of(WorkerPhase phase);
const char* name_of(RobotPhase phase);
const char* name_of(Presence presence);

}  // namespace omentum

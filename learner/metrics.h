#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/durable_file.h"
#include "core/result.h"
#include "learner/ppo.h"
#include "learner/tensorboard.h"

namespace omentum {

/// All metric names in column order (docs/learner.md 8); `branches`: action_names(), for
/// entropy_<branch> and kl_<branch>.
std::vector<std::string> metric_names(const std::vector<std::string>& branches);

/// The numbers of one update, by name. set() of an unknown name aborts: the list above is the
/// contract.
class MetricsRow {
 public:
  explicit MetricsRow(std::vector<std::string> branches);

  void set(std::string_view name, double value);
  bool has(std::string_view name) const;
  /// losses/*, policy/version, epsilon, beta and charts/learning_rate from an update.
  void set_update(const UpdateStats& stats);

  /// In column order, only those set.
  std::vector<Scalar> scalars() const;
  double get(std::string_view name) const;  ///< NaN when not set

 private:
  std::vector<std::string> branches_;
  std::vector<std::string> names_;
  std::map<std::string, double, std::less<>> values_;
};

/// metrics.csv, metrics.jsonl and a TensorBoard event file of one run folder: one row per update,
/// flushed per row. The CSV's first columns are `update` and `wall_time_s`; cells not set are
/// empty.
class MetricsWriter {
 public:
  /// Continues files of an earlier session: rows of updates after `resume_update` are dropped,
  /// since the run repeats them. 0 starts afresh. Throws Error when files cannot be opened.
  MetricsWriter(const std::string& folder, const std::vector<std::string>& branches,
                std::uint64_t resume_update, bool mlagents_aliases);

  /// A failure (full disk) is returned; training goes on, and the other files get their row.
  Result<void> write(std::uint64_t update, double wall_time_s, const MetricsRow& row);

  /// Updates of this session whose row some file lacks.
  std::uint64_t incomplete() const { return incomplete_; }
  const std::string& tensorboard_path() const { return tensorboard_.path(); }

 private:
  std::vector<std::string> names_;
  bool mlagents_aliases_ = false;
  std::uint64_t incomplete_ = 0;
  std::optional<AppendFile> csv_, jsonl_;
  TensorboardWriter tensorboard_;
};

}  // namespace omentum

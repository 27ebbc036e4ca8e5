#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/checkpoint_file.h"
#include "core/result.h"
#include "core/types.h"
#include "learner/task_book.h"
#include "proto/checkpoint.pb.h"

namespace omentum {

/// Slots and ledger of a checkpoint, there and back.
void to_disk(const SlotTable& table, std::uint32_t state_format, pb::Checkpoint& disk);
SlotTable slots_from_disk(const pb::Checkpoint& disk);

struct LoadedCheckpoint {
  pb::Checkpoint checkpoint;
  std::string path;
  std::vector<std::string> warnings;  ///< one line per newer file that was corrupt
};

/// The checkpoints of one run folder: checkpoint-<updates>.pb (the newest two), best.pb,
/// milestone-<steps>.pb. Not thread-safe. The folder is created when missing.
class CheckpointStore {
 public:
  /// Steps at which a copy is kept for good. Paper: 0.5, 2.0 and 3.0 M.
  CheckpointStore(std::string folder, std::vector<std::uint64_t> milestones);

  /// Durable write of checkpoint-<updates>.pb, then of best.pb and the milestone where asked for,
  /// then removal of all but the newest two. A failure (full disk) leaves every older file in
  /// place: warn, count, retry at the next update. Aborts for another format_version than
  /// kCheckpointFormat.
  struct Save {
    bool best = false;
    std::optional<std::uint64_t> milestone;
  };
  Result<void> save(const pb::Checkpoint& checkpoint, const Save& what);

  /// The newest good checkpoint, without a numbered one of best.pb and the milestones; empty when
  /// the folder has none. Fails only when there are files and all are bad.
  Result<std::optional<LoadedCheckpoint>> load_newest() const;

  /// best.pb and milestones of the folder, by name.
  std::vector<std::string> others() const;

  /// The milestone that lies in (before, after], if any.
  std::optional<std::uint64_t> crossed_milestone(std::uint64_t before, std::uint64_t after) const;

 private:
  /// Numbers of checkpoint-<updates>.pb, ascending.
  std::vector<std::uint64_t> present() const;
  std::string path_of(std::uint64_t updates) const;

  std::string folder_;
  std::vector<std::uint64_t> milestones_;
};

/// Of two printed configurations: one "path: old -> new" per line, without the `run` part that may
/// differ; empty when equal.
std::string config_difference(const std::string& old_text, const std::string& new_text);

/// Refuses to resume with another configuration: a readable difference, one "path: old -> new" per
/// line, without the `run` part that may differ.
Result<void> check_same_config(const pb::Checkpoint& checkpoint, std::uint64_t config_hash,
                               const std::string& config_text);

/// Epoch of the last session in this folder; 0 = none.
Result<std::uint32_t> last_learner_epoch(const std::string& folder);
/// Epoch of a new session, kept durably in <folder>/learner_epoch: above every earlier one of the
/// folder, and the present time [s since 1970] at least, so that it also grows when the folder was
/// removed. Call before the first publication.
Result<std::uint32_t> next_learner_epoch(const std::string& folder, std::uint32_t unix_s);

}  // namespace omentum

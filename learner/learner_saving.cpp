// What the learner leaves on disk, and what it does while the disk refuses it.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <filesystem>

#include "core/build_id.h"
#include "core/clock.h"
#include "core/config.h"
#include "core/durable_file.h"
#include "core/log.h"
#include "learner/learner.h"
#include "learner/onnx_export.h"

namespace omentum {
namespace {

constexpr double kTellS = 60;  // what cannot be written is told of at this interval [s]

}  // namespace

bool Learner::save_checkpoint(std::optional<std::uint64_t> milestone) {
  pb::Checkpoint checkpoint;
  checkpoint.set_format_version(kCheckpointFormat);
  checkpoint.set_config_text(print_config(config_));
  checkpoint.set_config_hash(config_hash_);
  checkpoint.set_run_seed(config_.rollout().run_seed());
  checkpoint.set_git_revision(git_revision());
  checkpoint.set_build_id(build_id());
  ppo_->save(*checkpoint.mutable_ppo());
  if (config_.rollout().lead() == pb::LEAD_1 && ppo_->version() > 0) {
    to_disk(previous_, *checkpoint.mutable_previous_weights());
  }
  to_disk(book_->table(), kSimStateFormat, checkpoint);
  checkpoint.set_physics_steps_total(physics_ticks_);
  checkpoint.set_episodes_total(episodes_.total);
  for (const RecentEpisodes::One& one : episodes_.recent) {
    pb::RecentEpisode& kept = *checkpoint.add_recent_episode();
    kept.set_return_sum(one.return_sum);
    kept.set_length(one.length);
    kept.set_exposure(one.exposure);
    kept.set_success(one.success);
    kept.set_held(one.held);
    kept.set_lost(one.lost);
  }
  checkpoint.set_wall_s(wall_s());
  const double score = episodes_.mean([](const auto& o) { return o.return_sum; });
  CheckpointStore::Save what;
  what.best = episodes_.recent.size() >= 100 && score > best_score_;
  // One that the disk refused is due still; it then holds a later state.
  if (milestone) milestone_due_ = milestone;
  what.milestone = milestone_due_;
  checkpoint.set_best_score(what.best ? score : best_score_);
  const Result<void> saved = checkpoints_->save(checkpoint, what);
  saved_ns_ = steady_now_ns();
  if (saved) {
    if (!unsaved_.empty()) log().info("event=saved_again steps={}", ppo_->steps_total());
    unsaved_.clear();
    best_score_ = checkpoint.best_score();
    milestone_due_.reset();
    saved_steps_ = ppo_->steps_total();
    // A folder that was removed is made again, for who resumes or reads the run.
    if (const std::string path = options_.run_dir + "/config.txtpb";
        !std::filesystem::exists(path)) {
      log().warn("event=folder_made_again folder={}", options_.run_dir);
      if (const Result<void> written = write_durably(path, print_config(config_)); !written)
        log().error("event=not_written reason=\"{}\"", written.error());
    }
    return true;
  }
  // The last good file is untouched. Told when it begins and every minute.
  if (unsaved_.empty()) unsaved_since_ns_ = saved_ns_;
  if (unsaved_.empty() || seconds_since(unsaved_told_ns_) > kTellS) {
    log().error("event=checkpoint_not_saved steps={} reason=\"{}\" tried again until it is",
                ppo_->steps_total(), saved.error());
    unsaved_told_ns_ = saved_ns_;
  }
  unsaved_ = saved.error();
  return false;
}

// A run is begun anew in its folder only where nothing of it would be lost.
void Learner::refuse_to_overwrite() const {
  namespace fs = std::filesystem;
  std::vector<std::string> left;
  for (const char* name : {"summary.json", "policy.onnx"}) {
    if (fs::exists(options_.run_dir + "/" + name)) left.emplace_back(name);
  }
  if (!left.empty()) {
    throw_error(
        "{}: holds {} of a run, and no checkpoint to go on from: put one back, or --restart, which "
        "moves the folder aside",
        options_.run_dir, fmt::join(left, ", "));
  }
}

// What is computed while nothing can be saved would be lost with this process.
bool Learner::pause_until_saved(std::optional<std::uint64_t> milestone,
                                const std::function<bool()>& stop) {
  log().error("event=paused steps={} nothing saved for {:.0f} s: {}", ppo_->steps_total(),
              seconds_since(unsaved_since_ns_), unsaved_);
  say_phase(LearnerPhase::kWaiting);
  while (!save_checkpoint(milestone)) {
    if (!wait_for_disk(stop)) return false;
  }
  log().info("event=goes_on steps={}", ppo_->steps_total());
  return true;
}

bool Learner::until_written(const std::function<Result<void>()>& write,
                            const std::function<bool()>& stop) {
  std::int64_t told_ns = 0;
  while (true) {
    const Result<void> written = write();
    if (written) return true;
    if (told_ns == 0 || seconds_since(told_ns) > kTellS) {
      log().error("event=not_written reason=\"{}\" tried again until it is", written.error());
      told_ns = steady_now_ns();
    }
    if (!wait_for_disk(stop)) return false;
  }
}

Result<void> Learner::export_policy() const {
  return export_onnx(options_.run_dir + "/policy.onnx", shape_, current_,
                     onnx_metadata(config_.task(), git_revision()));
}

Result<void> Learner::write_results(const RunSummary& results) {
  // Without it the folder was removed since the last checkpoint.
  if (!std::filesystem::exists(options_.run_dir + "/config.txtpb")) {
    if (!save_checkpoint(std::nullopt)) return Failure{unsaved_};
    if (const Result<void> exported = export_policy(); !exported) return exported;
  }
  return write_summary(options_.run_dir + "/summary.json", results);
}

bool Learner::wait_for_disk(const std::function<bool()>& stop) {
  const std::int64_t since = steady_now_ns();
  while (seconds_since(since) < kRetrySaveS) {
    if (stop() || bus_->superseded()) return false;
    bus_->serve(*book_, steady_now_ns());
    bus_->wait(std::int64_t{100'000'000});
  }
  return true;
}

int Learner::stopped() {
  const bool saved = save_checkpoint(std::nullopt);
  say_ledger();
  bus_->finish(std::int64_t{2'000'000'000});
  if (saved) {
    log().info("stopped steps={} of={} resume with the same run name", ppo_->steps_total(),
               config_.rollout().max_steps());
    return 130;
  }
  log().error("stopped steps={} of={} NOT SAVED: {}; {}", ppo_->steps_total(),
              config_.rollout().max_steps(), unsaved_,
              saved_steps_ ? fmt::format("the newest checkpoint is of {} steps", *saved_steps_)
                           : "there is no checkpoint");
  return 1;
}

}  // namespace omentum

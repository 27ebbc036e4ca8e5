// What operators ask of a running learner (topic control/command).
#include <utility>

#include "core/log.h"
#include "learner/learner.h"

namespace omentum {

void Learner::obey_commands() {
  for (const ControlCommand& command : bus_->take_commands()) {
    log().info("event=command action={} issuer={} request={}",
               static_cast<std::uint32_t>(command.action), command.issuer, command.request);
    obey(command);
  }
}

void Learner::obey(const ControlCommand& command) {
  const std::uint64_t updates = ppo_->version();
  switch (command.action) {
    case ControlAction::kPause:
    case ControlAction::kResume:
      paused_ = command.action == ControlAction::kPause;
      bus_->pause_grants(paused_);
      say_phase(paused_ ? LearnerPhase::kPaused : LearnerPhase::kWaiting);
      return bus_->reply(command, true,
                         paused_ ? "no grants until resume; what is out comes in" : "goes on");
    case ControlAction::kEvaluate:
      if (updates >= updates_wanted_)
        return bus_->reply(command, false, "the run is over and evaluates by itself");
      evaluation_wanted_ = true;
      return bus_->reply(command, true,
                         fmt::format("evaluates before the next batch, into evaluation/update-N; "
                                     "{} updates so far",
                                     updates));
    case ControlAction::kCheckpoint: {
      const bool saved = save_checkpoint(std::nullopt);
      return bus_->reply(command, saved,
                         saved ? fmt::format("saved at {} steps", ppo_->steps_total()) : unsaved_);
    }
    case ControlAction::kStop:
      stop_wanted_ = true;
      return bus_->reply(command, true, "stops with a checkpoint that the same run name resumes");
    case ControlAction::kFramesOn:
    case ControlAction::kFramesOff: {
      const bool on = command.action == ControlAction::kFramesOn && command.frames_hz > 0;
      const std::uint32_t slots = config_.rollout().slots();
      if (command.slot >= slots) {
        return bus_->reply(command, false,
                           fmt::format("slot {}, allowed 0 ... {}", command.slot, slots - 1));
      }
      bus_->watch_slot(command.slot, on ? command.frames_hz : 0.0F);
      return bus_->reply(command, true,
                         fmt::format("frames of slot {} {} from its next task on", command.slot,
                                     on ? "on" : "off"));
    }
    case ControlAction::kDrain:
      // The worker itself answers, if there is one. One that has just begun need not be known here
      // yet: that there is none is said when the command comes again.
      for (const WorkerStatus& worker : bus_->worker_statuses()) {
        if (worker.worker_id == command.worker_id) return;
      }
      if (std::exchange(drain_asked_, command.request) != command.request) return;
      return bus_->reply(command, false, fmt::format("no worker {} is alive", command.worker_id));
  }
}

bool Learner::folder_is_old() const {
  return !options_.restart && book_->ledger().admitted == 0 &&
         bus_->epoch_of_workers() > folder_epoch_;
}

bool Learner::is_second() const {
  const std::uint32_t older = bus_->older_epoch();
  return older != 0 && older != folder_epoch_ && book_->ledger().admitted == admitted_before_;
}

std::string Learner::second_learner() const {
  return fmt::format(
      "a learner of run {} trains already (epoch {}, domain {}, another folder than {}): name this "
      "run otherwise (--run), or stop that one first",
      config_.run().name(), bus_->older_epoch(), config_.run().domain(), options_.run_dir);
}

}  // namespace omentum

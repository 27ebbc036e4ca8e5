#pragma once

#include <csignal>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "dvrk_gateway/dvrk_double/attached_tissue.h"
#include "dvrk_gateway/dvrk_double/disturbed_link.h"
#include "dvrk_gateway/dvrk_double/dvrk_double.h"
#include "dvrk_gateway/protocol/udp_socket.h"

namespace omentum {

struct DoubleProgramOptions {
  std::string host = "127.0.0.1";  ///< the stream goes there, until somebody else sends
  std::uint16_t port = 0;
  DoubleOptions robot;
  Disturbance network;         ///< of both directions
  double period_jitter_s = 0;  ///< periods begin so much later, uniform from 0
  std::uint64_t seed = 1;
  double seconds = 0;           ///< 0: until told to end
  std::vector<std::string> at;  ///< "SECONDS COMMAND", since run() began
  pb::ArmEffects effects;
  ToolMount mount;
  std::shared_ptr<const SimSetup> tissue;  ///< none: nothing to touch
};

/// The double on a real socket and the real clock. Its operator types commands, one per line; each
/// change of the operating state is told in the log.
class DoubleProgram {
 public:
  /// Throws Error: one line with the option and what is allowed.
  explicit DoubleProgram(const DoubleProgramOptions& options);

  /// Until `stop` is not zero, the operator says quit or the time is over. Commands come from the
  /// descriptor `operator_input` until it ends.
  void run(const volatile std::sig_atomic_t& stop, int operator_input);

  /// One command of the operator; why not, where it is none. The thread of run().
  Result<void> execute(const std::string& command);
  /// What the operator can type, a line each.
  static std::string commands_help();

 private:
  struct Timed {
    double time_s = 0;
    std::string command;
  };
  void start_robot();
  void period(double time_s);
  void touch_tissue();
  void tell_changes();
  void tell_state();
  void place_arm();
  void carry_arm(std::optional<double> roll_rad);
  void move_by_hand(const PsmJoints& q);
  void read_operator(int input);
  void send_foreign();

  DoubleProgramOptions options_;
  UdpAddress client_;
  SteadyClock clock_;
  std::unique_ptr<UdpSocket> socket_;
  UdpSocket stranger_;
  std::unique_ptr<DisturbedLink> network_;
  std::optional<DvrkDouble> robot_;
  std::optional<AttachedTissue> tissue_;
  std::vector<Timed> script_;  ///< latest first
  std::string typed_;          ///< the operator's unfinished line
  OperatingState told_;
  std::array<std::uint64_t, static_cast<std::size_t>(Refusal::kCount)> told_refusals_{};
  double started_s_ = 0;  ///< of this robot process, since the program's start
  double touched_s_ = 0;
  std::uint64_t missed_periods_ = 0;
  bool operator_listens_ = true, foreign_ = false, restart_asked_ = false, quit_ = false;
};

}  // namespace omentum

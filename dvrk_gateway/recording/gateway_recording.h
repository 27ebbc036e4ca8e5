#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "dvrk_gateway/loop/session.h"
#include "dvrk_gateway/recording/robot_recorder.h"
#include "dvrk_gateway/recording/sensor_sources.h"
#include "proto/config.pb.h"

namespace CLI {
class App;
}

namespace omentum {

/// What dvrk_gateway records, by its options (docs/dvrk.md 9).
struct RecordingOptions {
  std::string record = "recordings";  ///< FILE.mcap, a folder for files named by time, or none
  std::string plain_folder;           ///< the plain folder as well; empty: none
  std::vector<std::string> sources;   ///< NAME=udp:PORT or NAME=file:PATH
};

/// --record, --record-folder, --source.
void add_recording_options(CLI::App& app, RecordingOptions& options);

/// What a recording says of its session.
struct RecordedSessionFacts {
  std::string mode;          ///< of the gateway
  std::string registration;  ///< path of registration.txtpb; empty: none
  std::string revision;      ///< git_revision() of the program
  bool dry_run = false;
};

/// Path of the file that `record` asks for: itself where it ends in .mcap, else a file in that
/// folder, named by time and mode: 2026-01-31T12-00-00Z-twin.mcap.
std::string recording_path(const std::string& record, const std::string& mode,
                           std::int64_t now_unix_ns);

/// All that is recorded of one session, from before it until after its end. Make it before the
/// session: what cannot be recorded is told before the robot is spoken to.
class GatewayRecording {
 public:
  /// Throws Error, one line with the option.
  GatewayRecording(const RecordingOptions& options, const RecordedSessionFacts& facts,
                   const pb::Config& config, const SafetySetup& safety);

  /// For GatewaySession::attend(); appends nothing where nothing is recorded.
  void append_to(std::vector<GatewayObserver*>& observers);
  /// A disk that fails is a fault of this session: the arm is stopped.
  void stop_on_failure(OperatorEvents& events);
  /// After the session has ended: closes the file, writes the plain folder and prints a line for
  /// each. False, with a line on the log, where something is missing.
  bool finish();

 private:
  std::string plain_folder_;
  std::unique_ptr<RobotRecorder> recorder_;
  std::unique_ptr<SensorSources> sources_;  // after the recorder, which it feeds
};

}  // namespace omentum

#pragma once

#include <atomic>
#include <functional>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "dvrk_gateway/recording/robot_recorder.h"
#include "dvrk_gateway/recording/sensor_samples.h"

namespace omentum {

/// One --source of dvrk_gateway (docs/formats.md 12).
struct SensorSourceOptions {
  std::string text;  ///< as given: force=udp:5000, cloud=file:clouds.csv
  SensorKind kind = SensorKind::kForce;
  std::uint16_t port = 0;  ///< of udp; 0: a file
  std::string path;        ///< of a table that grows while the session runs
};

/// KIND=udp:PORT, a port of 1 to 65535, or KIND=file:PATH. Throws Error, one line with the option
/// and what is allowed.
SensorSourceOptions parse_sensor_source(const std::string& text);

/// Where samples come from: a port or a table. One thread.
class SensorSource {
 public:
  /// Hands over a sample; or, with null, a line that could not be read.
  using Take = std::function<void(SensorKind, SensorMessage)>;

  SensorSource() = default;
  virtual ~SensorSource() = default;
  SensorSource(const SensorSource&) = delete;
  SensorSource& operator=(const SensorSource&) = delete;

  /// Takes in what has arrived since the last call, of a flood a part; does not wait. `take` is
  /// called on this thread before poll() returns. Never throws for what a sensor says.
  virtual void poll(const Take& take) = 0;
};

/// Of a table only rows that are appended from now on; one that is not there yet is waited for.
/// Throws Error, one line with the option: a port in use, a path that is no file.
std::unique_ptr<SensorSource> open_sensor_source(const SensorSourceOptions& options);

/// Reads all sources on a thread of its own, every 5 ms, into a recording. Made and ended by one
/// thread.
class SensorSources {
 public:
  /// `recorder` must outlive it. Throws Error as open_sensor_source() does.
  SensorSources(const std::vector<std::string>& sources, RobotRecorder& recorder);
  ~SensorSources();
  SensorSources(const SensorSources&) = delete;
  SensorSources& operator=(const SensorSources&) = delete;

  /// What has arrived until now is handed over; the thread has ended. Called again it does nothing.
  void end();

 private:
  void poll();

  RobotRecorder& recorder_;
  std::vector<std::unique_ptr<SensorSource>> sources_;
  std::atomic<bool> end_{false};
  std::thread thread_;  // last: uses everything above
};

}  // namespace omentum

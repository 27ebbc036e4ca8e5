#pragma once

#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <fstream>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "dvrk_gateway/loop/session.h"
#include "dvrk_gateway/recording/recording_file.h"

namespace omentum {

struct RobotRecorderOptions {
  std::string path;          ///< of the MCAP file; a folder that is missing is made
  RecordingSetup setup;      ///< start_ns: of the session's clock
  RecordingContext context;  ///< of the episodes
  /// Refused where the disk has less left: nearly three hours of a recording, some 20 kB/s.
  std::uint64_t min_free_bytes = 200'000'000;
  /// Control periods that wait for the disk, 10 s of them: then the recording has failed, and what
  /// comes is lost and counted.
  std::size_t longest_queue = 500;
};

/// Records a session of the gateway into one MCAP file (docs/dvrk.md 9). A thread of its own
/// writes, so that a slow disk holds up neither the operator's keys nor the rollout; what is older
/// than a second is with the system and survives a kill of this process.
class RobotRecorder final : public GatewayObserver {
 public:
  /// Throws Error, one line: the file exists, cannot be opened, or the disk is nearly full.
  explicit RobotRecorder(const RobotRecorderOptions& options);
  ~RobotRecorder() override;

  /// `fault` is called once, by on_period(), when the disk no longer takes the recording.
  void stop_on_failure(std::function<void()> fault) { fault_ = std::move(fault); }

  void on_period(const Period& period) override;
  void on_episode(const RolloutTask& task, const RolloutSegment& segment) override;
  /// A sample of another sensor, at its arrival by the session's clock. Any thread.
  void add_sample(const std::string& topic, std::shared_ptr<const google::protobuf::Message> sample,
                  std::int64_t arrival_ns);
  /// A line of another sensor that could not be read. Any thread.
  void count_bad_source_line();

  /// Writes what waits and closes the file; the second call and later ones do nothing. A file in
  /// which nothing was recorded, since the session did not begin, is removed. Fails, with what was
  /// lost, if at any time the disk did not take it.
  Result<void> finish();

  const std::string& path() const { return path_; }
  bool failed() const { return failed_; }
  std::uint64_t lost() const { return lost_; }  ///< samples and periods that are not in the file
  std::uint64_t unseen_periods() const { return unseen_periods_; }  ///< never came here

 private:
  using Job = std::function<void(RecordingFile&)>;
  void add(Job job, bool is_period = false);
  void run();
  void write(const std::deque<Job>& jobs);
  void fail(const std::string& why);
  void flush_each_second(RecordingFile& file, std::int64_t now_ns);

  std::string path_;
  RecordingContext context_;
  std::size_t longest_queue_;
  std::function<void()> fault_;
  bool fault_told_ = false;
  std::ofstream stream_;
  RecordingFile file_;  // of the writing thread, until finish() has joined it
  std::int64_t flushed_ns_;

  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Job> jobs_;
  std::size_t periods_waiting_ = 0;  ///< of jobs_
  bool end_ = false, anything_ = false;
  std::atomic<std::int64_t> newest_ns_;  ///< begin of the newest period
  std::atomic<std::uint64_t> lost_{0}, unseen_periods_{0};
  std::atomic<bool> failed_{false};
  std::string why_;     ///< of the failure
  std::thread thread_;  // last: uses everything above
};

}  // namespace omentum

#include "dvrk_gateway/recording/robot_recorder.h"

#include <cerrno>
#include <filesystem>
#include <system_error>
#include <utility>

#include "core/check.h"
#include "core/log.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

constexpr std::int64_t kFlushInterval_ns = 1'000'000'000;

std::string system_error_text() {
  return errno == 0 ? "the file cannot be written" : std::generic_category().message(errno);
}

std::ofstream open_new(const std::string& path, std::uint64_t min_free_bytes) {
  std::error_code failed;
  const fs::path folder = fs::absolute(path).parent_path();
  fs::create_directories(folder, failed);
  if (failed)
    throw_error("--record {}: {} cannot be made: {}", path, folder.string(), failed.message());
  if (fs::exists(path) && !fs::is_character_file(path) && !fs::is_fifo(path)) {
    throw_error("--record {}: {}", path,
                fs::is_directory(path) ? "is a folder" : "exists; a recording replaces nothing");
  }
  const fs::space_info space = fs::space(folder, failed);
  if (!failed && space.available < min_free_bytes) {
    throw_error("--record {}: {:.0f} MB free on the disk, needed {:.0f} MB", path,
                1e-6 * static_cast<double>(space.available),
                1e-6 * static_cast<double>(min_free_bytes));
  }
  errno = 0;
  std::ofstream stream(path, std::ios::binary | std::ios::trunc);
  if (!stream) throw_error("--record {}: cannot be opened: {}", path, system_error_text());
  return stream;
}

/// Frames are of before every stride-th step and after the last.
std::uint32_t particles_of(const RolloutSegment& segment, std::uint32_t frame_stride) {
  if (frame_stride == 0) return 0;
  const std::size_t frames = segment.steps / frame_stride + 1;
  return static_cast<std::uint32_t>(segment.frame_positions_in_world_m.size() / (3 * frames));
}

}  // namespace

RobotRecorder::RobotRecorder(const RobotRecorderOptions& options)
    : path_(options.path),
      context_(options.context),
      longest_queue_(options.longest_queue),
      stream_(open_new(options.path, options.min_free_bytes)),
      file_(stream_, options.setup),
      flushed_ns_(options.setup.start_ns),
      newest_ns_(options.setup.start_ns) {
  if (!stream_) throw_error("--record {}: {}", path_, system_error_text());
  thread_ = std::thread([this] { run(); });
}

RobotRecorder::~RobotRecorder() {
  if (const Result<void> finished = finish(); !finished) log().error("{}", finished.error());
}

void RobotRecorder::on_period(const Period& period) {
  newest_ns_ = period.began_ns;
  add(
      [this, period](RecordingFile& file) {
        file.add_period(period);
        unseen_periods_ = file.unseen_periods();
        flush_each_second(file, period.began_ns);
      },
      true);
  if (!failed_ || fault_told_) return;
  fault_told_ = true;
  log().error("recording {}: {}: the arm is stopped", path_, why_);
  if (fault_) fault_();
}

void RobotRecorder::on_episode(const RolloutTask& task, const RolloutSegment& segment) {
  RecordingContext context = context_;
  context.particles = particles_of(segment, task.frame_stride);
  add([this, task, segment, context, end_ns = newest_ns_.load()](RecordingFile& file) {
    const Result<void> added = file.add_episode(task, segment, context, end_ns);
    if (added) return;
    ++lost_;  // what else is recorded goes on
    log().error("recording {}: {}", path_, added.error());
  });
}

void RobotRecorder::add_sample(const std::string& topic,
                               std::shared_ptr<const google::protobuf::Message> sample,
                               std::int64_t arrival_ns) {
  add([topic, sample = std::move(sample), arrival_ns](RecordingFile& file) {
    file.add_sample(topic, *sample, arrival_ns);
  });
}

void RobotRecorder::count_bad_source_line() {
  add([](RecordingFile& file) { file.count_bad_source_line(); });
}

void RobotRecorder::flush_each_second(RecordingFile& file, std::int64_t now_ns) {
  if (now_ns - flushed_ns_ < kFlushInterval_ns) return;
  flushed_ns_ = now_ns;
  errno = 0;
  file.flush();
}

void RobotRecorder::add(Job job, bool is_period) {
  const std::scoped_lock lock(mutex_);
  if (failed_ || end_) {
    ++lost_;
    return;
  }
  if (periods_waiting_ >= longest_queue_) {
    ++lost_;
    fail(fmt::format("the disk takes nothing, {} control periods wait", periods_waiting_));
    return;
  }
  if (is_period) ++periods_waiting_;
  anything_ = true;
  jobs_.push_back(std::move(job));
  changed_.notify_one();
}

/// The first reason counts. With mutex_ held.
void RobotRecorder::fail(const std::string& why) {
  if (why_.empty()) why_ = why;
  failed_ = true;
}

void RobotRecorder::run() {
  for (bool end = false; !end;) {
    std::deque<Job> jobs;
    {
      std::unique_lock lock(mutex_);
      changed_.wait(lock, [this] { return end_ || !jobs_.empty(); });
      jobs.swap(jobs_);
      periods_waiting_ = 0;
      end = end_;
    }
    write(jobs);
  }
}

void RobotRecorder::write(const std::deque<Job>& jobs) {
  for (std::size_t done = 0; done < jobs.size(); ++done) {
    std::string why;
    try {
      jobs[done](file_);
      if (!stream_) why = system_error_text();
    } catch (const std::exception& error) {
      why = error.what();
    }
    if (why.empty()) continue;
    const std::scoped_lock lock(mutex_);
    fail(why);
    lost_ += jobs.size() - done;
    return;
  }
}

Result<void> RobotRecorder::finish() {
  {
    const std::scoped_lock lock(mutex_);
    end_ = true;
    changed_.notify_one();
  }
  if (!thread_.joinable()) return {};
  thread_.join();
  errno = 0;
  const Result<void> finished = file_.finish();
  stream_.close();
  if (!finished || !stream_) fail(system_error_text());
  std::error_code ignored;
  if (!anything_ && fs::is_regular_file(path_, ignored)) fs::remove(path_, ignored);
  if (!failed_ && lost_ == 0) return {};
  if (!failed_) why_ = "an episode does not fit";
  return Failure{
      fmt::format("recording {}: {}; {} samples are not in it", path_, why_, lost_.load())};
}

}  // namespace omentum

#include "core/episode_recording.h"

#include <fmt/core.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <span>
#include <sstream>
#include <type_traits>

#include "core/check.h"
#include "core/cloud_message.h"
#include "core/config.h"
#include "core/constants.h"
#include "core/durable_file.h"
#include "core/mcap.h"
#include "core/message_rows.h"
#include "core/read_file.h"
#include "core/segment_fields.h"
#include "core/task.h"
#include "proto/foxglove.pb.h"
#include "proto/recording.pb.h"

namespace omentum {
namespace {

using message_rows::get_one, message_rows::put_one, message_rows::put_row;
using message_rows::take_row, message_rows::width_of;

constexpr std::uint32_t kFormatVersion = 1;
// A recording is one episode of one process; these bound what a damaged header can ask for.
constexpr std::uint32_t kMaxSteps = 1'000'000;
constexpr std::uint32_t kMaxObservation = 1'000'000;

std::uint64_t time_of(std::uint32_t step, const RecordingContext& context) {
  return static_cast<std::uint64_t>(std::llround(step * context.control_period * 1e9));
}

google::protobuf::Timestamp stamp_of(std::uint64_t time_ns) {
  return google::protobuf::util::TimeUtil::NanosecondsToTimestamp(
      static_cast<std::int64_t>(time_ns));
}

/// Calls see(name, member) for what the header repeats of the task.
template <typename Task, typename See>
void for_each_task_number(Task& task, See&& see) {
  see("policy_version", task.policy_version);
  see("config_hash", task.config_hash);
  see("kind", task.kind);
  see("start_set", task.start_set);
  see("start_index", task.start_index);
  see("greedy", task.greedy);
  see("run_seed", task.run_seed);
  see("slot", task.slot);
  see("episode", task.episode);
  see("episode_step", task.episode_step);
  see("episode_limit", task.episode_limit);
  see("reset", task.reset);
  see("state_format", task.state_format);
  see("start_hash", task.start_hash);
  see("frame_stride", task.frame_stride);
  see("task_steps", task.steps);
  see("policy_steps", task.policy_steps);
  see("hold_steps", task.hold_steps);
  see("segment", task.segment);
}

/// Calls see(array, ArrayField) for what a recording holds of each step, or of the episode.
template <typename Segment, typename See>
void for_each_recorded(Segment& segment, bool per_step, See&& see) {
  for_each_array(segment, [&](auto& array, const ArrayField& about) {
    using Entry = typename std::decay_t<decltype(array)>::value_type;
    if constexpr (std::is_arithmetic_v<Entry>) {
      const bool of_step = about.rows == Rows::kStep || about.rows == Rows::kRecordedStep;
      if (about.recorded_as != nullptr && of_step == per_step) see(array, about);
    }
  });
}

/// What every step of a recording has.
bool required(const void* array, const RolloutSegment& segment) {
  return array == &segment.observations || array == &segment.actions || array == &segment.rewards ||
         array == &segment.flags;
}

pb::EpisodeHeader make_header(const RolloutTask& task, const RolloutSegment& segment,
                              const RecordingContext& context) {
  pb::EpisodeHeader header;
  for_each_task_number(
      task, [&header](const char* name, const auto& number) { put_one(header, name, number); });
  header.set_weights_hash(task.weights_hash.data(), task.weights_hash.size());
  if (!task.start_state.empty())
    header.set_start_state(task.start_state.data(), task.start_state.size());
  header.set_format_version(kFormatVersion);
  header.set_name(context.name);
  header.set_config_text(context.config_text);
  header.set_config_hash(context.config_hash);
  header.set_git_revision(context.git_revision);
  header.set_control_period_s(context.control_period);
  header.set_particles(context.particles);
  header.set_steps(segment.steps);
  header.set_source(static_cast<std::uint32_t>(segment.source));
  header.set_build_id(segment.build_id);
  const std::size_t observations = segment.observations.size();
  header.set_observation_size(
      static_cast<std::uint32_t>(segment.steps > 0 ? observations / segment.steps : 0));
  return header;
}

pb::StepRecord make_step(const RolloutSegment& segment, std::uint32_t step) {
  pb::StepRecord record;
  record.set_step(step);
  for_each_recorded(segment, true, [&](const auto& array, const ArrayField& about) {
    if (array.empty()) return;
    const std::size_t width = array.size() / segment.steps;
    put_row(record, about.recorded_as, array.data() + step * width, width);
  });
  record.set_held((segment.flags[step] & step_flag::kHeld) != 0);
  return record;
}

foxglove::PoseInFrame make_pose(const float* p, const RollPitchYaw& turn, std::uint64_t time_ns) {
  foxglove::PoseInFrame message;
  *message.mutable_timestamp() = stamp_of(time_ns);
  message.set_frame_id("W");
  foxglove::Vector3& position = *message.mutable_pose()->mutable_position();
  position.set_x(static_cast<double>(p[0]));
  position.set_y(static_cast<double>(p[1]));
  position.set_z(static_cast<double>(p[2]));
  // Viewers draw poses as an arrow along x; the shaft points down, which is a quarter turn about y.
  Eigen::Quaterniond q(std::sqrt(0.5), 0, std::sqrt(0.5), 0);
  if (turn != RollPitchYaw::Zero()) q = Eigen::Quaterniond(rotation_of(turn)) * q;
  foxglove::Quaternion& orientation = *message.mutable_pose()->mutable_orientation();
  if (q.x() != 0) orientation.set_x(q.x());
  orientation.set_y(q.y());
  if (q.z() != 0) orientation.set_z(q.z());
  orientation.set_w(q.w());
  return message;
}

pb::EpisodeResult make_result(const RolloutSegment& segment) {
  pb::EpisodeResult result;
  for_each_recorded(segment, false, [&](const auto& array, const ArrayField& about) {
    if (array.size() >= about.width) put_row(result, about.recorded_as, array.data(), about.width);
  });
  result.set_end_hash(segment.end_hash);
  if (!segment.failure.empty()) result.set_failure(segment.failure);
  result.set_physics_ticks(segment.physics_ticks);
  return result;
}

Result<void> check_sizes(const std::string& path, const RolloutSegment& segment,
                         const RecordingContext& context) {
  const std::size_t steps = segment.steps;
  bool good = true;
  for_each_recorded(segment, true, [&](const auto& array, const ArrayField& about) {
    if (array.empty() && !required(&array, segment)) return;
    const bool varies = about.width == kObservationWidth || about.width == kActionWidth;
    good = good &&
           (varies ? steps == 0 || array.size() % steps == 0 : array.size() == steps * about.width);
  });
  if (!good)
    return Failure{fmt::format("{}: arrays of the segment do not fit its {} steps", path, steps)};
  const std::size_t frame = std::size_t{3} * context.particles;
  if (frame == 0 ? !segment.frame_positions_in_world_m.empty()
                 : segment.frame_positions_in_world_m.size() % frame != 0) {
    return Failure{fmt::format("{}: frames do not fit {} particles", path, context.particles)};
  }
  return {};
}

void take_header(const pb::EpisodeHeader& header, EpisodeRecording& recording) {
  RecordingContext& context = recording.context;
  context.name = header.name();
  context.config_text = header.config_text();
  context.config_hash = header.config_hash();
  context.git_revision = header.git_revision();
  context.control_period = header.control_period_s();
  context.particles = header.particles();
  RolloutTask& task = recording.task;
  for_each_task_number(task, [&header]<typename T>(const char* name, T& number) {
    number = get_one<T>(header, name);
  });
  std::memcpy(task.weights_hash.data(), header.weights_hash().data(),
              std::min(task.weights_hash.size(), header.weights_hash().size()));
  const auto state = std::as_bytes(std::span(header.start_state()));
  task.start_state.assign(state.begin(), state.end());
  recording.segment.slot = task.slot;
  recording.segment.segment = task.segment;
  recording.segment.policy_version = task.policy_version;
  recording.segment.source = static_cast<Source>(header.source());
  recording.segment.build_id = header.build_id();
}

/// Entries of an action: those of the steps before; of the first step, as many as an action has.
std::size_t action_width(const RolloutSegment& segment, std::size_t found) {
  if (segment.steps > 0) return segment.actions.size() / segment.steps;
  return found == kActionBranches ? kActionBranches : action_columns(0);
}

/// Appends one step; false if it does not follow the steps before in number and shape.
bool take_step(const pb::StepRecord& record, std::size_t observation, RolloutSegment& segment) {
  bool good = record.step() == segment.steps;
  for_each_recorded(segment, true, [&](const auto& array, const ArrayField& about) {
    const std::size_t width = width_of(record, about.recorded_as);
    const std::size_t wanted = about.width == kObservationWidth ? observation
                               : about.width == kActionWidth    ? action_width(segment, width)
                                                                : about.width;
    good = good && (width == wanted || (width == 0 && !required(&array, segment)));
  });
  if (!good) return false;
  for_each_recorded(segment, true, [&](auto& array, const ArrayField& about) {
    take_row(record, about.recorded_as, array);
  });
  ++segment.steps;
  return true;
}

bool take_cloud(const foxglove::PointCloud& cloud, std::uint32_t step,
                EpisodeRecording& recording) {
  const std::size_t bytes = std::size_t{kCloudPointBytes} * recording.context.particles;
  if (bytes == 0 || cloud.data().size() != bytes || cloud.point_stride() != kCloudPointBytes)
    return false;
  std::vector<float>& positions = recording.segment.frame_positions_in_world_m;
  const std::size_t before = positions.size();
  positions.resize(before + bytes / sizeof(float));
  std::memcpy(positions.data() + before, cloud.data().data(), bytes);
  recording.frame_steps.push_back(step);
  return true;
}

void take_result(const pb::EpisodeResult& result, RolloutSegment& segment) {
  for_each_recorded(segment, false, [&](auto& array, const ArrayField& about) {
    if (width_of(result, about.recorded_as) != about.width) return;
    array.clear();
    take_row(result, about.recorded_as, array);
  });
  segment.end_hash = result.end_hash();
  segment.failure = result.failure();
  segment.physics_ticks = result.physics_ticks();
}

/// A header with the messages that follow it, up to the next header, in file order.
struct EpisodeMessages {
  const McapMessage* header = nullptr;
  std::vector<const McapMessage*> messages;
};

std::vector<EpisodeMessages> split_episodes(const McapContent& content) {
  std::vector<EpisodeMessages> episodes;
  for (const McapMessage& message : content.messages) {
    const std::string& topic = content.channels.at(message.channel).topic;
    if (topic == "/episode") episodes.push_back({&message, {}});
    if (!episodes.empty() && (topic == "/step" || topic == "/tissue" || topic == "/result"))
      episodes.back().messages.push_back(&message);
  }
  return episodes;
}

bool take_message(const std::string& topic, const McapMessage& message,
                  const pb::EpisodeHeader& header, EpisodeRecording& recording) {
  if (topic == "/step") {
    pb::StepRecord record;
    // Behind the last step: of an episode whose header is damaged.
    return record.ParseFromString(message.data) && record.step() < header.steps() &&
           take_step(record, header.observation_size(), recording.segment);
  }
  if (topic == "/tissue") {
    foxglove::PointCloud cloud;
    return cloud.ParseFromString(message.data) && take_cloud(cloud, message.sequence, recording);
  }
  pb::EpisodeResult result;
  if (!result.ParseFromString(message.data)) return false;
  take_result(result, recording.segment);
  return true;
}

Result<EpisodeRecording> read_episode(const std::string& name, const McapContent& content,
                                      const EpisodeMessages& part) {
  pb::EpisodeHeader header;
  if (!header.ParseFromString(part.header->data))
    return Failure{fmt::format("{}: no episode header", name)};
  if (header.format_version() != kFormatVersion) {
    return Failure{fmt::format("{}: recording format {}, this program reads {}", name,
                               header.format_version(), kFormatVersion)};
  }
  if (header.steps() > kMaxSteps || header.observation_size() > kMaxObservation) {
    return Failure{fmt::format("{}: header asks for {} steps of {} values", name, header.steps(),
                               header.observation_size())};
  }
  EpisodeRecording recording;
  recording.complete = content.complete;
  recording.problems = content.problems;
  take_header(header, recording);
  std::size_t bad = 0;
  for (const McapMessage* message : part.messages) {
    const std::string& topic = content.channels.at(message->channel).topic;
    bad += take_message(topic, *message, header, recording) ? 0 : 1;
  }
  if (bad > 0)
    recording.problems.push_back(
        fmt::format("{} messages out of order or malformed, dropped", bad));
  if (recording.segment.steps != header.steps()) {
    recording.problems.push_back(
        fmt::format("{} of {} steps are there", recording.segment.steps, header.steps()));
  }
  return recording;
}

}  // namespace

Result<std::vector<EpisodeRecording>> parse_episodes(const std::string& name,
                                                     const std::string& bytes) {
  const McapContent content = read_mcap(bytes);
  const std::vector<EpisodeMessages> parts = split_episodes(content);
  if (parts.empty()) {
    const std::string corrupt =
        content.problems.empty() ? "" : fmt::format("corrupt: {}; ", content.problems.front());
    return Failure{fmt::format("{}: {}no episode header", name, corrupt)};
  }
  std::vector<EpisodeRecording> episodes;
  for (const EpisodeMessages& part : parts) {
    Result<EpisodeRecording> episode = read_episode(name, content, part);
    if (!episode) return Failure{episode.error()};
    episodes.push_back(std::move(episode).value());
  }
  return episodes;
}

Result<EpisodeRecording> parse_episode(const std::string& name, const std::string& bytes) {
  Result<std::vector<EpisodeRecording>> episodes = parse_episodes(name, bytes);
  if (!episodes) return Failure{episodes.error()};
  std::vector<EpisodeRecording> all = std::move(episodes).value();
  if (all.size() > 1) {
    all.front().problems.push_back(
        fmt::format("{} episodes are there, this is the first", all.size()));
  }
  return std::move(all.front());
}

EpisodeWriter::EpisodeWriter(McapWriter& writer, bool with_tool)
    : writer_(writer),
      episode_(writer.add_channel("/episode", *pb::EpisodeHeader::descriptor())),
      step_(writer.add_channel("/step", *pb::StepRecord::descriptor())) {
  if (with_tool) tool_ = writer.add_channel("/tool", *foxglove::PoseInFrame::descriptor());
  tissue_ = writer.add_channel("/tissue", *foxglove::PointCloud::descriptor());
  result_ = writer.add_channel("/result", *pb::EpisodeResult::descriptor());
}

std::vector<RollPitchYaw> turns_of_steps(const RolloutSegment& segment,
                                         const std::string& config_text) {
  if (segment.steps == 0 || segment.actions.size() != kActionBranches * segment.steps) return {};
  const pb::Task task = parse_config("configuration of the recording", config_text).task();
  const std::vector<std::string> names = observation_names(task);
  const auto roll = std::find(names.begin(), names.end(), "roll");
  if (roll == names.end() || segment.observations.size() != names.size() * segment.steps) return {};
  std::vector<RollPitchYaw> turns;
  for (std::size_t row = 0; row < segment.steps; ++row) {
    const float* angles = segment.observations.data() + row * names.size() + (roll - names.begin());
    turns.push_back(task.turn_limit_deg() * kDegree * Eigen::Vector3f::Map(angles).cast<double>());
  }
  return turns;
}

Result<void> EpisodeWriter::write(const std::string& path, const RolloutTask& task,
                                  const RolloutSegment& segment, const RecordingContext& context,
                                  std::uint64_t start_ns) {
  if (const Result<void> sizes = check_sizes(path, segment, context); !sizes)
    return Failure{sizes.error()};
  writer_.write(episode_, start_ns, 0, make_header(task, segment, context));
  writer_.flush();  // however early the file is cut off, it says what it is of
  const std::size_t frame = std::size_t{3} * context.particles;
  const std::size_t frames = frame > 0 ? segment.frame_positions_in_world_m.size() / frame : 0;
  const std::uint32_t stride = std::max(1U, task.frame_stride);
  std::size_t next_frame = 0;
  const auto write_frame = [&](std::uint32_t step) {
    const std::uint64_t time_ns = start_ns + time_of(step, context);
    const float* positions = segment.frame_positions_in_world_m.data() + next_frame++ * frame;
    writer_.write(tissue_, time_ns, step, make_cloud(positions, context.particles, time_ns));
  };
  const std::vector<RollPitchYaw> turns = turns_of_steps(segment, context.config_text);
  const auto write_tool = [&](std::uint32_t steps_taken, const float* position) {
    if (!tool_) return;
    const std::uint64_t time_ns = start_ns + time_of(steps_taken, context);
    // Behind the last step nothing was observed: as before it.
    const RollPitchYaw turn =
        turns.empty() ? RollPitchYaw::Zero() : turns[std::min(steps_taken, segment.steps - 1)];
    writer_.write(*tool_, time_ns, steps_taken, make_pose(position, turn, time_ns));
  };
  if (segment.episode_start_position_in_world_m.size() >= 3)
    write_tool(0, segment.episode_start_position_in_world_m.data());
  for (std::uint32_t step = 0; step < segment.steps; ++step) {
    if (next_frame < frames && step == next_frame * stride) write_frame(step);
    writer_.write(step_, start_ns + time_of(step, context), step, make_step(segment, step));
    if (!segment.tool_positions_in_world_m.empty())
      write_tool(step + 1, segment.tool_positions_in_world_m.data() + std::size_t{3} * step);
  }
  if (next_frame < frames) write_frame(segment.steps);  // the state after the last step
  writer_.write(result_, start_ns + time_of(segment.steps, context), 0, make_result(segment));
  return {};
}

Result<void> save_episode(const std::string& path, const RolloutTask& task,
                          const RolloutSegment& segment, const RecordingContext& context) {
  std::ostringstream file(std::ios::binary);
  McapWriter writer(file);
  EpisodeWriter episode(writer, true);
  if (const Result<void> made = episode.write(path, task, segment, context, 0); !made)
    return Failure{made.error()};
  if (const Result<void> finished = writer.finish(); !finished) return Failure{finished.error()};
  return write_durably(path, file.view());
}

RecordingContext recording_context(const pb::Config& config, const std::string& name,
                                   const std::string& git_revision) {
  RecordingContext context;
  context.name = name;
  context.config_text = print_config(config);
  context.config_hash = config_hash(config);
  context.git_revision = git_revision;
  context.control_period = config.task().control_period_s() * config.task().action_repeat();
  return context;
}

std::vector<std::string> recordings_of(const std::string& path) {
  namespace fs = std::filesystem;
  if (!fs::is_directory(path)) return {path};
  std::vector<std::string> files;
  for (const std::string& folder : {path, path + "/recordings"}) {
    std::error_code ignored;
    for (const auto& entry : fs::directory_iterator(folder, ignored)) {
      if (entry.path().extension() == ".mcap") files.push_back(entry.path().string());
    }
  }
  if (files.empty()) throw_error("{}: a folder without recordings (*.mcap)", path);
  std::sort(files.begin(), files.end());
  return files;
}

Result<EpisodeRecording> load_episode(const std::string& path) {
  const Result<std::string> bytes = read_file(path);
  if (!bytes) return Failure{bytes.error()};
  return parse_episode(path, bytes.value());
}

}  // namespace omentum

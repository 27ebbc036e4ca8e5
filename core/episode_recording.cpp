#include "core/episode_recording.h"

#include <fmt/core.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <type_traits>

#include "core/check.h"
#include "core/mcap.h"
#include "core/segment_fields.h"
#include "proto/foxglove.pb.h"
#include "proto/recording.pb.h"

namespace omentum {
namespace {

constexpr std::uint32_t kFormatVersion = 1;
constexpr std::uint32_t kPointBytes = 12;
// A recording is one episode of one process; these bound what a damaged header can ask for.
constexpr std::uint32_t kMaxSteps = 1'000'000;
constexpr std::uint32_t kMaxObservation = 1'000'000;

std::uint64_t time_of(std::uint32_t step, const RecordingContext& context) {
  return static_cast<std::uint64_t>(std::llround(step * context.control_period * 1e9));
}

void set_time(google::protobuf::Timestamp& stamp, std::uint64_t time_ns) {
  stamp.set_seconds(static_cast<std::int64_t>(time_ns / 1'000'000'000));
  stamp.set_nanos(static_cast<std::int32_t>(time_ns % 1'000'000'000));
}

std::size_t observation_size(const RolloutSegment& segment) {
  return segment.steps > 0 ? segment.observations.size() / segment.steps : 0;
}

pb::EpisodeHeader make_header(const RolloutTask& task, const RolloutSegment& segment,
                              const RecordingContext& context) {
  pb::EpisodeHeader header;
  header.set_format_version(kFormatVersion);
  header.set_name(context.name);
  header.set_config_text(context.config_text);
  header.set_config_hash(context.config_hash);
  header.set_git_revision(context.git_revision);
  header.set_weights_hash(task.weights_hash.data(), task.weights_hash.size());
  header.set_policy_version(task.policy_version);
  header.set_kind(static_cast<std::uint32_t>(task.kind));
  header.set_start_set(static_cast<std::uint32_t>(task.start_set));
  header.set_start_index(task.start_index);
  header.set_greedy(task.greedy);
  header.set_run_seed(task.run_seed);
  header.set_slot(task.slot);
  header.set_episode(task.episode);
  header.set_episode_step(task.episode_step);
  header.set_episode_limit(task.episode_limit);
  header.set_steps(segment.steps);
  header.set_reset(task.reset);
  header.set_state_format(task.state_format);
  header.set_start_hash(task.start_hash);
  if (!task.start_state.empty())
    header.set_start_state(task.start_state.data(), task.start_state.size());
  header.set_source(static_cast<std::uint32_t>(segment.source));
  header.set_control_period_s(context.control_period);
  header.set_observation_size(static_cast<std::uint32_t>(observation_size(segment)));
  header.set_particles(context.particles);
  header.set_frame_stride(task.frame_stride);
  header.set_build_id(segment.build_id);
  header.set_task_steps(task.steps);
  header.set_policy_steps(task.policy_steps);
  header.set_hold_steps(task.hold_steps);
  header.set_segment(task.segment);
  return header;
}

// Steps and result hold what the list of core/segment_fields.h says that is recorded, each row of
// an array under the name it gives.

using google::protobuf::FieldDescriptor;
using google::protobuf::Message;

const FieldDescriptor& field_of(const Message& message, const ArrayField& about) {
  const FieldDescriptor* field = message.GetDescriptor()->FindFieldByName(about.recorded_as);
  OMENTUM_CHECK(field != nullptr, "{} is no field of the recording", about.recorded_as);
  return *field;
}

template <typename T>
void put_one(Message& message, const FieldDescriptor& field, T value) {
  const google::protobuf::Reflection& access = *message.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_FLOAT:
      return access.SetFloat(&message, &field, static_cast<float>(value));
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return access.SetDouble(&message, &field, static_cast<double>(value));
    case FieldDescriptor::CPPTYPE_UINT32:
      return access.SetUInt32(&message, &field, static_cast<std::uint32_t>(value));
    case FieldDescriptor::CPPTYPE_UINT64:
      return access.SetUInt64(&message, &field, static_cast<std::uint64_t>(value));
    case FieldDescriptor::CPPTYPE_BOOL:
      return access.SetBool(&message, &field, value != T{});
    default:
      OMENTUM_CHECK(false, "{} is of a type that is not used in recordings", field.full_name());
  }
}

template <typename T>
T get_one(const Message& message, const FieldDescriptor& field) {
  const google::protobuf::Reflection& access = *message.GetReflection();
  switch (field.cpp_type()) {
    case FieldDescriptor::CPPTYPE_FLOAT:
      return static_cast<T>(access.GetFloat(message, &field));
    case FieldDescriptor::CPPTYPE_DOUBLE:
      return static_cast<T>(access.GetDouble(message, &field));
    case FieldDescriptor::CPPTYPE_UINT32:
      return static_cast<T>(access.GetUInt32(message, &field));
    case FieldDescriptor::CPPTYPE_UINT64:
      return static_cast<T>(access.GetUInt64(message, &field));
    case FieldDescriptor::CPPTYPE_BOOL:
      return static_cast<T>(access.GetBool(message, &field) ? 1 : 0);
    default:
      OMENTUM_CHECK(false, "{} is of a type that is not used in recordings", field.full_name());
  }
  return T{};
}

/// Writes `width` entries from `row` to the field: one number, numbers, or bytes.
template <typename T>
void put_row(Message& message, const FieldDescriptor& field, const T* row, std::size_t width) {
  const google::protobuf::Reflection& access = *message.GetReflection();
  if (field.type() == FieldDescriptor::TYPE_BYTES) {
    access.SetString(&message, &field, std::string(row, row + width));
  } else if (!field.is_repeated()) {
    put_one(message, field, *row);
  } else {
    for (std::size_t k = 0; k < width; ++k)
      access.AddFloat(&message, &field, static_cast<float>(row[k]));
  }
}

/// Entries that the field of a message holds, 0 = absent.
std::size_t width_of(const Message& message, const FieldDescriptor& field) {
  const google::protobuf::Reflection& access = *message.GetReflection();
  if (field.is_repeated()) return static_cast<std::size_t>(access.FieldSize(message, &field));
  if (!access.HasField(message, &field)) return 0;
  return field.type() == FieldDescriptor::TYPE_BYTES ? access.GetString(message, &field).size() : 1;
}

/// Appends the entries that the field holds to an array.
template <typename T>
void take_row(const Message& message, const FieldDescriptor& field, std::vector<T>& array) {
  const google::protobuf::Reflection& access = *message.GetReflection();
  const std::size_t width = width_of(message, field);
  if (field.type() == FieldDescriptor::TYPE_BYTES) {
    for (const char byte : access.GetString(message, &field)) array.push_back(static_cast<T>(byte));
  } else if (!field.is_repeated()) {
    if (width == 1) array.push_back(get_one<T>(message, field));
  } else {
    for (int k = 0; k < static_cast<int>(width); ++k)
      array.push_back(static_cast<T>(access.GetRepeatedFloat(message, &field, k)));
  }
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

pb::StepRecord make_step(const RolloutSegment& segment, std::uint32_t step) {
  pb::StepRecord record;
  record.set_step(step);
  for_each_recorded(segment, true, [&](const auto& array, const ArrayField& about) {
    if (array.empty()) return;
    const std::size_t width = array.size() / segment.steps;
    put_row(record, field_of(record, about), array.data() + step * width, width);
  });
  record.set_held((segment.flags[step] & step_flag::kHeld) != 0);
  return record;
}

foxglove::PoseInFrame make_pose(const float* p, std::uint64_t time_ns) {
  foxglove::PoseInFrame message;
  set_time(*message.mutable_timestamp(), time_ns);
  message.set_frame_id("W");
  foxglove::Vector3& position = *message.mutable_pose()->mutable_position();
  position.set_x(static_cast<double>(p[0]));
  position.set_y(static_cast<double>(p[1]));
  position.set_z(static_cast<double>(p[2]));
  // Viewers draw poses as an arrow along x; the shaft points down, which is a quarter turn about y.
  message.mutable_pose()->mutable_orientation()->set_y(std::sqrt(0.5));
  message.mutable_pose()->mutable_orientation()->set_w(std::sqrt(0.5));
  return message;
}

foxglove::PointCloud make_cloud(const float* positions, std::uint32_t particles,
                                std::uint64_t time_ns) {
  foxglove::PointCloud cloud;
  set_time(*cloud.mutable_timestamp(), time_ns);
  cloud.set_frame_id("W");
  cloud.mutable_pose()->mutable_orientation()->set_w(1);
  cloud.set_point_stride(kPointBytes);
  for (const auto& [name, offset] : {std::pair{"x", 0U}, {"y", 4U}, {"z", 8U}}) {
    foxglove::PackedElementField& field = *cloud.add_fields();
    field.set_name(name);
    field.set_offset(offset);
    field.set_type(foxglove::PackedElementField::FLOAT32);
  }
  cloud.set_data(positions, std::size_t{kPointBytes} * particles);
  return cloud;
}

pb::EpisodeResult make_result(const RolloutSegment& segment) {
  pb::EpisodeResult result;
  for_each_recorded(segment, false, [&](const auto& array, const ArrayField& about) {
    if (array.size() >= about.width)
      put_row(result, field_of(result, about), array.data(), about.width);
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
    const bool observation = about.width == kObservationWidth;
    good = good && (observation ? steps == 0 || array.size() % steps == 0
                                : array.size() == steps * about.width);
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

// ------------------------------------------------------------------------------------------------
// Reading

void take_header(const pb::EpisodeHeader& header, EpisodeRecording& recording) {
  RecordingContext& context = recording.context;
  context.name = header.name();
  context.config_text = header.config_text();
  context.config_hash = header.config_hash();
  context.git_revision = header.git_revision();
  context.control_period = header.control_period_s();
  context.particles = header.particles();
  RolloutTask& task = recording.task;
  std::memcpy(task.weights_hash.data(), header.weights_hash().data(),
              std::min(task.weights_hash.size(), header.weights_hash().size()));
  task.policy_version = header.policy_version();
  task.config_hash = header.config_hash();
  task.kind = static_cast<TaskKind>(header.kind());
  task.start_set = static_cast<StartSet>(header.start_set());
  task.start_index = header.start_index();
  task.greedy = header.greedy();
  task.run_seed = header.run_seed();
  task.slot = header.slot();
  task.episode = header.episode();
  task.episode_step = header.episode_step();
  task.episode_limit = header.episode_limit();
  task.steps = header.task_steps();
  task.policy_steps = header.policy_steps();
  task.hold_steps = header.hold_steps();
  task.segment = header.segment();
  task.reset = header.reset();
  task.state_format = header.state_format();
  task.start_hash = header.start_hash();
  const auto* state = reinterpret_cast<const std::byte*>(header.start_state().data());
  task.start_state.assign(state, state + header.start_state().size());
  task.frame_stride = header.frame_stride();
  recording.segment.slot = header.slot();
  recording.segment.segment = header.segment();
  recording.segment.policy_version = header.policy_version();
  recording.segment.source = static_cast<Source>(header.source());
  recording.segment.build_id = header.build_id();
}

/// Appends one step; false if it does not follow the steps before in number and shape.
bool take_step(const pb::StepRecord& record, std::size_t observation, RolloutSegment& segment) {
  bool good = record.step() == segment.steps;
  for_each_recorded(segment, true, [&](const auto& array, const ArrayField& about) {
    const std::size_t width = width_of(record, field_of(record, about));
    const std::size_t wanted = about.width == kObservationWidth ? observation : about.width;
    good = good && (width == wanted || (width == 0 && !required(&array, segment)));
  });
  if (!good) return false;
  for_each_recorded(segment, true, [&](auto& array, const ArrayField& about) {
    take_row(record, field_of(record, about), array);
  });
  ++segment.steps;
  return true;
}

bool take_cloud(const foxglove::PointCloud& cloud, std::uint32_t step,
                EpisodeRecording& recording) {
  const std::size_t bytes = std::size_t{kPointBytes} * recording.context.particles;
  if (bytes == 0 || cloud.data().size() != bytes || cloud.point_stride() != kPointBytes)
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
    const FieldDescriptor& field = field_of(result, about);
    if (width_of(result, field) != about.width) return;
    array.clear();
    take_row(result, field, array);
  });
  segment.end_hash = result.end_hash();
  segment.failure = result.failure();
  segment.physics_ticks = result.physics_ticks();
}

Result<EpisodeRecording> take_content(const std::string& name, const McapContent& content) {
  const auto headers = content.of_topic("/episode");
  pb::EpisodeHeader header;
  if (headers.empty() || !header.ParseFromString(headers.front()->data)) {
    return Failure{fmt::format("{}: no episode header", name)};
  }
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
  for (const McapMessage* message : content.of_topic("/step")) {
    pb::StepRecord record;
    const bool good = record.ParseFromString(message->data) &&
                      take_step(record, header.observation_size(), recording.segment);
    bad += good ? 0 : 1;
  }
  for (const McapMessage* message : content.of_topic("/tissue")) {
    foxglove::PointCloud cloud;
    const bool good =
        cloud.ParseFromString(message->data) && take_cloud(cloud, message->sequence, recording);
    bad += good ? 0 : 1;
  }
  for (const McapMessage* message : content.of_topic("/result")) {
    pb::EpisodeResult result;
    if (result.ParseFromString(message->data)) {
      take_result(result, recording.segment);
    } else {
      ++bad;
    }
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

Result<void> save_episode(const std::string& path, const RolloutTask& task,
                          const RolloutSegment& segment, const RecordingContext& context) {
  if (const Result<void> sizes = check_sizes(path, segment, context); !sizes)
    return Failure{sizes.error()};
  std::ofstream file(path, std::ios::binary | std::ios::trunc);
  if (!file) return Failure{fmt::format("{}: cannot be written", path)};
  McapWriter writer(file);
  const auto episode = writer.add_channel("/episode", *pb::EpisodeHeader::descriptor());
  const auto step_channel = writer.add_channel("/step", *pb::StepRecord::descriptor());
  const auto tool = writer.add_channel("/tool", *foxglove::PoseInFrame::descriptor());
  const auto tissue = writer.add_channel("/tissue", *foxglove::PointCloud::descriptor());
  const auto result = writer.add_channel("/result", *pb::EpisodeResult::descriptor());
  writer.write(episode, 0, 0, make_header(task, segment, context));
  const std::size_t frame = std::size_t{3} * context.particles;
  const std::size_t frames = frame > 0 ? segment.frame_positions_in_world_m.size() / frame : 0;
  const std::uint32_t stride = std::max(1U, task.frame_stride);
  std::size_t next_frame = 0;
  const auto write_frame = [&](std::uint32_t step) {
    const std::uint64_t time_ns = time_of(step, context);
    const float* positions = segment.frame_positions_in_world_m.data() + next_frame * frame;
    writer.write(tissue, time_ns, step, make_cloud(positions, context.particles, time_ns));
    ++next_frame;
  };
  const auto write_tool = [&](std::uint32_t steps_taken, const float* position) {
    const std::uint64_t time_ns = time_of(steps_taken, context);
    writer.write(tool, time_ns, steps_taken, make_pose(position, time_ns));
  };
  if (segment.episode_start_position_in_world_m.size() >= 3)
    write_tool(0, segment.episode_start_position_in_world_m.data());
  for (std::uint32_t step = 0; step < segment.steps; ++step) {
    if (next_frame < frames && step == next_frame * stride) write_frame(step);
    writer.write(step_channel, time_of(step, context), step, make_step(segment, step));
    if (!segment.tool_positions_in_world_m.empty()) {
      write_tool(step + 1, segment.tool_positions_in_world_m.data() + std::size_t{3} * step);
    }
  }
  if (next_frame < frames) write_frame(segment.steps);  // the state after the last step
  writer.write(result, time_of(segment.steps, context), 0, make_result(segment));
  const Result<void> finished = writer.finish();
  file.close();
  if (!finished || !file) return Failure{fmt::format("{}: writing failed", path)};
  return {};
}

Result<EpisodeRecording> parse_episode(const std::string& name, const std::string& bytes) {
  return take_content(name, read_mcap(bytes));
}

Result<EpisodeRecording> load_episode(const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) return Failure{fmt::format("{}: cannot be opened", path)};
  const std::string bytes{std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
  return parse_episode(path, bytes);
}

FrameState frame_state(const EpisodeRecording& recording, std::size_t frame) {
  const RolloutSegment& segment = recording.segment;
  FrameState state;
  state.step = recording.frame_steps[frame];
  state.time = state.step * recording.context.control_period;
  state.tool_position.fill(std::numeric_limits<float>::quiet_NaN());
  state.exposure = std::numeric_limits<float>::quiet_NaN();
  const std::size_t after =
      std::min(state.step, segment.steps);  // steps whose result the frame shows
  const std::vector<float>& tools = segment.tool_positions_in_world_m;
  if (after > 0 && 3 * after <= tools.size()) {
    std::copy_n(tools.data() + 3 * (after - 1), 3, state.tool_position.data());
  } else if (after == 0 && segment.episode_start_position_in_world_m.size() >= 3) {
    std::copy_n(segment.episode_start_position_in_world_m.data(), 3, state.tool_position.data());
  } else if (tools.size() >= 3) {
    std::copy_n(tools.data(), 3, state.tool_position.data());
  }
  if (!segment.exposures.empty()) {
    state.exposure =
        segment.exposures[std::min(after > 0 ? after - 1 : 0, segment.exposures.size() - 1)];
  }
  if (after < segment.flags.size()) {
    state.held = (segment.flags[after] & step_flag::kHeld) != 0;
  } else if (!segment.episode_held.empty()) {
    state.held = segment.episode_held[0] != 0;
  } else if (!segment.flags.empty()) {
    const std::uint8_t last = segment.flags.back();
    state.held = (last & step_flag::kHeld) != 0 && (last & step_flag::kGraspLost) == 0;
  }
  return state;
}

}  // namespace omentum

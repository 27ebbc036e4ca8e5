#include <cmath>
#include <filesystem>
#include <limits>

#include "core/episode_recording.h"
#include "core/mcap.h"
#include "proto/foxglove.pb.h"
#include "proto/recording_folder.pb.h"
#include "proto/robot_recording.pb.h"
#include "report/recording_page.h"

namespace omentum {
namespace {

double seconds(const McapMessage& message) { return 1e-9 * static_cast<double>(message.log_time); }

/// Calls take(message, parsed) for each message of a topic that can be read; how many cannot.
template <typename Message, typename Take>
std::size_t for_each(const McapContent& content, const char* topic, Take&& take) {
  std::size_t bad = 0;
  Message parsed;
  for (const McapMessage* message : content.of_topic(topic)) {
    if (parsed.ParseFromString(message->data))
      take(*message, parsed);
    else
      ++bad;
  }
  return bad;
}

std::size_t read_path(const McapContent& content, const char* topic, RobotRecording::Path& path) {
  return for_each<foxglove::PoseInFrame>(
      content, topic, [&](const McapMessage& message, const foxglove::PoseInFrame& pose) {
        const foxglove::Vector3& p = pose.pose().position();
        if (!std::isfinite(p.x() + p.y() + p.z())) return;
        path.t_s.push_back(seconds(message));
        path.x_mm.push_back(1e3 * p.x());
        path.y_mm.push_back(1e3 * p.y());
        path.z_mm.push_back(1e3 * p.z());
        path.stamp_s.push_back(static_cast<double>(pose.timestamp().seconds()) +
                               1e-9 * pose.timestamp().nanos());
      });
}

std::string about(const pb::RecordingInfo& info) {
  std::string text = info.mode().empty() ? "" : "Mode " + info.mode() + ". ";
  if (info.dry_run()) text += "Dry run: goals were judged and not sent. ";
  if (!info.date().empty()) text += info.date() + ". ";
  if (!info.instrument().empty()) text += "Instrument " + info.instrument() + ". ";
  text += info.registration_text().empty() ? "Without a registration. " : "";
  return text + info.program();
}

std::vector<std::pair<std::string, std::uint64_t>> counters(const pb::RobotStateSample& s) {
  std::vector<std::pair<std::string, std::uint64_t>> all = {
      {"datagrams of the robot", s.datagrams()},
      {"datagrams that are no JSON of the protocol", s.malformed()},
      {"datagrams of another address", s.foreign()},
      {"datagrams longer than the memory", s.cut()},
      {"unknown keys", s.unknown_keys()},
      {"payloads with numbers that are not finite", s.not_finite()},
      {"payloads that came late", s.reordered()},
      {"payloads that are not valid", s.invalid_payloads()},
      {"other processes of the robot", s.restarts()},
      {"commands not sent", s.unsent()},
      {"control periods that are not recorded", s.unseen_periods()},
      {"lines of sensors that cannot be read", s.bad_source_lines()}};
  std::erase_if(all, [](const auto& counter) { return counter.second == 0; });
  return all;
}

void add_episodes(const std::string& name, const std::string& bytes, const McapContent& content,
                  RobotRecording& recording) {
  const auto headers = content.of_topic("/episode");
  if (headers.empty()) return;
  const Result<std::vector<EpisodeRecording>> episodes = parse_episodes(name, bytes);
  if (!episodes) {
    recording.problems.push_back(episodes.error());
    return;
  }
  for (std::size_t k = 0; k < episodes.value().size(); ++k) {
    const RolloutSegment& segment = episodes.value()[k].segment;
    RobotRecording::Episode shown;
    shown.t_s = seconds(*headers[k]);
    shown.steps = segment.steps;
    shown.exposure = segment.exposures.empty() ? std::numeric_limits<double>::quiet_NaN()
                                               : static_cast<double>(segment.exposures.back());
    shown.outcome =
        !segment.failure.empty()          ? "stopped: " + segment.failure
        : segment.episode_outcome.empty() ? "no end"
        : segment.episode_outcome[0] == static_cast<std::uint8_t>(Outcome::kTargetReached)
            ? "target reached"
            : "target not reached";
    recording.episodes.push_back(shown);
  }
}

}  // namespace

Result<RobotRecording> read_robot_recording(const std::string& name, const std::string& bytes) {
  const McapContent content = read_mcap(bytes);
  RobotRecording recording;
  recording.name = std::filesystem::path(name).filename().string();
  recording.complete = content.complete;
  recording.problems = content.problems;
  std::size_t bad = for_each<pb::RecordingInfo>(
      content, "/recording",
      [&](const McapMessage&, const pb::RecordingInfo& info) { recording.about = about(info); });
  bad += read_path(content, "/tool", recording.measured);
  bad += read_path(content, "/tool_setpoint", recording.setpoint);
  bad += read_path(content, "/tool_commanded", recording.commanded);
  bad += for_each<pb::LatencySample>(
      content, "/latency", [&](const McapMessage&, const pb::LatencySample& sample) {
        ++recording.periods;
        const auto add = [](double value_s, std::vector<double>& values) {
          if (std::isfinite(value_s)) values.push_back(1e3 * value_s);
        };
        add(sample.latency_s(), recording.latency_ms);
        add(sample.jitter_s(), recording.jitter_ms);
        add(sample.state_age_s(), recording.state_age_ms);
      });
  bad += for_each<pb::SafetyEvent>(
      content, "/safety", [&](const McapMessage& message, const pb::SafetyEvent& event) {
        recording.events.push_back({seconds(message), event.phase_name(), event.reason_name(),
                                    event.text(), event.stopped()});
      });
  bad += for_each<pb::RobotStateSample>(
      content, "/robot_state", [&](const McapMessage&, const pb::RobotStateSample& sample) {
        recording.counters = counters(sample);  // they only grow: the last one stays
      });
  if (recording.measured.t_s.empty() && recording.events.empty()) {
    const std::string why = content.problems.empty() ? "" : "; " + content.problems.front();
    return Failure{fmt::format("{}: no pose of the tool and no safety event in it{}", name, why)};
  }
  if (bad > 0) recording.problems.push_back(fmt::format("{} messages that cannot be read", bad));
  add_episodes(name, bytes, content, recording);
  return recording;
}

}  // namespace omentum

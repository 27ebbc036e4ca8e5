#include "mismatch/recording/recording_mcap.h"

#include <fmt/format.h>
#include <google/protobuf/util/time_util.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <numeric>
#include <optional>

#include "core/check.h"
#include "core/cloud_message.h"
#include "core/regular_file.h"
#include "mismatch/recording/messages.h"
#include "proto/foxglove.pb.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

/// Time, number and place of a cloud or picture.
struct FoundFrame {
  std::int64_t time_ns = 0;
  std::uint32_t number = 0;
  McapPlace place;
};

template <typename T>
void set_frames(std::vector<FoundFrame> found, const char* topic,
                const std::shared_ptr<McapFetcher>& fetcher,
                T (*decode)(const std::string&, std::string_view), const std::string& path,
                Frames<T>& frames, std::vector<std::string>& warnings) {
  std::stable_sort(found.begin(), found.end(),
                   [](const auto& a, const auto& b) { return a.time_ns < b.time_ns; });
  const auto same = [](const auto& a, const auto& b) { return a.time_ns == b.time_ns; };
  const auto end = std::unique(found.begin(), found.end(), same);
  if (end != found.end())
    warnings.push_back(
        fmt::format("{}: {} frames at the time of another one", topic, found.end() - end));
  found.erase(end, found.end());
  std::vector<McapPlace> places;
  for (const FoundFrame& frame : found) {
    frames.time_ns.push_back(frame.time_ns);
    frames.number.push_back(frame.number);
    places.push_back(frame.place);
  }
  // Numbers name files: where they do not tell frames apart, their order does.
  for (std::size_t k = 1; k < frames.size(); ++k) {
    if (frames.number[k] > frames.number[k - 1]) continue;
    std::iota(frames.number.begin(), frames.number.end(), 0U);
    break;
  }
  frames.fetch = [places, fetcher, decode, path, topic](std::size_t k) {
    return decode(fmt::format("{}: {} {}", path, topic, k), fetcher->fetch(places[k]));
  };
}

Cloud fetch_cloud(const std::string& name, std::string_view data) {
  Result<Cloud> cloud = decode_cloud(data);
  if (!cloud) throw_error("{}: {}", name, cloud.error());
  return std::move(cloud).value();
}

std::string fetch_image(const std::string& name, std::string_view data) {
  foxglove::CompressedImage image;
  if (!image.ParseFromArray(data.data(), static_cast<int>(data.size())))
    throw_error("{}: no message foxglove.CompressedImage", name);
  return image.data();
}

bool starts_as_recording(const std::map<std::string, SeriesCollector>& series,
                         const std::map<std::string, std::vector<FoundFrame>>& frames) {
  return !series.empty() || !frames.empty();
}

}  // namespace

Result<Cloud> decode_cloud(std::string_view data) {
  foxglove::PointCloud message;
  if (!message.ParseFromArray(data.data(), static_cast<int>(data.size())))
    return Failure{"no message foxglove.PointCloud"};
  std::array<std::optional<std::pair<std::size_t, bool>>, 3> at;  // offset, 64 bits
  for (const foxglove::PackedElementField& field : message.fields()) {
    const auto axis = std::string("xyz").find(field.name());
    if (field.name().size() != 1 || axis == std::string::npos) continue;
    const bool wide = field.type() == foxglove::PackedElementField::FLOAT64;
    if (!wide && field.type() != foxglove::PackedElementField::FLOAT32)
      return Failure{fmt::format("{} of the cloud is no FLOAT32 or FLOAT64", field.name())};
    if (std::uint64_t{field.offset()} + (wide ? 8 : 4) > message.point_stride())
      return Failure{fmt::format("{} of the cloud lies behind its point", field.name())};
    at[axis] = {field.offset(), wide};
  }
  if (!at[0] || !at[1] || !at[2]) return Failure{"a cloud without x, y or z"};
  const std::size_t stride = message.point_stride();
  if (message.data().size() % stride != 0)
    return Failure{
        fmt::format("a cloud of {} bytes in points of {}", message.data().size(), stride)};
  const foxglove::Quaternion& q = message.pose().orientation();
  const foxglove::Vector3& t = message.pose().position();
  const Eigen::Quaterniond turn(q.w(), q.x(), q.y(), q.z());
  const Eigen::Vector3d shift(t.x(), t.y(), t.z());
  const bool posed =
      message.pose().has_orientation() && (turn.vec().squaredNorm() > 0 || shift.squaredNorm() > 0);
  Cloud cloud;
  cloud.reserve(message.data().size() / stride);
  for (std::size_t i = 0; i < message.data().size(); i += stride) {
    Eigen::Vector3d p;
    for (int k = 0; k < 3; ++k) {
      const auto [offset, wide] = *at[static_cast<std::size_t>(k)];
      float narrow = 0;
      if (wide) {
        std::memcpy(&p[k], message.data().data() + i + offset, 8);
      } else {
        std::memcpy(&narrow, message.data().data() + i + offset, 4);
        p[k] = static_cast<double>(narrow);
      }
    }
    if (posed) p = turn.normalized() * p + shift;
    const Eigen::Vector3f point = p.cast<float>();
    if (point.allFinite()) cloud.push_back(point);
  }
  return cloud;
}

Recording read_recording_mcap(const std::string& path) {
  if (fs::is_directory(path)) throw_error("{}: a folder, allowed: files .mcap", path);
  if (const Result<void> regular = require_regular_file(path); !regular)
    throw_error("{}", regular.error());
  std::ifstream in(path, std::ios::binary);
  if (!in) throw_error("{}: cannot be opened: {}", path, std::strerror(errno));
  Recording recording;
  McapReader reader(in);
  std::map<std::string, SeriesCollector> series;
  std::map<std::string, std::vector<FoundFrame>> frames;
  bool stated = false;
  for (McapView message; reader.next(message);) {
    const McapChannel& channel = reader.channels().at(message.channel);
    if (channel.encoding != "protobuf" || channel.topic.empty()) continue;
    const std::string topic = channel.topic.substr(1);
    const std::string where = fmt::format("{}: byte {}", path, message.place.record);
    if (topic == "recording") {
      if (stated) continue;
      if (!recording.info.ParseFromArray(message.data.data(),
                                         static_cast<int>(message.data.size())))
        throw_error("{}: /recording: no message omentum.pb.RecordingInfo", where);
      stated = true;
      continue;
    }
    const std::int64_t time_ns =
        static_cast<std::int64_t>(message.log_time) + recording.info.log_time_origin_ns();
    if (topic == "cloud" || topic == "depth" || topic == "color") {
      const bool compressed = channel.schema.name == "foxglove.CompressedImage";
      if (topic == "cloud" ? channel.schema.name == "foxglove.PointCloud" : compressed)
        frames[topic].push_back({time_ns, message.sequence, message.place});
      continue;
    }
    const auto type = make_message(topic);
    if (!type || type->GetDescriptor()->full_name() != channel.schema.name) continue;
    const auto& names = recording.info.marker_name();
    const auto found =
        series.try_emplace(topic, topic, std::vector<std::string>(names.begin(), names.end()));
    if (const auto added = found.first->second.add(time_ns, message.data); !added)
      throw_error("{}: {}", where, added.error());
  }
  for (const std::string& problem : reader.problems())
    recording.warnings.push_back(fmt::format("{}: {}", path, problem));
  if (!stated && !starts_as_recording(series, frames)) {
    for (const auto& [id, channel] : reader.channels()) {
      if (channel.encoding == "ros1" || channel.encoding == "cdr")
        throw_error("{}: a bag of ROS, needed what `mismatch import` makes of it", path);
    }
    throw_error(
        "{}: {}, needed an MCAP file with /recording", path,
        reader.problems().empty() ? "nothing of a recording in it" : reader.problems().front());
  }
  if (!stated) {
    recording.info.set_name(fs::path(path).stem().string());
    recording.warnings.push_back(path + ": no /recording: everything is taken to be in W");
  }
  recording.info.clear_log_time_origin_ns();
  recording.info.clear_marker_name();
  for (auto& [topic, collector] : series) {
    Result<Series> made = collector.finish(recording.warnings);
    if (!made) throw_error("{}: {}", path, made.error());
    if (made.value().rows() > 0) recording.series.emplace(topic, std::move(made).value());
  }
  const auto fetcher = std::make_shared<McapFetcher>(path);
  set_frames<Cloud>(frames["cloud"], "/cloud", fetcher, fetch_cloud, path, recording.clouds,
                    recording.warnings);
  set_frames<std::string>(frames["depth"], "/depth", fetcher, fetch_image, path, recording.depth,
                          recording.warnings);
  set_frames<std::string>(frames["color"], "/color", fetcher, fetch_image, path, recording.color,
                          recording.warnings);
  return recording;
}

namespace {

/// One message to be written.
struct Due {
  std::int64_t time_ns = 0;
  std::size_t channel = 0, index = 0;
};

foxglove::CompressedImage image_message(const std::string& png, std::int64_t time_ns) {
  foxglove::CompressedImage image;
  *image.mutable_timestamp() = google::protobuf::util::TimeUtil::NanosecondsToTimestamp(time_ns);
  image.set_data(png);
  image.set_format("png");
  image.set_frame_id("camera");
  return image;
}

/// What one channel writes: times, sequence number and message of an index.
struct Source {
  std::string topic;
  const google::protobuf::Descriptor* type = nullptr;
  const std::vector<std::int64_t>* time_ns = nullptr;
  std::function<std::uint32_t(std::size_t)> number;
  std::function<std::unique_ptr<google::protobuf::Message>(std::size_t)> message;
};

std::vector<Source> sources_of(const Recording& recording) {
  std::vector<Source> sources;
  for (const auto& [topic, series] : recording.series) {
    sources.push_back({topic, make_message(topic)->GetDescriptor(), &series.time_ns,
                       [](std::size_t k) { return static_cast<std::uint32_t>(k); },
                       [&topic = topic, &series = series](std::size_t k) {
                         auto message = make_message(topic);
                         encode_row(series, topic, k, *message);
                         return message;
                       }});
  }
  const auto add_images = [&](const char* topic, const Frames<std::string>& images) {
    if (images.size() == 0) return;
    sources.push_back({topic, foxglove::CompressedImage::descriptor(), &images.time_ns,
                       [&images](std::size_t k) { return images.number[k]; },
                       [&images](std::size_t k) {
                         return std::make_unique<foxglove::CompressedImage>(
                             image_message(images.fetch(k), images.time_ns[k]));
                       }});
  };
  const Frames<Cloud>& clouds = recording.clouds;
  if (clouds.size() > 0) {
    sources.push_back({"cloud", foxglove::PointCloud::descriptor(), &clouds.time_ns,
                       [&clouds](std::size_t k) { return clouds.number[k]; },
                       [&clouds](std::size_t k) {
                         const Cloud points = clouds.fetch(k);
                         const float* first = points.empty() ? nullptr : points.front().data();
                         return std::make_unique<foxglove::PointCloud>(
                             make_cloud(first, static_cast<std::uint32_t>(points.size()),
                                        static_cast<std::uint64_t>(clouds.time_ns[k])));
                       }});
  }
  add_images("depth", recording.depth);
  add_images("color", recording.color);
  return sources;
}

/// Removed but for a file that was finished.
class UnfinishedFile {
 public:
  explicit UnfinishedFile(std::string path)
      : path_(std::move(path)), unfinished_(fmt::format("{}.unfinished-{}", path_, ::getpid())) {}
  ~UnfinishedFile() {
    std::error_code ignored;
    fs::remove(unfinished_, ignored);
  }
  UnfinishedFile(const UnfinishedFile&) = delete;
  UnfinishedFile& operator=(const UnfinishedFile&) = delete;
  const std::string& name() const { return unfinished_; }
  void finish() {
    std::error_code failed;
    fs::rename(unfinished_, path_, failed);
    if (failed) throw_error("{}: cannot be written: {}", path_, failed.message());
  }

 private:
  std::string path_, unfinished_;
};

}  // namespace

void write_recording_mcap(const Recording& recording, const std::string& path,
                          McapCompression compression) {
  const std::vector<Source> sources = sources_of(recording);
  std::vector<Due> due;
  for (std::size_t c = 0; c < sources.size(); ++c) {
    for (std::size_t k = 0; k < sources[c].time_ns->size(); ++k)
      due.push_back({(*sources[c].time_ns)[k], c, k});
  }
  std::stable_sort(due.begin(), due.end(),
                   [](const Due& a, const Due& b) { return a.time_ns < b.time_ns; });
  pb::RecordingInfo info = recording.info;
  // Log time has no sign.
  const std::int64_t origin = due.empty() ? 0 : std::min<std::int64_t>(0, due.front().time_ns);
  if (origin < 0) info.set_log_time_origin_ns(origin);
  if (const Series* markers = recording.find("markers")) {
    for (const std::string& name : marker_names(*markers)) info.add_marker_name(name);
  }
  UnfinishedFile file(path);
  std::ofstream out(file.name(), std::ios::binary);
  if (!out) throw_error("{}: cannot be written: {}", path, std::strerror(errno));
  McapWriter writer(out, compression);
  const auto info_channel = writer.add_channel("/recording", *pb::RecordingInfo::descriptor());
  std::vector<McapWriter::ChannelId> channels;
  for (const Source& source : sources)
    channels.push_back(writer.add_channel("/" + source.topic, *source.type));
  const auto log_time = [&](std::int64_t time_ns) {
    return static_cast<std::uint64_t>(time_ns - origin);
  };
  writer.write(info_channel, due.empty() ? 0 : log_time(due.front().time_ns), 0, info);
  for (const Due& d : due) {
    const Source& source = sources[d.channel];
    writer.write(channels[d.channel], log_time(d.time_ns), source.number(d.index),
                 *source.message(d.index));
  }
  if (const Result<void> done = writer.finish(); !done || (out.close(), !out))
    throw_error("{}: cannot be written: {}", path, std::strerror(errno));
  file.finish();
}

}  // namespace omentum

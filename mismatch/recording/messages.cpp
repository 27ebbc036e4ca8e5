#include "mismatch/recording/messages.h"

#include <fmt/format.h>
#include <google/protobuf/util/time_util.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "mismatch/recording/table_columns.h"
#include "proto/foxglove.pb.h"
#include "proto/robot_recording.pb.h"

namespace omentum {
namespace {

constexpr double kUnknown = std::numeric_limits<double>::quiet_NaN();

bool is_pose(std::string_view topic) { return topic.starts_with("tool"); }
bool is_joints(std::string_view topic) { return topic.starts_with("joints"); }

std::string file_of(const std::string& topic) {
  for (const std::string_view file : kTableFiles) {
    const std::vector<std::string> topics = topics_of(file);
    if (std::find(topics.begin(), topics.end(), topic) != topics.end()) return std::string(file);
  }
  return "";
}

/// tip_commanded_ of tool_commanded.
std::string pose_stem(const std::string& topic) {
  if (topic == "tracker") return "tip_optical_";
  return topic == "tool" ? "tip_measured_" : "tip_" + topic.substr(5) + "_";
}

JointColumn::Source source_of(std::string_view topic) {
  return topic.ends_with("_commanded")  ? JointColumn::kCommanded
         : topic.ends_with("_setpoint") ? JointColumn::kSetpoint
                                        : JointColumn::kMeasured;
}

/// q1, q3, q_in; with the unit where it is not the usual one.
std::string joint_name(const JointColumn& column) {
  const bool bench = column.joint.size() > 1;
  const std::string name = (bench ? "q_" : "q") + column.joint;
  if (column.linear == is_usually_linear(column.joint)) return name;
  return name + (column.linear ? "_m" : "_rad");
}

/// Of a joint of a message; one of another name is called by its place.
JointColumn joint_of(const std::string& name, int place) {
  JointColumn column;
  for (const std::string joint : {"1", "2", "3", "4", "5", "6", "7", "8", "9", "in", "out"}) {
    column.joint = joint;
    for (const bool linear : {false, true}) {
      column.linear = linear;
      if (joint_name(column) == name) return column;
    }
  }
  column.joint = fmt::format("{}", place + 1);
  column.linear = is_usually_linear(column.joint);
  return column;
}

/// Messages of plain numbers have fields named as the columns are.
std::string column_prefix(const std::string& topic) { return topic == "jaw" ? "jaw_" : ""; }
bool is_number_of_row(const google::protobuf::FieldDescriptor& field) {
  return field.name() != "t_s" && field.name() != "timestamp_s";
}

void encode_joints(const Series& series, std::size_t row, foxglove::JointStates& states) {
  std::string last;
  foxglove::JointState* joint = nullptr;
  for (std::size_t k = 0; k < series.columns.size(); ++k) {
    const JointColumn column = *parse_joint_column(series.columns[k]);
    const std::string name = joint_name(column);
    if (joint == nullptr || name != last) {
      joint = states.add_joints();
      joint->set_name(name);
      last = name;
    }
    const double value = series.at(row, k);
    if (std::isnan(value)) continue;
    if (column.quantity == JointColumn::kPosition) joint->set_position(value);
    if (column.quantity == JointColumn::kVelocity) joint->set_velocity(value);
    if (column.quantity == JointColumn::kEffort) joint->set_effort(value);
  }
}

}  // namespace

std::unique_ptr<google::protobuf::Message> make_message(const std::string& topic) {
  const std::string file = file_of(topic);
  if (file.empty()) return nullptr;
  if (is_pose(topic)) return std::make_unique<foxglove::PoseInFrame>();
  if (is_joints(topic)) return std::make_unique<foxglove::JointStates>();
  if (topic == "jaw") return std::make_unique<pb::JawSample>();
  if (topic == "tracker") return std::make_unique<pb::TrackerSample>();
  if (topic == "markers") return std::make_unique<pb::MarkersSample>();
  if (topic == "force") return std::make_unique<pb::ForceSample>();
  return std::make_unique<pb::CouponSample>();
}

void encode_row(const Series& series, const std::string& topic, std::size_t row,
                google::protobuf::Message& message) {
  const auto stamp = google::protobuf::util::TimeUtil::NanosecondsToTimestamp(series.time_ns[row]);
  const double* values = series.values.data() + row * series.columns.size();
  const std::size_t width = series.columns.size();
  if (is_pose(topic)) {
    auto& pose = static_cast<foxglove::PoseInFrame&>(message);
    *pose.mutable_timestamp() = stamp;
    pose.set_frame_id("W");
    foxglove::Vector3& p = *pose.mutable_pose()->mutable_position();
    p.set_x(values[0]);
    p.set_y(values[1]);
    p.set_z(values[2]);
    if (width < 7) return;
    foxglove::Quaternion& q = *pose.mutable_pose()->mutable_orientation();
    q.set_w(values[3]);
    q.set_x(values[4]);
    q.set_y(values[5]);
    q.set_z(values[6]);
    return;
  }
  if (is_joints(topic)) {
    auto& states = static_cast<foxglove::JointStates&>(message);
    *states.mutable_timestamp() = stamp;
    return encode_joints(series, row, states);
  }
  const double t_s = static_cast<double>(series.time_ns[row]) / 1e9;
  if (topic == "markers") {
    auto& markers = static_cast<pb::MarkersSample&>(message);
    markers.set_t_s(t_s);
    markers.mutable_position_m()->Add(values, values + width);
    return;
  }
  if (topic == "tracker") {
    auto& tip = static_cast<pb::TrackerSample&>(message);
    tip.set_t_s(t_s);
    tip.mutable_position_m()->Add(values, values + 3);
    if (width == 7) tip.mutable_orientation_wxyz()->Add(values + 3, values + 7);
    return;
  }
  const google::protobuf::Reflection& fields = *message.GetReflection();
  const google::protobuf::Descriptor& type = *message.GetDescriptor();
  if (const auto* time = type.FindFieldByName("t_s")) fields.SetDouble(&message, time, t_s);
  for (std::size_t k = 0; k < width; ++k) {
    if (std::isnan(values[k])) continue;
    const std::string name = series.columns[k].substr(column_prefix(topic).size());
    fields.SetDouble(&message, type.FindFieldByName(name), values[k]);
  }
}

SeriesCollector::SeriesCollector(std::string topic, std::vector<std::string> marker_names)
    : topic_(std::move(topic)),
      marker_names_(std::move(marker_names)),
      message_(make_message(topic_)) {}

void SeriesCollector::set(const std::string& column, double value) {
  const auto [found, added] = index_.try_emplace(column, columns_.size());
  if (added) columns_.push_back(column);
  std::vector<double>& row = rows_.back();
  if (row.size() < columns_.size()) row.resize(columns_.size(), kUnknown);
  row[found->second] = value;
}

void SeriesCollector::set_pose(const std::string& stem, const double* position,
                               const double* wxyz) {
  constexpr std::array<const char*, 3> kPosition = {"x_m", "y_m", "z_m"};
  constexpr std::array<const char*, 4> kTurn = {"qw", "qx", "qy", "qz"};
  for (std::size_t k = 0; k < 3; ++k) set(stem + kPosition[k], position[k]);
  for (std::size_t k = 0; wxyz != nullptr && k < 4; ++k) set(stem + kTurn[k], wxyz[k]);
}

Result<void> SeriesCollector::add(std::int64_t time_ns, std::string_view data) {
  const auto wrong = [this](const char* what) {
    return Failure{fmt::format("/{}: {} {}", topic_, what, message_->GetDescriptor()->full_name())};
  };
  if (!message_->ParseFromArray(data.data(), static_cast<int>(data.size())))
    return wrong("no message");
  time_ns_.push_back(time_ns);
  rows_.emplace_back();
  if (is_pose(topic_)) {
    const auto& pose = static_cast<const foxglove::PoseInFrame&>(*message_).pose();
    const foxglove::Vector3& p = pose.position();
    const foxglove::Quaternion& q = pose.orientation();
    const std::array<double, 3> xyz = {p.x(), p.y(), p.z()};
    const std::array<double, 4> wxyz = {q.w(), q.x(), q.y(), q.z()};
    set_pose(pose_stem(topic_), xyz.data(), pose.has_orientation() ? wxyz.data() : nullptr);
  } else if (is_joints(topic_)) {
    const auto& states = static_cast<const foxglove::JointStates&>(*message_);
    for (int k = 0; k < std::min(states.joints_size(), 9); ++k) {
      const foxglove::JointState& joint = states.joints(k);
      JointColumn column = joint_of(joint.name(), k);
      column.source = source_of(topic_);
      const auto put = [&](JointColumn::Quantity quantity, bool there, double value) {
        column.quantity = quantity;
        if (there) set(name_of(column), value);
      };
      put(JointColumn::kPosition, joint.has_position(), joint.position());
      put(JointColumn::kVelocity, joint.has_velocity(), joint.velocity());
      put(JointColumn::kEffort, joint.has_effort(), joint.effort());
    }
  } else if (topic_ == "tracker") {
    const auto& tip = static_cast<const pb::TrackerSample&>(*message_);
    const bool turned = tip.orientation_wxyz_size() == 4;
    if (tip.position_m_size() != 3 || (!turned && tip.orientation_wxyz_size() != 0))
      return wrong("neither 3 nor 3 and 4 numbers in");
    set_pose(pose_stem(topic_), tip.position_m().data(),
             turned ? tip.orientation_wxyz().data() : nullptr);
  } else if (topic_ == "markers") {
    const auto& positions = static_cast<const pb::MarkersSample&>(*message_).position_m();
    if (positions.size() % 3 != 0) return wrong("not three numbers a marker in");
    for (std::size_t k = columns_.size() / 3; 3 * k < static_cast<std::size_t>(positions.size());
         ++k) {
      const std::string stem =
          k < marker_names_.size() ? marker_names_[k] : fmt::format("marker{}", k);
      for (const char axis : {'x', 'y', 'z'})
        columns_.push_back(fmt::format("{}_{}_m", stem, axis));
    }
    rows_.back().assign(positions.begin(), positions.end());
  } else {
    const google::protobuf::Reflection& fields = *message_->GetReflection();
    const google::protobuf::Descriptor& type = *message_->GetDescriptor();
    for (int k = 0; k < type.field_count(); ++k) {
      const google::protobuf::FieldDescriptor& field = *type.field(k);
      if (!is_number_of_row(field) || !fields.HasField(*message_, &field)) continue;
      set(column_prefix(topic_) + field.name(), fields.GetDouble(*message_, &field));
    }
  }
  return {};
}

Result<Series> SeriesCollector::finish(std::vector<std::string>& warnings) {
  if (topic_ == "force") {  // a message lacks the axes that are not known
    for (const char* group : {"f{}_N", "t{}_Nm"}) {
      const std::string x = fmt::format(fmt::runtime(group), 'x'),
                        y = fmt::format(fmt::runtime(group), 'y'),
                        z = fmt::format(fmt::runtime(group), 'z');
      if (!index_.contains(x) && !index_.contains(y) && !index_.contains(z)) continue;
      for (const std::string& axis : {x, y, z}) {
        if (index_.try_emplace(axis, columns_.size()).second) columns_.push_back(axis);
      }
    }
  }
  Series series;
  series.columns = columns_;
  std::vector<std::size_t> order(time_ns_.size());
  std::iota(order.begin(), order.end(), std::size_t{0});
  std::stable_sort(order.begin(), order.end(),
                   [&](std::size_t a, std::size_t b) { return time_ns_[a] < time_ns_[b]; });
  std::size_t dropped = 0;
  for (const std::size_t row : order) {
    if (!series.time_ns.empty() && time_ns_[row] == series.time_ns.back()) {
      ++dropped;
      continue;
    }
    series.time_ns.push_back(time_ns_[row]);
    rows_[row].resize(columns_.size(), kUnknown);
    series.values.insert(series.values.end(), rows_[row].begin(), rows_[row].end());
    rows_[row] = {};
  }
  if (dropped > 0)
    warnings.push_back(fmt::format("/{}: {} samples at the time of another one", topic_, dropped));
  if (Result<void> done = normalise(file_of(topic_), series); !done)
    return Failure{fmt::format("/{}: {}", topic_, done.error())};
  if (const std::string told = told_never_known(series); topic_ == "force" && !told.empty())
    warnings.push_back(fmt::format("/force: {}", told));
  return series;
}

std::vector<std::string> marker_names(const Series& markers) {
  std::vector<std::string> names;
  bool usual = true;
  for (std::size_t k = 0; 3 * k < markers.columns.size(); ++k) {
    const std::string& column = markers.columns[3 * k];
    names.push_back(column.substr(0, column.size() - 4));
    usual = usual && names.back() == fmt::format("marker{}", k);
  }
  return usual ? std::vector<std::string>() : names;
}

}  // namespace omentum

// What ROS 2 would read: topic, type, policies and bytes, against layouts written by hand.
#include "dvrk_gateway/bus/ros_topics.h"

#include <dds/dds.h>
#include <dds/ddsi/ddsi_serdata.h>
#include <gtest/gtest.h>

#include <cstring>
#include <map>

#include "core/clock.h"
#include "ros.h"  // generated: only to make readers
#include "tests/support/domain.h"

namespace omentum {
namespace {

constexpr std::int64_t kS = 1'000'000'000;

/// Bytes of one sample with the four of its encapsulation in front.
std::string bytes_of(dds_entity_t participant, const char* topic_name,
                     const dds_topic_descriptor_t& type, const std::function<void()>& publish) {
  const dds_entity_t topic = dds_create_topic(participant, &type, topic_name, nullptr, nullptr);
  EXPECT_GT(topic, 0) << dds_strretcode(topic);
  const dds_entity_t reader = dds_create_reader(participant, topic, nullptr, nullptr);
  EXPECT_GT(reader, 0) << dds_strretcode(reader);
  publish();
  const dds_entity_t waitset = dds_create_waitset(participant);
  const dds_entity_t condition = dds_create_readcondition(reader, DDS_ANY_STATE);
  dds_waitset_attach(waitset, condition, 0);
  EXPECT_GT(dds_waitset_wait(waitset, nullptr, 0, DDS_SECS(10)), 0) << "no sample";
  struct ddsi_serdata* sample = nullptr;
  dds_sample_info_t info;
  std::string bytes;
  if (dds_takecdr(reader, &sample, 1, &info, DDS_ANY_STATE) == 1) {
    bytes.resize(ddsi_serdata_size(sample));
    ddsi_serdata_to_ser(sample, 0, bytes.size(), bytes.data());
    ddsi_serdata_unref(sample);
  }
  dds_delete(waitset);
  dds_delete(reader);
  return bytes;
}

/// Little-endian CDR as the standard writes it: members aligned to their size from behind the
/// encapsulation.
class Cdr {
 public:
  template <typename T>
  Cdr& put(T value) {
    while ((bytes_.size() - 4) % sizeof(T) != 0) bytes_.push_back('\0');
    char raw[sizeof(T)];
    std::memcpy(raw, &value, sizeof(T));
    bytes_.append(raw, sizeof(T));
    return *this;
  }
  Cdr& text(const std::string& value) {
    put(static_cast<std::uint32_t>(value.size() + 1));
    bytes_.append(value.c_str(), value.size() + 1);
    return *this;
  }
  /// Up to a multiple of four; the last byte of the options says how many were added.
  std::string padded() const {
    std::string all = bytes_;
    for (; all.size() % 4 != 0; all.push_back('\0')) ++all[3];
    return all;
  }
  const std::string& bytes() const { return bytes_; }

 private:
  std::string bytes_{'\0', '\1', '\0', '\0'};  // CDR_LE, no options
};

template <typename T>
T at(const std::string& bytes, std::size_t offset) {
  T value{};
  EXPECT_LE(offset + sizeof(T), bytes.size());
  std::memcpy(&value, bytes.data() + offset, sizeof(T));
  return value;
}

Period some_period() {
  Period period;
  RobotState& robot = period.robot;
  std::strcpy(robot.reference_frame.data(), "PSM1_base");
  robot.measured_cp.seen = true;
  robot.measured_cp.advanced_ns = steady_now_ns();
  CartesianPose& pose = robot.measured_cp.payload;
  pose.valid = true;
  pose.translation = {0.01, -0.02, -0.11};
  pose.rotation = Eigen::AngleAxisd(0.5, Eigen::Vector3d(1, 2, -2).normalized()).matrix();
  robot.operating_state.seen = true;
  robot.operating_state.arrival_ns = steady_now_ns();
  robot.operating_state.payload.state = OperatingState::State::kEnabled;
  robot.operating_state.payload.is_homed = true;
  return period;
}

TEST(RosTopics, MeasuredCpIsAPoseStampedByTheByte) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "ros");
  const dds::Participant ros2(domain.id(), test::loopback_profile().uri, "ros2");
  RosTopics ros(participant, "PSM1");
  const std::int64_t before_ns = wall_now_ns();
  const std::string bytes =
      bytes_of(ros2.handle(), "rt/PSM1/measured_cp", geometry_msgs_msg_dds__PoseStamped__desc,
               [&] { ros.on_period(some_period()); });
  ASSERT_GE(bytes.size(), 12U);
  const auto seconds = at<std::int32_t>(bytes, 4);
  const auto nanoseconds = at<std::uint32_t>(bytes, 8);
  EXPECT_LT(nanoseconds, 1'000'000'000U);
  const std::int64_t stamp_ns = std::int64_t{seconds} * kS + nanoseconds;
  EXPECT_GE(stamp_ns, before_ns - kS);
  EXPECT_LE(stamp_ns, wall_now_ns() + kS);
  const double half = 0.25;
  const std::string wanted =
      Cdr().put(seconds).put(nanoseconds).text("PSM1_base").put(0.01).put(-0.02).put(-0.11).bytes();
  ASSERT_EQ(bytes.size(), wanted.size() + 4 * sizeof(double));
  EXPECT_EQ(bytes.substr(0, wanted.size()), wanted);
  const double axis = std::sin(half) / 3;
  EXPECT_NEAR(at<double>(bytes, wanted.size()), axis, 1e-12) << "x";
  EXPECT_NEAR(at<double>(bytes, wanted.size() + 8), 2 * axis, 1e-12) << "y";
  EXPECT_NEAR(at<double>(bytes, wanted.size() + 16), -2 * axis, 1e-12) << "z";
  EXPECT_NEAR(at<double>(bytes, wanted.size() + 24), std::cos(half), 1e-12) << "w";
}

TEST(RosTopics, OperatingStateIsCrtksByTheByte) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "ros");
  const dds::Participant ros2(domain.id(), test::loopback_profile().uri, "ros2");
  RosTopics ros(participant, "PSM2");
  const std::string bytes =
      bytes_of(ros2.handle(), "rt/PSM2/operating_state", crtk_msgs_msg_dds__OperatingState__desc,
               [&] { ros.on_period(some_period()); });
  ASSERT_GE(bytes.size(), 12U);
  EXPECT_EQ(bytes, Cdr()
                       .put(at<std::int32_t>(bytes, 4))
                       .put(at<std::uint32_t>(bytes, 8))
                       .text("")
                       .text("ENABLED")
                       .put(true)
                       .put(false)
                       .padded());
}

TEST(RosTopics, NamesTypesAndPoliciesAreThoseOfRos2) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "ros");
  const RosTopics ros(participant, "PSM1");
  const dds_entity_t builtin =
      dds_create_reader(participant.handle(), DDS_BUILTIN_TOPIC_DCPSPUBLICATION, nullptr, nullptr);
  std::map<std::string, std::string> types;
  void* samples[1] = {nullptr};
  dds_sample_info_t infos[1];
  while (dds_take(builtin, samples, infos, 1, 1) == 1) {
    const auto* endpoint = static_cast<const dds_builtintopic_endpoint_t*>(samples[0]);
    if (std::strncmp(endpoint->topic_name, "rt/", 3) == 0) {
      types[endpoint->topic_name] = endpoint->type_name;
      dds_reliability_kind_t reliability{};
      dds_duration_t blocking = 0;
      dds_durability_kind_t durability{};
      std::uint32_t partitions = 0;
      char** names = nullptr;
      dds_qget_reliability(endpoint->qos, &reliability, &blocking);
      dds_qget_durability(endpoint->qos, &durability);
      EXPECT_EQ(reliability, DDS_RELIABILITY_RELIABLE);
      EXPECT_EQ(durability, DDS_DURABILITY_VOLATILE);
      if (dds_qget_partition(endpoint->qos, &partitions, &names)) {
        // The default partition, in which ROS 2 is.
        for (std::uint32_t i = 0; i < partitions; ++i) {
          EXPECT_STREQ(names[i], "");
          dds_free(names[i]);
        }
        dds_free(static_cast<void*>(names));
      }
    }
    dds_return_loan(builtin, samples, 1);
    samples[0] = nullptr;
  }
  EXPECT_EQ(types, (std::map<std::string, std::string>{
                       {"rt/PSM1/measured_cp", "geometry_msgs::msg::dds_::PoseStamped_"},
                       {"rt/PSM1/operating_state", "crtk_msgs::msg::dds_::OperatingState_"}}));
}

TEST(RosTopics, ASecondPublisherOfTheNamesIsToldInALine) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "ros");
  const dds::Participant other(domain.id(), test::loopback_profile().uri, "other");
  testing::internal::CaptureStderr();
  const RosTopics second(other, "PSM1"), elsewhere(other, "PSM2");
  RosTopics ros(participant, "PSM1"), alone(participant, "PSM3");
  ros.on_period(some_period());
  alone.on_period(some_period());
  const std::string said = testing::internal::GetCapturedStderr();
  EXPECT_NE(said.find("event=ros_publishers_meet topic=rt/PSM1/measured_cp others=2"),
            std::string::npos)
      << said;
  EXPECT_EQ(said.find("PSM3"), std::string::npos) << said;
}

TEST(RosTopics, APoseThatIsInvalidOrTheSameIsNotPublishedAgain) {
  const test::PrivateDomain domain;
  const dds::Participant participant(domain.id(), test::loopback_profile().uri, "ros");
  const dds::Participant ros2(domain.id(), test::loopback_profile().uri, "ros2");
  RosTopics ros(participant, "PSM1");
  const dds_entity_t topic =
      dds_create_topic(ros2.handle(), &geometry_msgs_msg_dds__PoseStamped__desc,
                       "rt/PSM1/measured_cp", nullptr, nullptr);
  dds_qos_t* all = dds_create_qos();
  dds_qset_history(all, DDS_HISTORY_KEEP_ALL, 0);
  const dds_entity_t reader = dds_create_reader(ros2.handle(), topic, all, nullptr);
  dds_delete_qos(all);
  Period period = some_period();
  ros.on_period(period);
  ros.on_period(period);
  period.robot.measured_cp.advanced_ns += 20'000'000;
  period.robot.measured_cp.payload.valid = false;
  ros.on_period(period);
  period.robot.measured_cp.payload.valid = true;
  ros.on_period(period);
  void* samples[8] = {};
  dds_sample_info_t infos[8];
  const int count = dds_take(reader, samples, infos, 8, 8);  // within a process: there at once
  EXPECT_EQ(count, 2);
  if (count > 0) dds_return_loan(reader, samples, count);
  EXPECT_EQ(ros.write_failures(), 0U);
}

}  // namespace
}  // namespace omentum

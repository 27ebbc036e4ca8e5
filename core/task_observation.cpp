// What a policy observes: one list of names, units and values for every preset.

#include <fmt/core.h>

#include <algorithm>

#include "core/check.h"
#include "core/constants.h"
#include "core/task.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr int kUnityInW[] = {0, 2, 1};  // axis of W that is x, y, z of Unity
constexpr double kNearRange = 0.005;    // [m] where the fine observation of the goal saturates

/// What the entries are computed from. Points in W [m].
struct Seen {
  const TaskState& state;
  const TaskPlaces& places;
  double jaw_open_deg;
  const Vector3d& tumour_point;
  double turn_limit;  ///< [rad]
  Vector3d orientation_error;

  const Vector3d& p() const { return state.measured_tip; }
  const Vector3d& q() const { return tumour_point; }
  const Vector3d& p_T() const { return places.target; }
  const Vector3d& goal() const { return state.held ? p_T() : q(); }
};

/// Decides unit, scale and count of an entry's numbers.
enum class Quantity {
  kNumber,    ///< one: x of the value
  kPoint,     ///< three
  kDistance,  ///< one: length of the value
  kOffset,    ///< three, clipped to kNearRange
  kDirection  ///< three, of a vector without unit
};

/// One entry of the observation; its value in SI units.
struct Entry {
  const char* name;
  Quantity quantity;
  Vector3d (*value)(const Seen&);
  const char* unit = nullptr;  ///< of a kNumber; the others have that of their scale
};

using enum Quantity;
constexpr Entry kHeldFlag = {"held_flag", kNumber,
                             [](const Seen& s) { return Vector3d(s.state.held ? 0 : 1, 0, 0); },
                             "0 = held; 1 = not held"};
constexpr Entry kTip = {"p", kPoint, [](const Seen& s) { return s.p(); }};
constexpr Entry kTumourPoint = {"q", kPoint, [](const Seen& s) { return s.q(); }};
constexpr Entry kTarget = {"p_T", kPoint, [](const Seen& s) { return s.p_T(); }};
constexpr Entry kGoal = {"goal", kPoint, [](const Seen& s) { return s.goal(); }};
constexpr Entry kDistanceTumour = {"distance_p_q", kDistance,
                                   [](const Seen& s) -> Vector3d { return s.p() - s.q(); }};
constexpr Entry kDistanceTarget = {"distance_p_p_T", kDistance,
                                   [](const Seen& s) -> Vector3d { return s.p() - s.p_T(); }};
constexpr Entry kDistanceGoal = {"distance_p_goal", kDistance,
                                 [](const Seen& s) -> Vector3d { return s.p() - s.goal(); }};
// How far the jaw is closed: its angle where it has one (a robot measures it), else the command.
constexpr Entry kJawClosed = {
    "jaw_closed", kNumber,
    [](const Seen& s) {
      const double command = s.state.jaw_closed ? 1 : 0;
      return Vector3d(s.jaw_open_deg > 0 ? 1 - s.state.jaw_deg / s.jaw_open_deg : command, 0, 0);
    },
    "0 = open ... 1 = closed"};
constexpr Entry kExposure = {"exposure", kNumber,
                             [](const Seen& s) { return Vector3d(s.state.exposure, 0, 0); },
                             "visible fraction of the tumour"};
// Where the sheet was grasped: the value of a held state depends on it.
constexpr Entry kGraspPoint = {
    "grasp", kPoint, [](const Seen& s) { return s.state.held ? s.state.held_from : s.p(); }};
// The goal relative to the tip, at a finer scale: over the workspace's width a millimetre is 0.01
// of an input, and greedy policies stopped 3 mm from p_T (docs/decisions/0009).
constexpr Entry kNearGoal = {"near_goal", kOffset,
                             [](const Seen& s) -> Vector3d { return s.goal() - s.p(); }};

// How the tool is turned, over its range, and what the jaw has to turn to.
constexpr const char* kOfTurnLimit = "-1 ... 1 over task.turn_limit_deg";
constexpr Entry kRoll = {
    "roll", kNumber, [](const Seen& s) { return Vector3d(s.state.angles[0] / s.turn_limit, 0, 0); },
    kOfTurnLimit};
constexpr Entry kPitch = {
    "pitch", kNumber,
    [](const Seen& s) { return Vector3d(s.state.angles[1] / s.turn_limit, 0, 0); }, kOfTurnLimit};
constexpr Entry kYaw = {
    "yaw", kNumber, [](const Seen& s) { return Vector3d(s.state.angles[2] / s.turn_limit, 0, 0); },
    kOfTurnLimit};
constexpr Entry kNormal = {"normal", kDirection, [](const Seen& s) -> Vector3d {
                             return s.state.place != nullptr ? s.state.place->normal
                                                             : Vector3d::Zero();
                           }};
constexpr Entry kOrientationError = {"orientation_error", kDirection,
                                     [](const Seen& s) { return s.orientation_error; }};

std::span<const Entry> entries(pb::ObservationKind kind) {
  static constexpr Entry kOriented[] = {
      kHeldFlag,       kTip,       kTumourPoint, kTarget,     kDistanceTumour,
      kDistanceTarget, kJawClosed, kExposure,    kGraspPoint, kNearGoal,
      kRoll,           kPitch,     kYaw,         kNormal,     kOrientationError};
  static constexpr std::span<const Entry> kOmentum = std::span(kOriented).first<10>();
  static constexpr Entry kDerivedHead[] = {kHeldFlag, kTip, kGoal, kDistanceGoal};
  switch (kind) {
    case pb::OBSERVATION_DERIVED_HEAD:
      return kDerivedHead;
    case pb::OBSERVATION_PAPER:
    case pb::OBSERVATION_DERIVED:
      return kOmentum.first(6);
    case pb::OBSERVATION_ORIENTED:
      return kOriented;
    case pb::OBSERVATION_OMENTUM:
    case pb::OBSERVATION_IMAGE:
      break;
  }
  return kOmentum;
}

/// Lengths of 100 mm, points in Unity's axes; else lengths and points of the workspace.
bool is_raw(const pb::Task& task) {
  return task.observation() == pb::OBSERVATION_DERIVED ||
         task.observation() == pb::OBSERVATION_DERIVED_HEAD;
}

std::string unit_of(const Entry& entry, bool raw, int axis) {
  static constexpr const char* kAxes[] = {"x", "y", "z"};
  switch (entry.quantity) {
    case kNumber:
      return entry.unit;
    case kPoint:
      return raw ? fmt::format("100 mm along {} of W", kAxes[kUnityInW[axis]])
                 : fmt::format("-1 ... 1 over the workspace along {} of W", kAxes[axis]);
    case kDistance:
      return raw ? "100 mm" : "diagonal of the workspace";
    case kDirection:
      return fmt::format("-1 ... 1 along {} of W", kAxes[axis]);
    case kOffset:
      break;
  }
  return fmt::format("{:g} mm along {} of W; within -1 ... 1", 1e3 * kNearRange, kAxes[axis]);
}

}  // namespace

PictureShape picture_shape(const pb::Task& task) {
  if (task.observation() != pb::OBSERVATION_IMAGE) return {};
  return {static_cast<int>(task.image_size()), task.image() == pb::IMAGE_SHADED ? 3 : 1};
}

std::vector<ObservedEntry> observed_entries(const pb::Task& task) {
  std::vector<ObservedEntry> observed;
  const bool raw = is_raw(task);
  for (const Entry& entry : entries(task.observation())) {
    if (entry.quantity == kNumber || entry.quantity == kDistance) {
      observed.push_back({entry.name, unit_of(entry, raw, 0)});
      continue;
    }
    for (int k = 0; k < 3; ++k)
      observed.push_back({fmt::format("{}_{}", entry.name, "xyz"[k]), unit_of(entry, raw, k)});
  }
  const PictureShape picture = picture_shape(task);
  if (picture.size == 0) return observed;
  std::string name = fmt::format("image[{}][{}]", picture.size, picture.size);
  if (picture.channels == 1) {
    observed.push_back(
        {std::move(name), fmt::format("object id / {}", kObjectIds), picture.values()});
  } else {
    observed.push_back(
        {fmt::format("{}[{}]", name, picture.channels), "intensity 0 ... 1", picture.values()});
  }
  return observed;
}

std::vector<std::string> observation_names(const pb::Task& task) {
  std::vector<std::string> names;
  for (ObservedEntry& entry : observed_entries(task)) names.push_back(std::move(entry.name));
  return names;
}

std::string observation_name(const pb::Task& task, int index) {
  const std::vector<ObservedEntry> observed = observed_entries(task);
  const PictureShape picture = picture_shape(task);
  const int pixel = index - static_cast<int>(observed.size()) + 1;
  if (picture.size == 0 || pixel < 0) return observed[static_cast<std::size_t>(index)].name;
  const int column = pixel / picture.channels;
  std::string name = fmt::format("image[{}][{}]", column / picture.size, column % picture.size);
  return picture.channels == 1 ? name : fmt::format("{}[{}]", name, pixel % picture.channels);
}

int observation_size(const pb::Task& task) {
  int size = 0;
  for (const ObservedEntry& entry : observed_entries(task)) size += entry.size;
  return size;
}

std::span<float> Task::observe(const TaskState& state, std::span<float> observation) const {
  const Seen seen{state,
                  places_,
                  jaw_open_deg_,
                  q_of(state),
                  task_.turn_limit_deg() * kDegree,
                  orientation_error(state)};
  const Vector3d& low = places_.mount.workspace_min;
  const Vector3d& high = places_.mount.workspace_max;
  const bool raw = is_raw(task_);
  std::size_t next = 0;
  const auto add = [&](double value) { observation[next++] = static_cast<float>(value); };
  for (const Entry& entry : entries(task_.observation())) {
    const Vector3d value = entry.value(seen);
    switch (entry.quantity) {
      case kNumber:
        add(value.x());
        break;
      case kPoint:
        for (int k = 0; k < 3; ++k) {
          const int axis = raw ? kUnityInW[k] : k;
          add(raw ? 10 * value[axis] : 2 * (value[k] - low[k]) / (high[k] - low[k]) - 1);
        }
        break;
      case kDistance:
        add(raw ? 10 * value.norm() : value.norm() / workspace_diagonal_);
        break;
      case kOffset:
        for (int k = 0; k < 3; ++k) add(std::clamp(value[k] / kNearRange, -1.0, 1.0));
        break;
      case kDirection:
        for (int k = 0; k < 3; ++k) add(value[k]);
        break;
    }
  }
  return observation.subspan(next);
}

}  // namespace omentum

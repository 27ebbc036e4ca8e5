// What a policy observes: one list of names, units and values for every preset.

#include <fmt/core.h>

#include <algorithm>

#include "core/check.h"
#include "core/task.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kNearRange = 0.005;  // [m] where the fine observation of the goal saturates

/// What a value function sees.
struct Seen {
  const TaskState& state;
  const TaskPlaces& places;
  double jaw_open_deg;

  const Vector3d& goal() const { return state.held ? places.target : places.tumour_point; }
};

/// Decides unit and scale of an entry; a point and an offset have three numbers.
enum class Quantity { kNumber, kPoint, kDistance, kOffset };

/// One entry of the observation: its value in SI units, a number in x.
struct Entry {
  const char* name;
  Quantity quantity;
  const char* unit;  ///< of a kNumber; the others have that of their scale
  Vector3d (*value)(const Seen&);
};

Vector3d number(double value) { return {value, 0, 0}; }

constexpr Entry kHeldFlag = {"held_flag", Quantity::kNumber, "0 = held; 1 = not held",
                             [](const Seen& s) { return number(s.state.held ? 0 : 1); }};
constexpr Entry kTip = {"p", Quantity::kPoint, nullptr,
                        [](const Seen& s) { return s.state.measured_tip; }};
constexpr Entry kTumourPoint = {"q", Quantity::kPoint, nullptr,
                                [](const Seen& s) { return s.places.tumour_point; }};
constexpr Entry kTarget = {"p_T", Quantity::kPoint, nullptr,
                           [](const Seen& s) { return s.places.target; }};
constexpr Entry kGoal = {"goal", Quantity::kPoint, nullptr, [](const Seen& s) { return s.goal(); }};
constexpr Entry kDistanceTumour = {
    "distance_p_q", Quantity::kDistance, nullptr,
    [](const Seen& s) { return number((s.state.measured_tip - s.places.tumour_point).norm()); }};
constexpr Entry kDistanceTarget = {
    "distance_p_p_T", Quantity::kDistance, nullptr,
    [](const Seen& s) { return number((s.state.measured_tip - s.places.target).norm()); }};
constexpr Entry kDistanceGoal = {
    "distance_p_goal", Quantity::kDistance, nullptr,
    [](const Seen& s) { return number((s.state.measured_tip - s.goal()).norm()); }};
// How far the jaw is closed: its angle where it has one (a robot measures it), else the command.
constexpr Entry kJawClosed = {
    "jaw_closed", Quantity::kNumber, "0 = open ... 1 = closed", [](const Seen& s) {
      return number(s.jaw_open_deg > 0 ? 1 - s.state.jaw_deg / s.jaw_open_deg
                                       : (s.state.jaw_closed ? 1.0 : 0.0));
    }};
constexpr Entry kExposure = {"exposure", Quantity::kNumber, "visible fraction of the tumour",
                             [](const Seen& s) { return number(s.state.exposure); }};
// Where the sheet was taken hold of: without it the value of a held state cannot be told.
constexpr Entry kGraspPoint = {"grasp", Quantity::kPoint, nullptr, [](const Seen& s) {
                                 return s.state.held ? s.state.held_from : s.state.measured_tip;
                               }};
// The goal seen from the tip, fine: over the workspace's width a millimetre is 0.01 of an input,
// and greedy policies stood still 3 mm from p_T (docs/decisions/0009).
constexpr Entry kNearGoal = {
    "near_goal", Quantity::kOffset, nullptr,
    [](const Seen& s) -> Vector3d { return s.goal() - s.state.measured_tip; }};

std::span<const Entry> entries(pb::ObservationKind kind) {
  static constexpr Entry kOmentum[] = {
      kHeldFlag,       kTip,       kTumourPoint, kTarget,     kDistanceTumour,
      kDistanceTarget, kJawClosed, kExposure,    kGraspPoint, kNearGoal};
  static constexpr Entry kDerivedHead[] = {kHeldFlag, kTip, kGoal, kDistanceGoal};
  switch (kind) {
    case pb::OBSERVATION_DERIVED_HEAD:
      return kDerivedHead;
    case pb::OBSERVATION_PAPER:
    case pb::OBSERVATION_DERIVED:
      return std::span(kOmentum).first(6);
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
  static constexpr int kUnityInW[] = {0, 2, 1};
  switch (entry.quantity) {
    case Quantity::kNumber:
      return entry.unit;
    case Quantity::kPoint:
      return raw ? fmt::format("100 mm along {} of W", kAxes[kUnityInW[axis]])
                 : fmt::format("-1 ... 1 over the workspace along {} of W", kAxes[axis]);
    case Quantity::kDistance:
      return raw ? "100 mm" : "diagonal of the workspace";
    case Quantity::kOffset:
      break;
  }
  return fmt::format("{:g} mm along {} of W; within -1 ... 1", 1e3 * kNearRange, kAxes[axis]);
}

std::vector<ObservedNumber> numbers_of_entries(const pb::Task& task) {
  std::vector<ObservedNumber> numbers;
  const bool raw = is_raw(task);
  for (const Entry& entry : entries(task.observation())) {
    if (entry.quantity == Quantity::kNumber || entry.quantity == Quantity::kDistance) {
      numbers.push_back({entry.name, unit_of(entry, raw, 0)});
      continue;
    }
    for (int k = 0; k < 3; ++k)
      numbers.push_back({fmt::format("{}_{}", entry.name, "xyz"[k]), unit_of(entry, raw, k)});
  }
  return numbers;
}

}  // namespace

std::vector<ObservedNumber> observed_numbers(const pb::Task& task) {
  std::vector<ObservedNumber> numbers = numbers_of_entries(task);
  if (task.observation() != pb::OBSERVATION_IMAGE) return numbers;
  const bool ids = task.image() == pb::IMAGE_OBJECT_IDS;
  const std::vector<std::string> channels =
      ids ? std::vector<std::string>{"object"} : std::vector<std::string>{"red", "green", "blue"};
  for (std::uint32_t row = 0; row < task.image_size(); ++row) {
    for (std::uint32_t column = 0; column < task.image_size(); ++column) {
      for (const std::string& channel : channels) {
        numbers.push_back({fmt::format("{}_{}_{}", channel, row, column),
                           ids ? "object id / 6" : "intensity 0 ... 1"});
      }
    }
  }
  return numbers;
}

std::vector<std::string> observation_names(const pb::Task& task) {
  std::vector<std::string> names;
  for (ObservedNumber& number : observed_numbers(task)) names.push_back(std::move(number.name));
  return names;
}

std::vector<std::string> observation_units(const pb::Task& task) {
  std::vector<std::string> units;
  for (ObservedNumber& number : observed_numbers(task)) units.push_back(std::move(number.unit));
  return units;
}

std::vector<std::string> observation_titles(const pb::Task& task) {
  std::vector<std::string> titles;
  for (ObservedNumber& number : numbers_of_entries(task)) titles.push_back(std::move(number.name));
  if (task.observation() == pb::OBSERVATION_IMAGE) titles.emplace_back("image");
  return titles;
}

int observation_size(const pb::Task& task) {
  return static_cast<int>(observed_numbers(task).size());
}

std::span<float> Task::observe(const TaskState& state, std::span<float> observation) const {
  const Seen seen{state, places_, jaw_open_deg_};
  const Vector3d& low = places_.mount.workspace_min;
  const Vector3d& high = places_.mount.workspace_max;
  const bool raw = is_raw(task_);
  std::size_t next = 0;
  const auto add = [&](double value) { observation[next++] = static_cast<float>(value); };
  for (const Entry& entry : entries(task_.observation())) {
    const Vector3d value = entry.value(seen);
    switch (entry.quantity) {
      case Quantity::kNumber:
        add(value.x());
        break;
      case Quantity::kPoint:
        if (raw) {  // Unity's axes: x, z, y of W
          add(10 * value.x());
          add(10 * value.z());
          add(10 * value.y());
        } else {
          for (int k = 0; k < 3; ++k) add(2 * (value[k] - low[k]) / (high[k] - low[k]) - 1);
        }
        break;
      case Quantity::kDistance:
        add(raw ? 10 * value.x() : value.x() / workspace_diagonal_);
        break;
      case Quantity::kOffset:
        for (int k = 0; k < 3; ++k) add(std::clamp(value[k] / kNearRange, -1.0, 1.0));
        break;
    }
  }
  return observation.subspan(next);
}

}  // namespace omentum

#include <array>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <span>
#include <type_traits>
#include <vector>

#include "core/episode_recording.h"
#include "core/segment_fields.h"
#include "learner/advantage.h"
#include "learner/batch.h"
#include "learner/evaluation.h"
#include "learner/initialise.h"
#include "learner/task_book.h"
#include "tests/learner/fake_rollout.h"

// A good answer to a task, changed field by field as the bytes say and sent to the task book: it is
// refused with a reason, or batch and advantages (of a rollout), judgement and recording (of an
// evaluation) are made from it without a read beyond any end.
// Bytes: which task, whether hashes are made to fit, then changes of four bytes each.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

struct Change {
  std::uint8_t field, kind, index, value;
};

template <typename T>
T special(std::uint8_t value) {
  if constexpr (std::is_floating_point_v<T>) {
    constexpr T kLimit = std::numeric_limits<T>::infinity();
    constexpr std::array<T, 6> kSome = {0,      -1,      1e30F,
                                        kLimit, -kLimit, std::numeric_limits<T>::quiet_NaN()};
    return value < kSome.size() ? kSome[value] : static_cast<T>(value);
  } else if constexpr (std::is_same_v<T, std::byte>) {
    return std::byte{value};
  } else {
    return value >= 250 ? static_cast<T>(std::numeric_limits<T>::max() - (255 - value))
                        : static_cast<T>(value);
  }
}

/// Changes the field that comes `left` fields later.
struct Changer {
  Change change;
  int left;

  bool here() { return left-- == 0; }
  void values(auto& segment, auto& /*same*/, auto members) {
    const auto one = [this]<typename T>(T& field) {
      if (here()) field = special<T>(change.value);
    };
    std::apply([&one](auto&... fields) { (one(fields), ...); }, members(segment));
  }
  void delivery(auto& segment, auto& same, auto members) { values(segment, same, members); }
  template <typename T, typename C>
  void enumerator(T& field, T& /*same*/, C last, const char* /*name*/) {
    // The bus lets no other number in.
    if (here()) field = static_cast<T>(change.value % (static_cast<std::uint32_t>(last) + 1));
  }
  template <typename T>
  void text(T& field, T& /*same*/, const char* /*name*/) {
    if (here()) field.assign(change.index, static_cast<char>(change.value));
  }
  template <typename T>
  void array(std::vector<T>& field, std::vector<T>& /*same*/, const ArrayField& /*about*/) {
    if (!here()) return;
    const T entry = special<T>(change.value);
    const std::size_t at = field.empty() ? 0 : change.index % field.size();
    const auto place = field.begin() + static_cast<std::ptrdiff_t>(at);
    switch (change.kind % 5) {
      case 0:
        field.resize(change.index, entry);
        break;
      case 1:
        if (!field.empty()) field[at] = entry;
        break;
      case 2:
        field.insert(place, entry);
        break;
      case 3:
        if (!field.empty()) field.erase(place);
        break;
      default:
        field.insert(field.end(), change.index, entry);
    }
  }
};

void require(bool good) {
  if (!good) __builtin_trap();
}

enum class Kind { kFirst, kSecond, kEvaluation, kContinuous };

TaskBookConfig config_of(Kind kind) {
  TaskBookConfig config;
  config.steps = 12;
  config.episode_decisions = 5;
  config.state_format = 4;
  config.shape = test::fake_shape();
  if (kind == Kind::kContinuous) {
    config.shape.branches.clear();
    config.shape.continuous = true;
  }
  return config;
}

RolloutSegment answer(const RolloutTask& task, Kind kind) {
  RolloutSegment segment = test::fake_rollout(task, 5);
  if (kind == Kind::kContinuous) {
    segment.actions.assign(segment.actions.size(), 0);
    segment.actions_continuous.assign(segment.actions.size(), 0.25F);
    segment.payload_crc32c = segment_crc(segment);
  }
  return segment;
}

void learn(TaskBook& book, Kind kind) {
  static const auto policy_of = [](Kind of) {
    const PolicyShape shape = config_of(of).shape;
    PolicyWeights weights;
    weights.parameters = initial_parameters(shape, pb::Ppo(), 1);
    return Policy(shape, std::move(weights));
  };
  static Policy discrete = policy_of(Kind::kFirst);
  static Policy continuous = policy_of(Kind::kContinuous);
  Policy& policy = kind == Kind::kContinuous ? continuous : discrete;
  Batch batch = assemble(book.take_batch(), policy.shape());
  complete_batch(policy, batch);
  std::vector<float> advantages(batch.rows());
  std::vector<float> returns(batch.rows());
  estimate_advantages(batch, batch.rewards, {}, advantages, returns);
}

void judge_and_record(TaskBook& book) {
  const std::vector<RolloutTask> tasks = book.granted_evaluation();
  const std::vector<RolloutSegment> results = book.take_evaluation();
  EvaluationSet set;
  set.start_indices = {0};
  require(judge(pb::Config::default_instance(), set, results, 0.5).size() == 1);
  RecordingContext context;
  context.particles = particles_of(results, tasks[0].frame_stride);
  if (results[0].failed == 0)
    require(save_episode("/dev/null", tasks[0], results[0], context).has_value());
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const auto kind = static_cast<Kind>(data[0] % 4);
  const bool fit_hashes = data[1] % 8 != 0;
  TaskBook book(config_of(kind));
  book.worker_joined(1, 4);
  book.announce_weights(0, Sha256{});
  std::vector<RolloutTask> tasks = book.grant(1);
  if (kind != Kind::kFirst && kind != Kind::kContinuous) {
    require(book.receive(answer(tasks[0], kind), 2) == Verdict::kAdmitted);
    book.take_batch();
    book.announce_weights(1, Sha256{});
    if (kind == Kind::kEvaluation) {
      EvaluationTask task;
      task.steps = 12;
      task.frame_stride = 5;
      book.evaluate(std::span(&task, 1));
    }
    tasks = book.grant(3);
  }
  const RolloutTask& task = tasks.back();
  RolloutSegment segment = answer(task, kind);
  for (std::size_t at = 2; at + 4 <= size && at < 2 + 4 * 64; at += 4) {
    Changer changer{{data[at], data[at + 1], data[at + 2], data[at + 3]}, data[at] % 45};
    segment_fields(segment, segment, changer);
  }
  if (fit_hashes) {
    segment.end_hash = hash_state(segment.end_state);
    segment.payload_crc32c = segment_crc(segment);
  }
  const Verdict verdict = book.receive(std::move(segment), 4);
  require(book.check_balance().has_value());
  if (verdict == Verdict::kInvalid)
    require(!book.last_refusal().empty() || !book.last_failure().empty());
  if (verdict != Verdict::kAdmitted) return 0;
  if (kind == Kind::kEvaluation) {
    judge_and_record(book);
  } else {
    learn(book, kind);
  }
  return 0;
}

#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <vector>

#include "core/types.h"

namespace omentum {

/// Tasks that a worker was granted and has not begun, and which of them it runs together next. A
/// group costs the same however many of its lanes are used, and only tasks of one policy version
/// run together: so it begins when its lanes are full, or after a short wait for more.
///
/// For one thread. Times are of one steady clock [ns].
class TaskQueue {
 public:
  struct Entry {
    RolloutTask task;
    std::int64_t at_ns = 0;  ///< arrival
  };

  /// A task that was granted at `now_ns`. True when it replaced an older grant of its slot.
  bool push(RolloutTask task, std::int64_t now_ns);
  std::size_t size() const { return entries_.size(); }
  void clear() { entries_.clear(); }
  /// Calls for every entry; takes out those for which it returns true.
  void erase_if(const std::function<bool(const Entry&)>& unfit);

  /// The next group, at most `lanes` tasks, of those that are `ready`: of the oldest batch first,
  /// because that batch holds up the others. Empty: none is ready, or it is better to wait until
  /// hold_until_ns(). Its tasks are taken out. Precondition: `lanes` > 0.
  std::vector<Entry> next_group(std::size_t lanes,
                                const std::function<bool(const RolloutTask&)>& ready,
                                std::int64_t now_ns);
  /// Until when next_group() held tasks back when it was called last [ns]; 0: it held none.
  std::int64_t hold_until_ns() const { return hold_until_ns_; }

  /// The group taken last ran from begin to end [ns]: new tasks of its slots are expected.
  void group_ran(std::int64_t begin_ns, std::int64_t end_ns);

 private:
  static constexpr std::int64_t kMostGatherNs = 10'000'000;

  std::deque<Entry> entries_;
  std::int64_t last_arrival_ns_ = 0;
  std::int64_t group_end_ns_ = 0;
  std::int64_t gather_ns_ = kMostGatherNs;  ///< wait for more
  std::int64_t hold_until_ns_ = 0;
};

}  // namespace omentum

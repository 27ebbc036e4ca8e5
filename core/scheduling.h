#pragma once

namespace omentum {

/// While it lives, the calling thread and the threads it makes get short slices of the CPU
/// (0.1 ms), and with them the CPU soon after they wake: for those that receive and pass on, beside
/// threads that compute. Linux 6.12 and later; without effect before, and where a thread has
/// another policy than SCHED_OTHER (`man sched_setattr`). Costs two system calls. The thread that
/// made it must destroy it.
class ShortSlices {
 public:
  ShortSlices();
  ~ShortSlices();
  ShortSlices(const ShortSlices&) = delete;
  ShortSlices& operator=(const ShortSlices&) = delete;
};

/// For the thread of the lanes: lowers it by 5 steps of nice(1), for good, so that what talks on
/// the same cores goes first (docs/wire.md 5.4). Threads it makes later are as low.
void yield_to_bus();

/// Lets malloc keep 8 MiB of freed memory. A segment and its copies are freed and wanted again all
/// the time; to give their pages back and to fault them in anew took a sixth of what the bus can
/// carry.
void keep_freed_memory();

}  // namespace omentum

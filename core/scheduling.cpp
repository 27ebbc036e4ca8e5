#include "core/scheduling.h"

#include <malloc.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cstdint>

namespace omentum {
namespace {

constexpr std::uint64_t kShortSliceNs = 100'000;  // the least that Linux grants
constexpr int kLanesNice = 5;
constexpr int kKeptBytes = 8 << 20;
constexpr int kLargestKeptBytes = 1 << 20;  // larger ones go back to the system each by itself

/// struct sched_attr of Linux; the C library has none.
struct SchedulingAttributes {
  std::uint32_t size = sizeof(SchedulingAttributes);
  std::uint32_t policy = SCHED_OTHER;
  std::uint64_t flags = 0;
  std::int32_t nice = 0;
  std::uint32_t priority = 0;
  std::uint64_t runtime_ns = 0;
  std::uint64_t deadline_ns = 0;
  std::uint64_t period_ns = 0;
};

/// 0 = the slice of the system. What is refused stays as it was: nothing depends on it but time.
void set_slice(std::uint64_t slice_ns) {
  if (sched_getscheduler(0) != SCHED_OTHER) return;
  SchedulingAttributes attributes;
  attributes.nice = getpriority(PRIO_PROCESS, 0);  // of this thread
  attributes.runtime_ns = slice_ns;
  (void)syscall(SYS_sched_setattr, 0, &attributes, 0U);
}

}  // namespace

ShortSlices::ShortSlices() { set_slice(kShortSliceNs); }
ShortSlices::~ShortSlices() { set_slice(0); }

void yield_to_bus() {
  const int nice = getpriority(PRIO_PROCESS, 0);
  (void)setpriority(PRIO_PROCESS, 0, std::min(nice + kLanesNice, 19));
}

void keep_freed_memory() {
  mallopt(M_TRIM_THRESHOLD, kKeptBytes);
  mallopt(M_MMAP_THRESHOLD, kLargestKeptBytes);
}

}  // namespace omentum

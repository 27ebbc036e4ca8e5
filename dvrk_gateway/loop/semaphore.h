#pragma once

#include <semaphore.h>
#include <time.h>

#include <cerrno>
#include <cstdint>

namespace omentum {

/// A POSIX semaphore: wakes another thread. Nothing here allocates or throws; a call that a signal
/// interrupts goes on.
class Semaphore {
 public:
  Semaphore() { sem_init(&semaphore_, 0, 0); }
  ~Semaphore() { sem_destroy(&semaphore_); }
  Semaphore(const Semaphore&) = delete;
  Semaphore& operator=(const Semaphore&) = delete;

  void post() noexcept { sem_post(&semaphore_); }
  void wait() noexcept {
    while (sem_wait(&semaphore_) != 0) {
    }
  }
  /// Until that moment of CLOCK_MONOTONIC at most; whether there was a post.
  bool wait_until(std::int64_t time_ns) noexcept {
    constexpr std::int64_t kSecond_ns = 1'000'000'000;
    const timespec until{time_ns / kSecond_ns, time_ns % kSecond_ns};
    while (sem_clockwait(&semaphore_, CLOCK_MONOTONIC, &until) != 0) {
      if (errno != EINTR) return false;
    }
    return true;
  }
  /// Takes the posts so far.
  void drain() noexcept {
    while (sem_trywait(&semaphore_) == 0 || errno == EINTR) {
    }
  }

 private:
  sem_t semaphore_;
};

}  // namespace omentum

#include "learner/thread_pool.h"

#include <pthread.h>

#include "core/check.h"
#include "core/fp_mode.h"

namespace omentum {

ThreadPool::ThreadPool(int size) : size_(size), start_(size), done_(size) {
  OMENTUM_CHECK(size >= 1 && fp_mode_is_default());
  for (int thread = 1; thread < size; ++thread) {
    threads_.emplace_back([this, thread] {
      OMENTUM_CHECK(fp_mode_is_default());
      pthread_setname_np(pthread_self(), "learn");
      while (true) {
        start_.arrive_and_wait();
        if (work_ == nullptr) return;
        (*work_)(thread);
        done_.arrive_and_wait();
      }
    });
  }
}

ThreadPool::~ThreadPool() {
  work_ = nullptr;
  if (size_ > 1) start_.arrive_and_wait();
}

void ThreadPool::run(const std::function<void(int)>& work) {
  if (size_ == 1) {
    work(0);
    return;
  }
  work_ = &work;
  start_.arrive_and_wait();
  work(0);
  done_.arrive_and_wait();
}

}  // namespace omentum

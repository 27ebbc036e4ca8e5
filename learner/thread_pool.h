#pragma once

#include <barrier>
#include <functional>
#include <thread>
#include <vector>

namespace omentum {

/// A fixed set of threads for fork-join work, created once. The caller is thread 0; with size 1
/// nothing is started and run() is a plain call. Every thread checks its floating-point mode at
/// entry. run() is for one caller at a time.
class ThreadPool {
 public:
  /// Aborts below size 1.
  explicit ThreadPool(int size);
  ~ThreadPool();
  ThreadPool(const ThreadPool&) = delete;
  ThreadPool& operator=(const ThreadPool&) = delete;

  int size() const { return size_; }

  /// Calls work(thread) for thread = 0 ... size - 1, one per thread, and returns when all are done.
  /// `work` must not throw, nor call run().
  void run(const std::function<void(int)>& work);

 private:
  int size_ = 1;
  const std::function<void(int)>* work_ = nullptr;  ///< null at a start = stop
  std::barrier<> start_;
  std::barrier<> done_;
  std::vector<std::jthread> threads_;
};

}  // namespace omentum

#pragma once

#include <string>

namespace omentum {

/// Ownership of a run for as long as the object lives: an flock() on `.<name>.lock` beside the run
/// folder, so that it outlives a folder that is moved or deleted. The file holds "host pid" of the
/// owner; deploy/train.sh reads it.
class RunLock {
 public:
  /// Makes the folder above `run_dir` if missing. Throws Error, one line with host and pid, while
  /// another process owns the run.
  explicit RunLock(const std::string& run_dir);
  ~RunLock();
  RunLock(const RunLock&) = delete;
  RunLock& operator=(const RunLock&) = delete;

 private:
  int fd_ = -1;
};

}  // namespace omentum

#include "learner/run_lock.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <optional>
#include <string>

#include "core/check.h"
#include "support/temp_dir.h"

namespace omentum {
namespace {

std::string refusal_of(const std::string& run_dir) {
  try {
    const RunLock second(run_dir);
  } catch (const Error& error) {
    return error.what();
  }
  return {};
}

TEST(RunLock, ASecondOwnerIsToldHostAndPidOfTheFirst) {
  const test::TempDir dir;
  const std::string run = dir.path() + "/runs/one";
  const RunLock first(run);
  char host[256] = {};
  ASSERT_EQ(gethostname(host, sizeof host - 1), 0);
  EXPECT_EQ(refusal_of(run),
            run + ": in use by the learner of host " + host + ", pid " + std::to_string(getpid()));
  EXPECT_EQ(refusal_of(dir.path() + "/runs/other"), "");
}

TEST(RunLock, OutlivesAFolderThatIsMovedOrDeleted) {
  const test::TempDir dir;
  const std::string run = dir.path() + "/one";
  const RunLock first(run);
  std::filesystem::create_directories(run + "/checkpoints");
  std::filesystem::rename(run, run + ".old1");
  EXPECT_NE(refusal_of(run), "");
  std::filesystem::remove_all(run + ".old1");
  EXPECT_NE(refusal_of(run + "/"), "");  // the same folder by another spelling
}

TEST(RunLock, EndsWithItsOwner) {
  const test::TempDir dir;
  std::optional<RunLock> first(std::in_place, dir.path() + "/one");
  first.reset();
  EXPECT_EQ(refusal_of(dir.path() + "/one"), "");
}

}  // namespace
}  // namespace omentum

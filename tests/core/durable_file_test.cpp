#include "core/durable_file.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <thread>

#include "core/read_file.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

TEST(DurableFile, ReplacesAFileAndLeavesNothingBesideIt) {
  const test::TempDir folder;
  const std::string path = folder / "new/file";
  ASSERT_TRUE(write_durably(path, "old"));
  ASSERT_TRUE(write_durably(path, "new"));
  EXPECT_EQ(read_file(path).value(), "new");
  EXPECT_EQ(std::distance(fs::directory_iterator(folder / "new"), {}), 1);
}

TEST(DurableFile, KeepsTheOldContentWhereTheNewCannotBeWritten) {
  const test::TempDir folder;
  const std::string path = folder / "file";
  ASSERT_TRUE(write_durably(path, "old"));
  fs::create_directory(path + ".tmp");  // in the way
  EXPECT_FALSE(write_durably(path, "new"));
  EXPECT_EQ(read_file(path).value(), "old");
}

TEST(DurableFile, ADeviceOrPipeIsWrittenIntoAndStays) {
  const Result<void> full = write_durably("/dev/full", "text");
  EXPECT_FALSE(full);
  EXPECT_TRUE(fs::is_character_file("/dev/full"));
  const test::TempDir folder;
  const std::string pipe = folder / "pipe";
  ASSERT_EQ(mkfifo(pipe.c_str(), 0600), 0);
  std::string arrived;
  std::jthread reader([&] {
    std::ifstream file(pipe);
    file >> arrived;
  });
  EXPECT_TRUE(write_durably(pipe, "text"));
  reader.join();
  EXPECT_EQ(arrived, "text");
  EXPECT_TRUE(fs::is_fifo(pipe));
}

TEST(DurableFile, APipeThatNobodyReadsIsAFailureAndNoWait) {
  const test::TempDir folder;
  const std::string path = folder / "file";
  ASSERT_EQ(::mkfifo((path + ".tmp").c_str(), 0600), 0);
  EXPECT_FALSE(write_durably(path, "text"));
  ASSERT_EQ(::mkfifo((folder / "pipe").c_str(), 0600), 0);
  EXPECT_FALSE(write_durably(folder / "pipe", "text"));
  EXPECT_THROW(AppendFile(folder / "pipe"), Error);
}

}  // namespace
}  // namespace omentum

#include "core/regular_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>

#include "core/durable_file.h"
#include "core/read_file.h"
#include "core/table.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;

TEST(RegularFile, OneOrALinkToOneIsGood) {
  const test::TempDir folder;
  std::ofstream(folder / "file") << "a";
  fs::create_symlink("file", folder / "link");
  EXPECT_TRUE(require_regular_file(folder / "file"));
  EXPECT_TRUE(require_regular_file(folder / "link"));
}

TEST(RegularFile, WhatBlocksOrNeverEndsIsNamedBeforeItIsOpened) {
  const test::TempDir folder;
  const std::string pipe = folder / "pipe";
  ASSERT_EQ(::mkfifo(pipe.c_str(), 0600), 0);
  fs::create_symlink("pipe", folder / "link");
  EXPECT_THAT(require_regular_file(pipe).error(), HasSubstr("cannot be opened: a pipe"));
  EXPECT_THAT(require_regular_file(folder / "link").error(), HasSubstr("a pipe"));
  EXPECT_THAT(require_regular_file("/dev/zero").error(), HasSubstr("a device"));
  EXPECT_THAT(require_regular_file(folder.path()).error(), HasSubstr("a folder"));
  EXPECT_THAT(require_regular_file(folder / "none").error(), HasSubstr("No such file"));
  // Each of these once waited for a writer that never comes.
  EXPECT_THAT(read_file(pipe).error(), HasSubstr("a pipe"));
  EXPECT_THAT(read_whole(pipe).error(), HasSubstr("a pipe"));
  EXPECT_THROW(read_table(pipe), Error);
}

}  // namespace
}  // namespace omentum

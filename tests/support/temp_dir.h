#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <string>

namespace omentum::test {

/// A new folder for one test, removed with everything in it.
class TempDir {
 public:
  TempDir() {
    std::string path = testing::TempDir() + "omentum_XXXXXX";
    const char* made = mkdtemp(path.data());
    EXPECT_NE(made, nullptr) << path;
    path_ = path;
  }
  ~TempDir() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  TempDir(const TempDir&) = delete;
  TempDir& operator=(const TempDir&) = delete;

  const std::string& path() const { return path_; }
  std::string operator/(const std::string& name) const { return path_ + "/" + name; }

 private:
  std::string path_;
};

}  // namespace omentum::test

#pragma once

#include <cstdlib>
#include <filesystem>
#include <string>

#include "core/check.h"

namespace omentum {

/// A temporary folder that only this user can read, removed with the object. Throws Error.
class ScratchFolder {
 public:
  ScratchFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "omentum_XXXXXX").string();
    if (mkdtemp(name.data()) == nullptr) throw_error("{}: cannot be made", name);
    path_ = name;
  }
  ~ScratchFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  ScratchFolder(const ScratchFolder&) = delete;
  ScratchFolder& operator=(const ScratchFolder&) = delete;

  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace omentum

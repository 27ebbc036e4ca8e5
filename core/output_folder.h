#pragma once

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>

namespace omentum {

/// A file written from begin to end; what does not reach the disk is an Error that names it.
class OutputFile {
 public:
  /// Replaces a file of that name. All members throw Error.
  explicit OutputFile(const std::filesystem::path& path);
  void add(std::string_view text);
  /// Everything is on the disk. Nothing may be added afterwards.
  void close();

 private:
  void require(bool done) const;

  struct Close {
    void operator()(std::FILE* file) const { std::fclose(file); }
  };
  std::string path_;
  std::unique_ptr<std::FILE, Close> file_;
};

/// A folder that appears whole or not at all: files go to a new folder of a name of its own beside
/// it, NAME.unfinished-PID, which finish() renames and which else goes with the object.
class OutputFolder {
 public:
  /// Nothing is made yet. Throws Error where something of that name is there already, but for an
  /// empty folder.
  explicit OutputFolder(const std::string& name);
  ~OutputFolder();
  OutputFolder(const OutputFolder&) = delete;
  OutputFolder& operator=(const OutputFolder&) = delete;

  // All throw Error. Precondition of the last two: begin(). `file` is below path(); a folder of it
  // that is named there must have been made.
  void begin();
  void write(const std::string& file, std::string_view content) const;
  void finish();
  /// Where files go until finish().
  const std::filesystem::path& path() const { return unfinished_; }

 private:
  void refuse_unless(bool good, const std::string& what) const;

  std::string name_;  ///< as it was asked for
  std::filesystem::path wanted_, unfinished_;
};

}  // namespace omentum

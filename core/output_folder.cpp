#include "core/output_folder.h"

#include <unistd.h>

#include <cerrno>
#include <system_error>

#include "core/check.h"

namespace omentum {

namespace fs = std::filesystem;

OutputFile::OutputFile(const fs::path& path)
    : path_(path.string()), file_(std::fopen(path.c_str(), "wb")) {
  require(file_ != nullptr);
}

void OutputFile::require(bool done) const {
  if (!done)
    throw_error("{}: cannot be written: {}", path_, std::generic_category().message(errno));
}

void OutputFile::add(std::string_view text) {
  require(std::fwrite(text.data(), 1, text.size(), file_.get()) == text.size());
}

void OutputFile::close() {
  require(std::fflush(file_.get()) == 0);
  require(::fsync(fileno(file_.get())) == 0);
  require(std::fclose(file_.release()) == 0);
}

void OutputFolder::refuse_unless(bool good, const std::string& what) const {
  if (!good) throw_error("{}: {}", name_.empty() ? "\"\"" : name_, what);
}

OutputFolder::OutputFolder(const std::string& name) : name_(name) {
  std::error_code failed;
  wanted_ = fs::absolute(name_, failed).lexically_normal();
  if (wanted_.filename().empty()) wanted_ = wanted_.parent_path();  // "out/"
  refuse_unless(!name_.empty() && wanted_.has_filename(), "no name of a folder");
  const fs::file_status there = fs::symlink_status(wanted_, failed);
  if (!fs::exists(there)) return;
  refuse_unless(fs::is_directory(there), "exists and is no folder");
  refuse_unless(fs::is_empty(wanted_, failed) && !failed, "exists and is not empty");
}

void OutputFolder::begin() {
  std::error_code failed;
  fs::create_directories(wanted_.parent_path(), failed);
  refuse_unless(!failed, "cannot be made: " + failed.message());
  for (int attempt = 0; unfinished_.empty(); ++attempt) {
    const fs::path made = fmt::format("{}.unfinished-{}{}", wanted_.string(), ::getpid(),
                                      attempt == 0 ? "" : fmt::format("-{}", attempt));
    if (fs::create_directory(made, failed)) unfinished_ = made;
    refuse_unless(!failed && attempt < 100, "cannot be made: " + failed.message());
  }
}

OutputFolder::~OutputFolder() {
  std::error_code ignored;
  if (!unfinished_.empty()) fs::remove_all(unfinished_, ignored);
}

void OutputFolder::write(const std::string& file, std::string_view content) const {
  OutputFile out(unfinished_ / file);
  out.add(content);
  out.close();
}

void OutputFolder::finish() {
  // An empty folder of that name gives way to the whole one in one step.
  std::error_code failed;
  fs::rename(unfinished_, wanted_, failed);
  refuse_unless(!failed, "cannot be made: " + failed.message());
  unfinished_.clear();
}

}  // namespace omentum

#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

namespace omentum {

/// What a program must tell its operator of while it holds: in its log when it begins, in its
/// status until it ends. One thread at a time.
class Alarms {
 public:
  /// `name` identifies the alarm ("ring_full"); `text` says what is wrong and what to do.
  void set(const std::string& name, bool holds, const std::string& text);

  /// "name: text" of those that hold, at most 16, in order of their names.
  std::vector<std::string> texts() const;
  /// How often one began.
  std::uint64_t raised() const { return raised_; }

 private:
  std::map<std::string, std::string> holding_;  ///< text by name
  std::uint64_t raised_ = 0;
};

}  // namespace omentum

#pragma once

#include <google/protobuf/message.h>

#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "core/result.h"
#include "mismatch/recording/recording.h"

namespace omentum {

// Rows of a Series as messages of MCAP channels, and back (docs/formats.md 13). The topic "tool" is
// the channel "/tool".

/// An empty message of the type that a topic of Recording::series has; null for another topic.
std::unique_ptr<google::protobuf::Message> make_message(const std::string& topic);

/// Fills a message with a row; NaN stays unset where the message allows.
void encode_row(const Series& series, const std::string& topic, std::size_t row,
                google::protobuf::Message& message);

/// Collects messages of a topic to a series; what is absent is NaN. Messages may have different
/// parts.
class SeriesCollector {
 public:
  /// Markers are called `marker_names` as far as these go, then marker<k>.
  SeriesCollector(std::string topic, std::vector<std::string> marker_names);
  /// Fails where the bytes are no such message.
  Result<void> add(std::int64_t time_ns, std::string_view data);
  /// Sorted by time, normalised; of rows of one time the first stays. What was dropped is appended
  /// to `warnings`.
  Result<Series> finish(std::vector<std::string>& warnings);

 private:
  void set(const std::string& column, double value);
  void set_pose(const std::string& stem, const double* position, const double* wxyz);

  std::string topic_;
  std::vector<std::string> marker_names_;
  std::unique_ptr<google::protobuf::Message> message_;
  std::unordered_map<std::string, std::size_t> index_;
  std::vector<std::string> columns_;
  std::vector<std::int64_t> time_ns_;
  std::vector<std::vector<double>> rows_;  ///< as long as there were columns by then
};

/// Names of the markers of a series; empty where they are marker0, marker1, ...
std::vector<std::string> marker_names(const Series& markers);

}  // namespace omentum

#include "dvrk_gateway/recording/sensor_sources.h"

#include <fmt/core.h>

#include <array>
#include <chrono>
#include <filesystem>
#include <fstream>
#include <utility>

#include "core/check.h"
#include "core/clock.h"
#include "core/csv.h"
#include "core/log.h"
#include "dvrk_gateway/protocol/udp_socket.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

/// A line that could not be read: told once for a source, counted by the recording.
class BadLines {
 public:
  explicit BadLines(std::string source) : source_(std::move(source)) {}
  void add(SensorKind kind, const std::string& why, const SensorSource::Take& take) {
    if (count_++ == 0)
      log().warn("--source {}: {}; further lines that cannot be read are counted", source_, why);
    take(kind, nullptr);
  }

 private:
  std::string source_;
  std::uint64_t count_ = 0;
};

/// Calls fn(line) for each line that is not blank.
template <typename Fn>
void for_each_line(std::string_view text, Fn&& fn) {
  while (!text.empty()) {
    const std::string_view line = text.substr(0, text.find('\n'));
    text.remove_prefix(std::min(text.size(), line.size() + 1));
    if (line.find_first_not_of(" \t\r") != line.npos) fn(line);
  }
}

class UdpSource final : public SensorSource {
 public:
  explicit UdpSource(const SensorSourceOptions& options)
      : kind_(options.kind), bad_(options.text), socket_(options.port) {}

  void poll(const Take& take) override {
    constexpr int kMostDatagrams = 1000;  // a flood must not hold up the other sources
    for (int k = 0; k < kMostDatagrams; ++k) {
      const std::optional<Link::Received> received = socket_.receive(memory_);
      if (!received) return;
      for_each_line({memory_.data(), received->size}, [&](std::string_view line) {
        Result<SensorMessage> message = parse_sensor_json(kind_, line);
        if (message)
          take(kind_, std::move(message).value());
        else
          bad_.add(kind_, message.error(), take);
      });
    }
  }

 private:
  SensorKind kind_;
  BadLines bad_;
  UdpSocket socket_;
  std::array<char, 65536> memory_{};
};

/// Rows that are appended to a table while the session runs.
class FileSource final : public SensorSource {
 public:
  explicit FileSource(const SensorSourceOptions& options)
      : kind_(options.kind),
        path_(options.path),
        folder_(fs::path(options.path).parent_path().string()),
        text_(options.text),
        bad_(options.text) {
    std::error_code failed;
    if (fs::exists(path_, failed) && !fs::is_regular_file(path_, failed))
      throw_error("--source {}: is no file", text_);
    std::ifstream file(path_, std::ios::binary);
    if (!file) {
      log().warn("--source {}: is not there yet", text_);
      return;
    }
    // Rows that are there are older than the session.
    if (std::getline(file, header_) && file.eof()) header_.clear();  // it is still being written
    if (header_.empty()) return;
    read_ = fs::file_size(path_, failed);
    file.clear();
    file.seekg(static_cast<std::streamoff>(read_) - 1);
    within_line_ = file.get() != '\n';
  }

  void poll(const Take& take) override {
    constexpr std::uintmax_t kMostBytes = 1'000'000;  // at once: the other sources wait
    std::error_code absent;
    const std::uintmax_t size = fs::file_size(path_, absent);
    if (absent || size == read_) return;
    if (size < read_) {
      log().warn("--source {}: became shorter and is read from its beginning", text_);
      header_.clear();
      rest_.clear();
      within_line_ = false;
      read_ = 0;
    }
    std::ifstream file(path_, std::ios::binary);
    file.seekg(static_cast<std::streamoff>(read_));
    std::string text(static_cast<std::size_t>(std::min(size - read_, kMostBytes)), '\0');
    file.read(text.data(), static_cast<std::streamsize>(text.size()));
    text.resize(static_cast<std::size_t>(file.gcount()));
    read_ += text.size();
    rest_ += text;
    take_whole_lines(take);
  }

 private:
  void take_whole_lines(const Take& take) {
    constexpr std::size_t kLongestLine = 10'000'000;
    const std::size_t end = rest_.rfind('\n');
    if (end == rest_.npos) {
      if (rest_.size() > kLongestLine) bad_.add(kind_, "a line without an end", take);
      if (rest_.size() > kLongestLine) rest_.clear();
      return;
    }
    std::string lines = rest_.substr(0, end + 1);
    rest_.erase(0, end + 1);
    if (within_line_) lines.erase(0, lines.find('\n') + 1);
    within_line_ = false;
    if (header_.empty() && !lines.empty()) {
      header_ = lines.substr(0, lines.find('\n'));
      lines.erase(0, header_.size() + 1);
    }
    if (lines.empty() || take_rows(lines, take)) return;
    // One bad row is to cost no other.
    for_each_line(lines, [&](std::string_view line) {
      std::string why;
      if (!take_rows(std::string(line) + "\n", take, &why)) bad_.add(kind_, why, take);
    });
  }

  bool take_rows(const std::string& lines, const Take& take, std::string* why = nullptr) {
    const auto messages = parse_sensor_rows(kind_, path_, folder_, header_, lines);
    if (!messages && why != nullptr) *why = messages.error();
    if (!messages) return false;
    for (const SensorMessage& message : messages.value()) take(kind_, message);
    return true;
  }

  SensorKind kind_;
  std::string path_, folder_, text_;
  BadLines bad_;
  std::string header_;        ///< empty: not read yet
  std::string rest_;          ///< read, without an end of line yet
  std::uintmax_t read_ = 0;   ///< bytes of the file
  bool within_line_ = false;  ///< the next end of line is that of an old row
};

}  // namespace

SensorSourceOptions parse_sensor_source(const std::string& text) {
  const auto refuse = [&text](const char* why) {
    throw_error(
        "--source {}: {}; allowed NAME=udp:PORT and NAME=file:PATH, NAME force, markers, tracker, "
        "cloud, color or depth",
        text, why);
  };
  const std::size_t equals = text.find('=');
  if (equals == text.npos) refuse("no =");
  SensorSourceOptions options;
  options.text = text;
  const std::optional<SensorKind> kind = sensor_kind(std::string_view(text).substr(0, equals));
  if (!kind) refuse("an unknown name");
  options.kind = *kind;
  const std::string place = text.substr(equals + 1);
  if (place.starts_with("file:")) {
    options.path = place.substr(5);
    if (options.path.empty()) refuse("no path");
  } else if (place.starts_with("udp:")) {
    const double port = parse_number(place.substr(4)).value_or(0);
    if (!(port >= 1 && port <= 65535) || port != static_cast<std::uint16_t>(port))
      refuse("a port is 1 ... 65535");
    if (*kind == SensorKind::kColor || *kind == SensorKind::kDepth) refuse("images come by files");
    options.port = static_cast<std::uint16_t>(port);
  } else {
    refuse("neither udp nor file");
  }
  return options;
}

std::unique_ptr<SensorSource> open_sensor_source(const SensorSourceOptions& options) {
  if (options.port == 0) return std::make_unique<FileSource>(options);
  try {
    return std::make_unique<UdpSource>(options);
  } catch (const Error& error) {
    throw_error("--source {}: {}", options.text, error.what());
  }
}

SensorSources::SensorSources(const std::vector<std::string>& sources, RobotRecorder& recorder)
    : recorder_(recorder) {
  for (const std::string& text : sources)
    sources_.push_back(open_sensor_source(parse_sensor_source(text)));
  if (sources_.empty()) return;
  thread_ = std::thread([this] {
    while (!end_) {
      poll();
      std::this_thread::sleep_for(std::chrono::milliseconds(5));
    }
    poll();
  });
}

SensorSources::~SensorSources() { end(); }

void SensorSources::end() {
  end_ = true;
  if (thread_.joinable()) thread_.join();
}

void SensorSources::poll() {
  for (const std::unique_ptr<SensorSource>& source : sources_) {
    source->poll([this](SensorKind kind, SensorMessage message) {
      if (message == nullptr)
        recorder_.count_bad_source_line();
      else
        recorder_.add_sample(sensor_topic(kind), std::move(message), steady_now_ns());
    });
  }
}

}  // namespace omentum

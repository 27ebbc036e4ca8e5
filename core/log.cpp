#include "core/log.h"

#include <fmt/format.h>
#include <spdlog/logger.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/sinks/stdout_color_sinks.h>

#include <chrono>
#include <map>
#include <mutex>
#include <string>
#include <utility>

#include "core/printable.h"

namespace omentum {
namespace {

/// Standard error, with a limit on warnings and errors: of those that begin alike, kBurst are told
/// per minute and the others counted. What was kept back is told with the next one that is let
/// through, or at the end.
class LimitedSink : public spdlog::sinks::base_sink<std::mutex> {
 public:
  ~LimitedSink() override {
    for (auto& [beginning, told] : told_) tell_kept_back(beginning, told);
  }

 private:
  using Message = spdlog::details::log_msg;
  using Clock = std::chrono::system_clock;
  static constexpr int kBurst = 5;
  static constexpr std::chrono::seconds kPeriod{60};
  static constexpr std::size_t kMaxBeginnings = 256;  // no text of a stranger fills the memory

  struct Told {
    Clock::time_point since;
    int count = 0;
    std::uint64_t kept_back = 0;
    spdlog::level::level_enum level = spdlog::level::warn;
  };

  /// What two messages have in common that tell of one thing: all before the first value.
  static std::string beginning_of(std::string_view text) {
    const std::size_t event =
        text.starts_with("event=") ? text.find(' ') : text.find_first_of("0123456789/\"=");
    return std::string(text.substr(0, event));
  }

  void tell_kept_back(const std::string& beginning, Told& told) {
    if (told.kept_back == 0) return;
    const std::string text = fmt::format("{} ... {} more like it kept back", beginning,
                                         std::exchange(told.kept_back, 0));
    stderr_.log(Message("omentum", told.level, text));
  }

  void sink_it_(const Message& message) override {
    if (message.level < spdlog::level::warn) return stderr_.log(message);
    std::string beginning = beginning_of({message.payload.data(), message.payload.size()});
    if (told_.size() >= kMaxBeginnings && !told_.contains(beginning)) beginning = "others";
    Told& told = told_[beginning];
    if (message.time - told.since >= kPeriod) {
      tell_kept_back(beginning, told);
      told = {message.time, 0, 0, message.level};
    }
    if (++told.count > kBurst) {
      ++told.kept_back;
      return;
    }
    stderr_.log(message);
  }
  void flush_() override { stderr_.flush(); }
  void set_pattern_(const std::string& pattern) override { stderr_.set_pattern(pattern); }
  void set_formatter_(std::unique_ptr<spdlog::formatter> formatter) override {
    stderr_.set_formatter(std::move(formatter));
  }

  spdlog::sinks::stderr_color_sink_st stderr_;
  std::map<std::string, Told> told_;
};

spdlog::logger& logger() {
  static const std::shared_ptr<spdlog::logger> logger = [] {
    auto made = std::make_shared<spdlog::logger>("omentum", std::make_shared<LimitedSink>());
    made->set_pattern("%H:%M:%S.%e %^%l%$ %v");
    return made;
  }();
  return *logger;
}

}  // namespace

void Log::say(Level level, fmt::string_view text, fmt::format_args values) {
  using enum spdlog::level::level_enum;
  constexpr spdlog::level::level_enum kOfSpdlog[] = {debug, info, warn, err};
  const auto its = kOfSpdlog[static_cast<int>(level)];
  if (logger().should_log(its)) logger().log(its, printable(fmt::vformat(text, values)));
}

void name_log(std::string_view program) {
  logger().set_pattern("%H:%M:%S.%e " + std::string(program) + " %^%l%$ %v");
}

}  // namespace omentum

#include "mismatch/explain/verdict_file.h"

#include <fmt/format.h>
#include <fmt/ranges.h>
#include <google/protobuf/util/json_util.h>

#include <algorithm>
#include <array>
#include <filesystem>
#include <string_view>

#include "core/check.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

constexpr int kVersion = 1;
constexpr std::array<std::string_view, 3> kWithEffect = {"explained", "explained_as_class",
                                                         "partly_explained"};
constexpr std::array<std::string_view, 3> kWithout = {"no_mismatch_detectable", "unexplained",
                                                      "bad_recording"};

/// Why the message is no verdict that can be shown; empty: it is one.
std::string objection(const pb::Verdict& verdict) {
  if (!verdict.has_format_version()) return "no format_version: this is no verdict";
  if (verdict.format_version() != kVersion)
    return fmt::format("format_version: {}, allowed {}", verdict.format_version(), kVersion);
  const bool with = std::ranges::count(kWithEffect, verdict.status()) > 0;
  if (!with && std::ranges::count(kWithout, verdict.status()) == 0) {
    return fmt::format("status is none of {}, {}", fmt::join(kWithEffect, ", "),
                       fmt::join(kWithout, ", "));
  }
  const bool named = std::ranges::all_of(verdict.effects(), [](const pb::VerdictEffect& effect) {
    return effect.class_().members_size() > 0;
  });
  if (!named || (with && verdict.effects_size() == 0))
    return "an effect without a name: this is no verdict";
  return "";
}

}  // namespace

std::string print_verdict(const pb::Verdict& verdict) {
  google::protobuf::util::JsonPrintOptions options;
  options.add_whitespace = true;
  options.preserve_proto_field_names = true;
  std::string text;
  OMENTUM_CHECK(google::protobuf::util::MessageToJsonString(verdict, &text, options).ok());
  return text;
}

Result<pb::Verdict> parse_verdict(const std::string& path, const std::string& text) {
  google::protobuf::util::JsonParseOptions options;
  options.ignore_unknown_fields = true;  // of a later revision
  pb::Verdict verdict;
  const auto status = google::protobuf::util::JsonStringToMessage(text, &verdict, options);
  if (!status.ok()) {
    const std::string why(status.message());
    return Failure{fmt::format("{}: no JSON of a verdict, or cut off: {}", path,
                               why.substr(0, why.find('\n')))};
  }
  if (const std::string why = objection(verdict); !why.empty())
    return Failure{fmt::format("{}: {}", path, why)};
  return verdict;
}

pb::Verdict read_verdict(const std::string& folder) {
  namespace fs = std::filesystem;
  const std::string path =
      fs::is_directory(folder) ? (fs::path(folder) / "verdict.json").string() : folder;
  Result<pb::Verdict> verdict = parse_verdict(path, read_whole_file(path));
  if (!verdict) throw_error("{}", verdict.error());
  return std::move(verdict).value();
}

}  // namespace omentum

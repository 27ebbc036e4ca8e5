#include "learner/checkpoint.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <filesystem>
#include <map>
#include <sstream>
#include <string_view>
#include <system_error>
#include <utility>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/read_file.h"

namespace omentum {

namespace fs = std::filesystem;

namespace {

constexpr std::string_view kPrefix = "checkpoint-", kSuffix = ".pb";

std::optional<std::uint64_t> parse_number(std::string_view text) {
  std::uint64_t number = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
  if (error != std::errc() || end != text.data() + text.size() || text.empty()) return std::nullopt;
  return number;
}

/// "a.b.c" -> values of a text protobuf, in order of appearance for repeated fields.
std::map<std::string, std::vector<std::string>> flatten(const std::string& text) {
  std::map<std::string, std::vector<std::string>> values;
  std::vector<std::string> path;
  std::istringstream lines(text);
  for (std::string line; std::getline(lines, line);) {
    const std::size_t first = line.find_first_not_of(' ');
    if (first == std::string::npos || line[first] == '#') continue;
    line.erase(0, first);
    if (line == "}") {
      if (!path.empty()) path.pop_back();
    } else if (line.size() > 2 && line.ends_with('{')) {
      path.push_back(line.substr(0, line.find_first_of(" {")));
    } else if (const std::size_t colon = line.find(':'); colon != std::string::npos) {
      std::string name;
      for (const std::string& part : path) name += part + ".";
      std::string value = line.substr(colon + 1);
      value.erase(0, std::min(value.find_first_not_of(' '), value.size()));
      values[name + line.substr(0, colon)].push_back(value);
    }
  }
  return values;
}

}  // namespace

std::string config_difference(const std::string& old_text, const std::string& new_text) {
  const auto before = flatten(old_text);
  const auto after = flatten(new_text);
  std::map<std::string, std::pair<std::string, std::string>> lines;
  for (const auto& [path, values] : before)
    lines[path] = {fmt::format("{}", fmt::join(values, ", ")), "(absent)"};
  for (const auto& [path, values] : after) {
    const auto found = lines.try_emplace(path, "(absent)", "").first;
    found->second.second = fmt::format("{}", fmt::join(values, ", "));
  }
  std::string text;
  for (const auto& [path, values] : lines) {
    if (values.first == values.second || path.starts_with("run.")) continue;
    text +=
        fmt::format("{}{}: {} -> {}", text.empty() ? "" : "\n", path, values.first, values.second);
  }
  return text;
}

void to_disk(const SlotTable& table, std::uint32_t state_format, pb::Checkpoint& disk) {
  disk.set_batch(table.batch);
  for (std::size_t i = 0; i < table.slots.size(); ++i) {
    const SlotStart& from = table.slots[i];
    pb::SlotState& to = *disk.add_slot();
    to.set_slot(static_cast<std::uint32_t>(i));
    to.set_next_segment(from.segment);
    to.set_episode(from.episode);
    to.set_episode_step(from.episode_step);
    to.set_episode_limit(from.episode_limit);
    to.set_start_state(from.state.data(), from.state.size());
    to.set_start_hash(from.hash);
    to.set_reset(from.reset);
    to.set_state_format(state_format);
  }
  pb::LedgerTotals& ledger = *disk.mutable_ledger();
  for (const auto& [name, value] : kLedgerCounters) {
    if (const auto* field = ledger.GetDescriptor()->FindFieldByName(name))
      ledger.GetReflection()->SetUInt64(&ledger, field, table.ledger.*value);
  }
}

SlotTable slots_from_disk(const pb::Checkpoint& disk) {
  SlotTable table;
  table.batch = disk.batch();
  for (const pb::SlotState& from : disk.slot()) {
    SlotStart to;
    to.segment = from.next_segment();
    to.episode = from.episode();
    to.episode_step = from.episode_step();
    to.episode_limit = from.episode_limit();
    const auto* bytes = reinterpret_cast<const std::byte*>(from.start_state().data());  // NOLINT
    to.state.assign(bytes, bytes + from.start_state().size());
    to.hash = from.start_hash();
    to.reset = from.reset();
    table.slots.push_back(std::move(to));
  }
  const pb::LedgerTotals& ledger = disk.ledger();
  for (const auto& [name, value] : kLedgerCounters) {
    if (const auto* field = ledger.GetDescriptor()->FindFieldByName(name))
      table.ledger.*value = ledger.GetReflection()->GetUInt64(ledger, field);
  }
  return table;
}

CheckpointStore::CheckpointStore(std::string folder, std::vector<std::uint64_t> milestones)
    : folder_(std::move(folder)), milestones_(std::move(milestones)) {
  std::sort(milestones_.begin(), milestones_.end());
  std::error_code error;
  fs::create_directories(folder_, error);
  if (error) throw_error("cannot create folder {}: {}", folder_, error.message());
}

std::string CheckpointStore::path_of(std::uint64_t updates) const {
  return fmt::format("{}/{}{:08}{}", folder_, kPrefix, updates, kSuffix);
}

std::vector<std::uint64_t> CheckpointStore::present() const {
  std::vector<std::uint64_t> numbers;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder_, error)) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with(kPrefix) || !name.ends_with(kSuffix)) continue;
    const std::string_view middle = std::string_view(name).substr(
        kPrefix.size(), name.size() - kPrefix.size() - kSuffix.size());
    if (const std::optional<std::uint64_t> number = parse_number(middle))
      numbers.push_back(*number);
  }
  std::sort(numbers.begin(), numbers.end());
  return numbers;
}

Result<void> CheckpointStore::save(const pb::Checkpoint& checkpoint, const Save& what) {
  OMENTUM_CHECK(checkpoint.format_version() == kCheckpointFormat);
  const Bytes bytes = encode_checkpoint(checkpoint);
  const std::uint64_t updates = checkpoint.ppo().updates();
  // The numbered one last: what a run resumes from claims only what is there.
  if (what.best) {
    if (Result<void> result = write_durably(folder_ + "/best.pb", bytes); !result) return result;
  }
  if (what.milestone) {
    const std::string path = fmt::format("{}/milestone-{:010}.pb", folder_, *what.milestone);
    if (Result<void> result = write_durably(path, bytes); !result) return result;
  }
  if (Result<void> result = write_durably(path_of(updates), bytes); !result) return result;
  std::vector<std::uint64_t> numbers = present();
  for (std::size_t i = 0; i + 2 < numbers.size(); ++i) {
    std::error_code ignored;  // a file that cannot be removed only costs space
    fs::remove(path_of(numbers[i]), ignored);
  }
  return {};
}

Result<std::optional<LoadedCheckpoint>> CheckpointStore::load_newest() const {
  std::vector<std::string> names;  // the newest last
  for (const std::uint64_t number : present()) names.push_back(path_of(number));
  if (names.empty()) {
    // best.pb and milestones are whole checkpoints, and written before the numbered one.
    for (const std::string& name : others()) names.push_back(folder_ + "/" + name);
    std::ranges::stable_sort(names, {}, [](const std::string& path) {
      const Result<pb::Checkpoint> one = load_checkpoint(path);
      return one ? one.value().ppo().updates() : 0;
    });
  }
  LoadedCheckpoint loaded;
  while (!names.empty()) {
    loaded.path = names.back();
    names.pop_back();
    Result<pb::Checkpoint> checkpoint = load_checkpoint(loaded.path);
    if (checkpoint) {
      loaded.checkpoint = std::move(checkpoint).value();
      return std::optional<LoadedCheckpoint>(std::move(loaded));
    }
    loaded.warnings.push_back(checkpoint.error());
  }
  if (loaded.warnings.empty()) return std::optional<LoadedCheckpoint>();
  return Failure{fmt::format("no checkpoint of {} is readable: {}", folder_,
                             fmt::join(loaded.warnings, "; "))};
}

std::vector<std::string> CheckpointStore::others() const {
  std::vector<std::string> names;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder_, error)) {
    const std::string name = entry.path().filename().string();
    if (name == "best.pb" || name.starts_with("milestone-")) names.push_back(name);
  }
  std::sort(names.begin(), names.end());
  return names;
}

std::optional<std::uint64_t> CheckpointStore::crossed_milestone(std::uint64_t before,
                                                                std::uint64_t after) const {
  std::optional<std::uint64_t> crossed;
  for (const std::uint64_t milestone : milestones_) {
    if (before < milestone && milestone <= after) crossed = milestone;
  }
  return crossed;
}

Result<void> check_same_config(const pb::Checkpoint& checkpoint, std::uint64_t config_hash,
                               const std::string& config_text) {
  if (checkpoint.config_hash() == config_hash) return {};
  const std::string difference = config_difference(checkpoint.config_text(), config_text);
  return Failure{
      fmt::format("the checkpoint belongs to another configuration ({:016x}, now {:016x}):\n{}",
                  checkpoint.config_hash(), config_hash,
                  difference.empty() ? "(texts are equal: another version of the program wrote it)"
                                     : difference)};
}

Result<std::uint32_t> last_learner_epoch(const std::string& folder) {
  const std::string path = folder + "/learner_epoch";
  if (!fs::exists(path)) return std::uint32_t{0};
  const Result<std::string> read = read_file(path);
  if (!read) return Failure{read.error()};
  std::string_view text = read.value();
  if (text.ends_with('\n')) text.remove_suffix(1);
  const std::optional<std::uint64_t> number = parse_number(text);
  if (!number)
    return Failure{fmt::format("{} does not hold a number: remove the file to go on", path)};
  constexpr std::uint64_t kMost = 4'102'444'800;  // the year 2100; each start adds at least one
  if (*number > kMost) {
    return Failure{fmt::format("{} holds {}, allowed up to {}: remove the file to go on", path,
                               *number, kMost)};
  }
  return static_cast<std::uint32_t>(*number);
}

Result<std::uint32_t> next_learner_epoch(const std::string& folder, std::uint32_t unix_s) {
  const Result<std::uint32_t> last = last_learner_epoch(folder);
  if (!last) return last;
  const std::uint32_t epoch = std::max(last.value() + 1, unix_s);
  const std::string path = folder + "/learner_epoch";
  if (Result<void> result = write_durably(path, fmt::format("{}\n", epoch)); !result)
    return Failure{result.error()};
  return epoch;
}

}  // namespace omentum

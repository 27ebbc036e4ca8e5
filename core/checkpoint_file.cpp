#include "core/checkpoint_file.h"

#include <fmt/format.h>

#include <cstring>
#include <filesystem>
#include <limits>
#include <utility>

#include "core/config.h"
#include "core/durable_file.h"
#include "core/hash.h"
#include "core/policy.h"
#include "core/read_file.h"

namespace omentum {

namespace fs = std::filesystem;

namespace {

constexpr char kMagic[9] = "OMCKPT01";  // reaches disk: do not change
constexpr std::size_t kHeader = 16;
constexpr std::size_t kTrailer = 4;

template <typename T>
T read_number(std::span<const std::byte> bytes, std::size_t offset) {
  T value{};
  std::memcpy(&value, bytes.data() + offset, sizeof value);
  return value;
}

/// The checkpoint that speaks for a run, or nothing.
std::string checkpoint_of_run(const std::string& run_folder) {
  const std::string folder = run_folder + "/checkpoints";
  if (fs::exists(folder + "/best.pb")) return folder + "/best.pb";
  std::string newest;
  std::error_code error;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder, error)) {
    const std::string name = entry.path().filename().string();
    // Numbers of one width: the order of names is that of updates.
    if (name.starts_with("checkpoint-") && name.ends_with(".pb"))
      newest = std::max(newest, entry.path().string());
  }
  return newest;
}

}  // namespace

Bytes encode_checkpoint(const pb::Checkpoint& checkpoint) {
  const std::string payload = checkpoint.SerializeAsString();
  const std::uint64_t size = payload.size();
  Bytes bytes(kHeader + payload.size() + kTrailer);
  std::memcpy(bytes.data(), kMagic, 8);
  std::memcpy(bytes.data() + 8, &size, 8);
  std::memcpy(bytes.data() + kHeader, payload.data(), payload.size());
  const std::uint32_t crc = crc32c(std::span(bytes).first(kHeader + payload.size()));
  std::memcpy(bytes.data() + kHeader + payload.size(), &crc, kTrailer);
  return bytes;
}

Result<pb::Checkpoint> decode_checkpoint(std::span<const std::byte> bytes) {
  if (bytes.size() < kHeader + kTrailer) return Failure{fmt::format("only {} bytes", bytes.size())};
  if (std::memcmp(bytes.data(), kMagic, 8) != 0)
    return Failure{"not a checkpoint: no OMCKPT01 at the start"};
  const auto size = read_number<std::uint64_t>(bytes, 8);
  if (size != bytes.size() - kHeader - kTrailer) {
    return Failure{fmt::format("truncated: {} bytes of payload instead of {}",
                               bytes.size() - kHeader - kTrailer, size)};
  }
  const auto stored = read_number<std::uint32_t>(bytes, bytes.size() - kTrailer);
  const std::uint32_t computed = crc32c(bytes.first(bytes.size() - kTrailer));
  if (stored != computed)
    return Failure{fmt::format("CRC {:08x} instead of {:08x}", computed, stored)};
  if (size > static_cast<std::uint64_t>(std::numeric_limits<int>::max()))
    return Failure{"larger than 2 GiB"};
  pb::Checkpoint checkpoint;
  if (!checkpoint.ParseFromArray(bytes.data() + kHeader, static_cast<int>(size))) {
    return Failure{"payload is not a checkpoint message"};
  }
  if (checkpoint.format_version() != kCheckpointFormat) {
    return Failure{fmt::format("format version {} instead of {}", checkpoint.format_version(),
                               kCheckpointFormat)};
  }
  return checkpoint;
}

void to_disk(const PolicyWeights& weights, pb::Weights& disk) {
  disk.Clear();
  disk.set_policy_id(weights.policy_id);
  disk.set_policy_version(weights.policy_version);
  disk.set_layout_hash(weights.layout_hash);
  disk.set_config_hash(weights.config_hash);
  disk.set_weights_hash(weights.weights_hash.data(), weights.weights_hash.size());
  disk.mutable_parameters()->Assign(weights.parameters.begin(), weights.parameters.end());
  disk.mutable_obs_mean()->Assign(weights.obs_mean.begin(), weights.obs_mean.end());
  disk.mutable_obs_inv_std()->Assign(weights.obs_inv_std.begin(), weights.obs_inv_std.end());
}

Result<PolicyWeights> from_disk(const pb::Weights& disk) {
  PolicyWeights weights;
  weights.policy_id = disk.policy_id();
  weights.policy_version = disk.policy_version();
  weights.layout_hash = disk.layout_hash();
  weights.config_hash = disk.config_hash();
  weights.parameters.assign(disk.parameters().begin(), disk.parameters().end());
  weights.obs_mean.assign(disk.obs_mean().begin(), disk.obs_mean().end());
  weights.obs_inv_std.assign(disk.obs_inv_std().begin(), disk.obs_inv_std().end());
  weights.weights_hash = hash_weights(weights.parameters, weights.obs_mean, weights.obs_inv_std);
  const std::string& stored = disk.weights_hash();
  if (stored.size() != weights.weights_hash.size() ||
      std::memcmp(stored.data(), weights.weights_hash.data(), stored.size()) != 0) {
    return Failure{fmt::format("weights of version {} do not have the hash they were saved with",
                               disk.policy_version())};
  }
  return weights;
}

Result<pb::Checkpoint> load_checkpoint(const std::string& path) {
  const Result<Bytes> bytes = read_whole(path);
  if (!bytes) return Failure{bytes.error()};
  Result<pb::Checkpoint> checkpoint = decode_checkpoint(bytes.value());
  if (!checkpoint) return Failure{fmt::format("{}: {}", path, checkpoint.error())};
  return checkpoint;
}

Result<SavedPolicy> load_policy(const std::string& path) {
  SavedPolicy saved;
  saved.path = fs::is_directory(path) ? checkpoint_of_run(path) : path;
  if (saved.path.empty()) return Failure{fmt::format("{}: no checkpoint in this folder", path)};
  const Result<pb::Checkpoint> checkpoint = load_checkpoint(saved.path);
  if (!checkpoint) return Failure{checkpoint.error()};
  Result<PolicyWeights> weights = from_disk(checkpoint.value().ppo().weights());
  if (!weights) return Failure{fmt::format("{}: {}", saved.path, weights.error())};
  saved.weights = std::move(weights).value();
  try {
    saved.config = parse_config(saved.path, checkpoint.value().config_text());
  } catch (const Error& error) {
    return Failure{error.what()};
  }
  return saved;
}

}  // namespace omentum

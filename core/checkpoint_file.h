#pragma once

#include <span>
#include <string>

#include "core/result.h"
#include "core/types.h"
#include "proto/checkpoint.pb.h"
#include "proto/config.pb.h"

/// Checkpoints as files, for the learner that writes them and for whoever runs their policy.
namespace omentum {

/// Format of pb::Checkpoint; other versions are refused.
inline constexpr std::uint32_t kCheckpointFormat = 1;

/// File = "OMCKPT01", u64 payload size, payload (pb::Checkpoint), u32 CRC-32C of everything before
/// it; little-endian.
Bytes encode_checkpoint(const pb::Checkpoint& checkpoint);
/// Total over arbitrary bytes: any truncation or flipped bit is a failure with a reason.
Result<pb::Checkpoint> decode_checkpoint(std::span<const std::byte> bytes);

/// weights <-> disk. `learner_epoch` and times are of a session and do not travel.
void to_disk(const PolicyWeights& weights, pb::Weights& disk);
/// Recomputes the hash and fails when it differs from the stored one.
Result<PolicyWeights> from_disk(const pb::Weights& disk);
/// One checkpoint file.
Result<pb::Checkpoint> load_checkpoint(const std::string& path);

/// A policy with the configuration it was trained in.
struct SavedPolicy {
  pb::Config config;
  PolicyWeights weights;
  std::string path;  ///< of the checkpoint
};

/// Of a checkpoint file, or of the folder of a run: its best.pb, else its newest checkpoint.
Result<SavedPolicy> load_policy(const std::string& path);

}  // namespace omentum

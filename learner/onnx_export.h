#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/policy.h"
#include "core/result.h"
#include "core/task.h"
#include "proto/config.pb.h"

namespace omentum {

/// What the file holds besides the network.
struct OnnxMetadata {
  std::vector<ObservedEntry> observation;  ///< of all inputs, in order
  std::vector<std::string> action_names;
  std::vector<std::string> action_meanings;  ///< what each index of the action does
  std::string git_revision;
};

/// Observations and actions of the task, by its own list (core/task.h).
OnnxMetadata onnx_metadata(const pb::Task& task, const std::string& git_revision);

/// The policy as an ONNX model, opset 13, serialised.
///
///   input   observation [N, O] float, raw
///   outputs logits [N, L] float (means with the Gaussian head), value [N, 1] float,
///           action: discrete [N, columns] int64, arg max per branch (unused branches 0); Gaussian
///           [N, 4] float, the mean
///   metadata observation_names (a picture is one entry, ObservedEntry), observation_units,
///           action_names, action_meanings (what index 0, 1, 2 of a branch does), branches:
///           comma-separated lists;
///           policy_version, weights_hash, config_hash, layout_hash, git_revision
///   nodes   Sub, Mul, Clip (normaliser, of the numbers alone); with convolutions Split, Reshape,
///           Transpose, of object ids Mul, Sub, Abs, Less, Cast (a plane per id), per network Conv
///           and activation, twice, Transpose, Reshape, Mul, Concat; per network Gemm, Tanh or
///           Sigmoid + Mul, twice, Gemm; Split, ArgMax, Concat
///
/// Sums run in another order than core/policy.h, so values agree to f32 rounding, not to the bit.
/// Aborts where parameters or observed entries are not as many as the shape has.
std::string onnx_model(const PolicyShape& shape, const PolicyWeights& weights,
                       const OnnxMetadata& metadata);

/// Durable write of onnx_model().
Result<void> export_onnx(const std::string& path, const PolicyShape& shape,
                         const PolicyWeights& weights, const OnnxMetadata& metadata);

}  // namespace omentum

#pragma once

#include <cstddef>
#include <cstdint>

#include "proto/config.pb.h"

namespace omentum {

/// Most parameters of a policy on the wire, as in idl/omentum.idl (core/wire.cpp compares); those
/// of segments and states are in core/segment_fields.h.
inline constexpr std::size_t kMaxParameters = std::size_t{1} << 22;

/// What bus and policy can take of a configuration, beyond the range of each knob. Throws Error:
/// one line with knob, value and what is allowed. The learner asks before a run and in --dry-run,
/// a worker in --check-config and before it works.
void check_limits(const pb::Config& config);

/// The same for what only the scene tells. `state_bytes`: of one environment; `frame_numbers`: of
/// one recorded frame of the tissue, above 0. Throws Error likewise.
void check_scene_limits(const pb::Config& config, std::size_t state_bytes,
                        std::size_t frame_numbers);

/// Most decisions of one evaluation, hold included: from a start of the grids by the policy, or of
/// the grasp lattice by the hold script.
std::uint32_t evaluation_steps(const pb::Config& config, bool lattice);
/// Those of the hold at p_T.
std::uint32_t hold_steps(const pb::Task& task);

}  // namespace omentum

#include "mismatch/ros/frame_tree.h"

#include <fmt/format.h>

#include <set>

#include "core/table.h"

namespace omentum {
namespace {

constexpr double kSame = 1e-6;  // [m] and of the parts of a rotation matrix

}  // namespace

std::string frame_name(std::string_view frame) {
  if (frame.starts_with('/')) frame.remove_prefix(1);
  return std::string(frame);
}

void FrameTree::set_world(const std::string& frame) { world_ = frame_name(frame); }

void FrameTree::state(const std::string& frame, const Eigen::Isometry3d& X_WF) {
  stated_[frame_name(frame)] = X_WF;
}

void FrameTree::add(const std::string& parent, const std::string& child,
                    const Eigen::Isometry3d& X_PC) {
  const auto [found, added] =
      edges_.try_emplace(frame_name(child), Edge{frame_name(parent), X_PC, false});
  Edge& edge = found->second;
  if (added) return;
  const bool same = edge.parent == frame_name(parent) &&
                    (edge.X_PC.matrix() - X_PC.matrix()).cwiseAbs().maxCoeff() < kSame;
  edge.moves = edge.moves || !same;
}

bool FrameTree::is_world(const std::string& frame) const {
  const std::string name = frame_name(frame);
  return name == "W" || (!world_.empty() && name == world_);
}

Result<Eigen::Isometry3d> FrameTree::to_world(const std::string& frame) const {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  std::set<std::string> passed;
  for (std::string at = frame_name(frame); passed.insert(at).second;) {
    if (const auto known = stated_.find(at); known != stated_.end())
      return Eigen::Isometry3d(known->second * X);
    if (is_world(at)) return X;
    const auto edge = edges_.find(at);
    if (edge == edges_.end()) break;
    if (edge->second.moves)
      return Failure{fmt::format("frame \"{}\": its transform from {} to {} moves", shown(frame),
                                 shown(edge->second.parent), shown(at))};
    X = edge->second.X_PC * X;
    at = edge->second.parent;
  }
  return Failure{fmt::format("frame \"{}\": no transform to W", shown(frame))};
}

std::string FrameTree::root(const std::string& frame) const {
  std::string at = frame_name(frame);
  std::set<std::string> passed;
  while (passed.insert(at).second) {
    const auto edge = edges_.find(at);
    if (edge == edges_.end() || edge->second.moves) break;
    at = edge->second.parent;
  }
  return at;
}

Result<Eigen::Isometry3d> FrameTree::pose_in(const std::string& ancestor,
                                             const std::string& frame) const {
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
  std::set<std::string> passed;
  for (std::string at = frame_name(frame); passed.insert(at).second;) {
    if (at == ancestor) return X;
    const auto edge = edges_.find(at);
    if (edge == edges_.end() || edge->second.moves) break;
    X = edge->second.X_PC * X;
    at = edge->second.parent;
  }
  return Failure{fmt::format("frame {}: no transform to {}", shown(frame), shown(ancestor))};
}

}  // namespace omentum

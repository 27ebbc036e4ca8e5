#include "mismatch/seen/cloud_mask.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "core/check.h"
#include "core/config.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/scene/believed_scene.h"
#include "mismatch/simulate/tool_track.h"

namespace omentum {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

constexpr double kUsualNoise = 1e-3;               // [m] where the scene states none
constexpr double kSure = 3;                        // standard deviations
constexpr double kJawRadius = 0.004;               // [m] of what is cut out around the jaws
constexpr double kShaftMargin = 0.002;             // [m] by which the shaft may begin lower
constexpr double kBeside = 0.03, kMostFar = 0.15;  // [m] beyond the travel; at most
constexpr double kCell = 0.005;                    // [m]

Vector3d vector_of(const pb::Vec3& v) { return {v.x(), v.y(), v.z()}; }

}  // namespace

bool lies_free(const Scene& scene) { return std::ranges::count(scene.tissue.fixed, 1) == 0; }

std::string print_parts(std::size_t frames, const CloudParts& parts) {
  const auto share = [&](CloudPart part) {
    const auto count = static_cast<double>(parts.count[static_cast<std::size_t>(part)]);
    return 100 * count / std::max(1.0, static_cast<double>(parts.all()));
  };
  return fmt::format(
      "{} frames, {} points: tissue {:.1f} %, tool {:.1f} %, board {:.1f} %, background {:.1f} %",
      frames, parts.all(), share(CloudPart::kTissue), share(CloudPart::kTool),
      share(CloudPart::kBoard), share(CloudPart::kBackground));
}

CloudMask::CloudMask(const Scene& scene, double travel, double registration)
    : X_BW_(scene.tissue.X_WB.inverse()),
      noise_(scene.config.depth_sensor().noise_m() > 0 ? scene.config.depth_sensor().noise_m()
                                                       : kUsualNoise),
      height_noise_(std::hypot(noise_, registration)),
      thickness_(scene.tissue.thickness),
      farthest_(lies_free(scene) ? travel + kBeside : std::min(travel + kBeside, kMostFar)),
      shaft_radius_(scene.config.tool().shaft_radius_m() + kSure * noise_),
      shaft_start_(scene.config.tool().shaft_start_m() - kShaftMargin) {
  const pb::Tool& tool = scene.config.tool();
  if (tool.has_shaft_direction()) up_the_shaft_ = -vector_of(tool.shaft_direction()).normalized();
  for (const Vector3d& p : scene.tissue.particles) {
    rest_B_.extend(p);
    rest_W_.extend(scene.tissue.X_WB * p);
  }
  for (const RigidShape& body : scene.bodies) {
    if (body.role == pb::ROLE_BOARD && body.kind == RigidShape::Kind::kHalfSpace)
      boards_.emplace_back(body.X_WS.linear().col(2), body.X_WS.translation());
  }
  const Vector2d size = rest_B_.sizes().head<2>();
  cells_ = (size / kCell).array().ceil().cwiseMax(1).cast<int>();
  in_body_.assign(static_cast<std::size_t>(cells_.prod()), 0);
  // A grid of particles may be coarser than the cells: those of its triangles' corners and middles.
  const auto mark = [&](const Vector3d& p_B) {
    if (const auto cell = cell_of(scene.tissue.X_WB * p_B)) in_body_[*cell] = 1;
  };
  for (const Vector3d& p : scene.tissue.particles) mark(p);
  if (!scene.tissue.surface_is_particles) return;
  for (const Eigen::Vector3i& t : scene.tissue.surface_triangles) {
    constexpr int kParts = 4;
    for (int a = 0; a <= kParts; ++a) {
      for (int b = 0; a + b <= kParts; ++b) {
        const int c = kParts - a - b;
        const auto corner = [&](int k) {
          return scene.tissue.particles[static_cast<std::size_t>(t[k])];
        };
        mark((a * corner(0) + b * corner(1) + c * corner(2)) / kParts);
      }
    }
  }
}

bool CloudMask::on_tool(const Vector3d& p_W, const Vector3d& tip) const {
  const Vector3d d = p_W - tip;
  const double along = d.dot(up_the_shaft_);
  const double beside = (d - along * up_the_shaft_).norm();
  if (along > shaft_start_) return beside < shaft_radius_;
  return along > 0.5 * thickness_ + kSure * noise_ && beside < kJawRadius;
}

bool CloudMask::on_board(const Vector3d& p_W) const {
  const Vector3d p_B = X_BW_ * p_W;
  const bool over_rest = (p_B.head<2>().array() >= rest_B_.min().head<2>().array() - kCell).all() &&
                         (p_B.head<2>().array() <= rest_B_.max().head<2>().array() + kCell).all();
  const double most = over_rest ? thickness_ - kSure * height_noise_ : 0.5 * thickness_;
  return std::any_of(boards_.begin(), boards_.end(),
                     [&](const auto& board) { return board.signedDistance(p_W) < most; });
}

CloudPart CloudMask::part_of(const Vector3d& p_W, const Vector3d& tip) const {
  if (on_tool(p_W, tip)) return CloudPart::kTool;
  if (!(rest_W_.exteriorDistance(p_W) < farthest_)) return CloudPart::kBackground;
  return on_board(p_W) ? CloudPart::kBoard : CloudPart::kTissue;
}

std::optional<std::size_t> CloudMask::cell_of(const Vector3d& p_W) const {
  const Vector2d at = (X_BW_ * p_W - rest_B_.min()).head<2>();
  const Vector2d size = rest_B_.sizes().head<2>();
  constexpr double kOutside = 1e-9;
  if (!(at.minCoeff() >= -kOutside) || !((size - at).minCoeff() >= -kOutside)) return std::nullopt;
  const Eigen::Vector2i cell =
      at.cwiseQuotient(size.cwiseMax(1e-12)).cwiseProduct(cells_.cast<double>()).cast<int>();
  const Eigen::Vector2i inside = cell.cwiseMax(0).cwiseMin(cells_ - Eigen::Vector2i::Ones());
  return static_cast<std::size_t>(inside.y() * cells_.x() + inside.x());
}

double CloudMask::share_seen(std::span<const Vector3d> tissue) const {
  std::vector<std::uint8_t> seen(in_body_.size(), 0);
  for (const Vector3d& p : tissue) {
    if (const auto cell = cell_of(p)) seen[*cell] = in_body_[*cell];
  }
  const auto count = [](const std::vector<std::uint8_t>& cells) {
    return static_cast<double>(std::count(cells.begin(), cells.end(), 1));
  };
  return count(seen) / std::max(1.0, count(in_body_));
}

SeenFigures look_at_clouds(const Recording& recording, const std::string& path, const Scene& scene,
                           std::size_t most_frames) {
  SeenFigures figures;
  const Frames<Cloud> clouds = seen_clouds(recording);
  std::vector<std::string> ignored;
  std::optional<ToolTrack> track;
  double travel = kMostFar;
  if (recording.find("tool") != nullptr || recording.find("tool_commanded") != nullptr) {
    track = tool_track_of(recording, path, scene_tool_mount(scene), ignored);
    travel = track->travel();
  }
  const CloudMask mask(scene, travel, recording.info.registration_uncertainty_m());
  figures.frames = std::min(clouds.size(), most_frames);
  for (std::size_t k = 0; k < figures.frames; ++k) {
    const std::size_t at = figures.frames > 1 ? k * (clouds.size() - 1) / (figures.frames - 1) : 0;
    const double t = 1e-9 * static_cast<double>(clouds.time_ns[at]);
    const Vector3d far = Vector3d::Constant(1e6);
    const Vector3d tip = track ? track->tip_at(t) : far;
    std::vector<Vector3d> tissue;
    for (const Eigen::Vector3f& point : clouds.fetch(at)) {
      const Vector3d p = point.cast<double>();
      const CloudPart part = mask.part_of(p, tip);
      ++figures.parts.count[static_cast<std::size_t>(part)];
      if (part == CloudPart::kTissue) tissue.push_back(p);
    }
    figures.share_seen.push_back(mask.share_seen(tissue));
  }
  return figures;
}

std::string print_seen(const SeenFigures& figures) {
  if (figures.frames == 0) return "";
  double sum = 0;
  for (const double share : figures.share_seen) sum += share;
  const auto [least, most] =
      std::minmax_element(figures.share_seen.begin(), figures.share_seen.end());
  return fmt::format(
      "  clouds against the believed scene: {}\n"
      "  of the body at rest {:.0f} % seen in the first frame, {:.0f} % in the mean, {:.0f} ... "
      "{:.0f} %\n",
      print_parts(figures.frames, figures.parts), 100 * figures.share_seen.front(),
      100 * sum / static_cast<double>(figures.frames), 100 * *least, 100 * *most);
}

std::optional<Scene> stated_scene(const Recording& recording, std::vector<std::string>& warnings) {
  pb::Scene scene;
  if (recording.info.has_scene_text()) {
    parse_text_proto("scene of the recording", recording.info.scene_text(), scene);
  } else if (recording.info.has_scene_believed_text()) {
    const Result<BelievedScene> believed =
        parse_believed_scene("scene_believed.txt", recording.info.scene_believed_text());
    if (!believed) throw_error("{}", believed.error());
    const SetUp kind = believed.value().kind;
    if (kind != SetUp::kSheet && kind != SetUp::kSolid) return std::nullopt;
    scene = believed.value().scene;
  } else {
    return std::nullopt;
  }
  Scene made = make_scene(override_scene(scene, {}), "");
  warnings.insert(warnings.end(), made.warnings.begin(), made.warnings.end());
  if (made.tissue.particles.empty()) return std::nullopt;
  return made;
}

}  // namespace omentum

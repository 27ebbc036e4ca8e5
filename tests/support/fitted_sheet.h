#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <memory>
#include <random>
#include <vector>

#include "core/config.h"
#include "mismatch/fit/search.h"

namespace omentum::test {

/// A sheet in the scene omentum, bent, and clouds of it that are `turned` about the camera [rad].
struct FittedSheet {
  static constexpr std::size_t kFrames = 2;
  pb::Scene scene = load_scene(deploy_dir() + "/scenes/omentum.txtpb", {});
  FitSetup setup;
  std::unique_ptr<FitData> data;
  Linearisation linear;
  Which which = {0};

  explicit FittedSheet(const Eigen::Vector3d& turned = Eigen::Vector3d::Zero(),
                       std::uint32_t places = 31) {
    pb::GridMaker& grid = *scene.mutable_tissue()->mutable_grid();
    grid.set_pitch_m(grid.pitch_m() * (grid.count_x() - 1) / (places - 1));
    grid.set_count_x(places);
    grid.set_count_y(places);
    for (const auto& [path, sd] : {std::pair{"scene.depth_sensor.registration_m", 0.002},
                                   {"scene.depth_sensor.registration_deg", 0.7}}) {
      pb::Prior& prior = *setup.priors.add_prior();
      prior.set_path(path);
      prior.set_sd(sd);
    }
    const Scene made = make_scene(scene, setup.folder);
    Observation seen;
    seen.name = "a";
    seen.p_WC = made.tissue.X_WB * Eigen::Vector3d(0.03, 0.26, 0.32);
    const Eigen::Vector3d axis = (made.tissue.X_WB.translation() - seen.p_WC).normalized();
    seen.R_WC.col(2) = -axis;
    seen.R_WC.col(0) = axis.cross(Eigen::Vector3d::UnitZ()).normalized();
    seen.R_WC.col(1) = seen.R_WC.col(2).cross(seen.R_WC.col(0));
    seen.track.time = {0, 1};
    seen.track.p_WT.assign(2, seen.p_WC);
    PredictedFrame frame;
    frame.valid = true;
    for (const double side : {0.5, -0.5}) {
      for (const Eigen::Vector3d& p : made.tissue.particles) {
        const double bulge = 6 * p.x() * p.y() + 4 * p.x() * p.x();
        frame.vertices.push_back(made.tissue.X_WB *
                                 (p + Eigen::Vector3d(0, 0, bulge + side * made.tissue.thickness)));
      }
    }
    frame.velocity.assign(frame.vertices.size(), Eigen::Vector3d::Zero());
    frame.tip = seen.p_WC;
    const Registration6 registration{Eigen::Vector3d::Zero(), turned};
    SeenFrame cloud;
    std::mt19937 random(1);
    const std::size_t half = frame.vertices.size() / 2;
    for (std::size_t i = 0; i < half; ++i) {
      // Along the ray, some way to and fro; not the same way all along an edge.
      const Eigen::Vector3d d = frame.vertices[i] - seen.p_WC;
      const double share = static_cast<double>(random()) / 0x1p32;
      const Eigen::Vector3d p = d * (1 + 4e-3 * (share - 0.5));
      cloud.points.push_back(seen.p_WC + registration.rotation() * p);
    }
    for (std::size_t k = 0; k < kFrames; ++k) {
      cloud.t = 0.2 * static_cast<double>(k);
      seen.frames.push_back(cloud);
    }
    data = std::make_unique<FitData>(make_fit_data(scene, {seen}, setup));
    frame.columns.setZero(3 * static_cast<Eigen::Index>(frame.vertices.size()) + 3,
                          data->layout.unknowns.count + kOwnColumns);
    linear.predictions.emplace_back().frames.assign(kFrames, frame);
    linear.at = believed_state(*data);
  }
  std::vector<PredictedFrame>& frames() { return linear.predictions[0].frames; }
  SearchState begin() const { return {linear.at, first_scales(*data)}; }
  SearchState improved() const { return improve(*data, linear, which, 12, {}, begin()); }
  double cost_at(const FitState& state, const Scales& scales) const {
    return cost_of(*data, linear, which, state, scales);
  }
};

}  // namespace omentum::test

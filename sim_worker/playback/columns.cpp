#include "sim_worker/playback/columns.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "core/check.h"

namespace omentum {

using Eigen::Vector3d;
using Kind = Parameter::Kind;

namespace {

Vector3d true_tip(const ArmState& state) { return Eigen::Map<const Vector3d>(state.p_WT_true); }

}  // namespace

ColumnCarrier::ColumnCarrier(std::vector<PreparedParameter> parameters, const Scene& scene,
                             std::shared_ptr<const ReferenceTissueModel> model, const Arm& base)
    : parameters_(std::move(parameters)),
      model_(std::move(model)),
      base_(base),
      camera_(scene.camera.position),
      arms_(parameters_.size()),
      ended_(parameters_.size(), 0) {}

void ColumnCarrier::begin(ReferenceTissue& tissue, const Vector3d& tip) {
  std::vector<ColumnParameter> columns;
  for (const PreparedParameter& p : parameters_) columns.push_back(p.tissue);
  tissue.carry_columns(columns);
  base_.reset(base_arm_, tip);
  for (std::size_t k = 0; k < arms_.size(); ++k) {
    if (parameters_[k].arm) parameters_[k].arm->reset(arms_[k], tip);
  }
  tip_ = tip_columns();
}

/// Derivatives of the true tip.
Eigen::Matrix3Xd ColumnCarrier::tip_columns() {
  Eigen::Matrix3Xd tip = Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(parameters_.size()));
  for (std::size_t k = 0; k < parameters_.size(); ++k) {
    const PreparedParameter& p = parameters_[k];
    const auto column = static_cast<Eigen::Index>(k);
    if (p.parameter.kind == Kind::kToolOffset) tip.col(column) = Vector3d::Unit(p.parameter.axis);
    if (p.arm) tip.col(column) = (true_tip(arms_[k]) - true_tip(base_arm_)) / p.parameter.step;
  }
  return tip;
}

void ColumnCarrier::begin_step(ReferenceTissue& tissue, const Vector3d& tip) {
  const Vector3d load = tissue.held_force(0);
  base_.step(base_arm_, tip, load);
  for (std::size_t k = 0; k < arms_.size(); ++k) {
    if (parameters_[k].arm) parameters_[k].arm->step(arms_[k], tip, load);
  }
  const Eigen::Matrix3Xd to = tip_columns();
  tissue.set_tip_columns(tip_, to);
  tip_ = to;
}

void ColumnCarrier::hold_at_start(ReferenceTissue& tissue) const {
  Eigen::Matrix3Xd place = Eigen::Matrix3Xd::Zero(3, static_cast<Eigen::Index>(parameters_.size()));
  for (std::size_t k = 0; k < parameters_.size(); ++k) {
    const Parameter& p = parameters_[k].parameter;
    if (p.kind == Kind::kHeldPlace)
      place.col(static_cast<Eigen::Index>(k)) = Vector3d::Unit(p.axis);
  }
  tissue.set_tip_columns(place, place);
}

void ColumnCarrier::add_state(std::size_t step, double t, const ReferenceTissue& tissue) {
  if (!wants(step)) return;
  const ReferenceColumns& columns = *tissue.columns();
  if (!columns.valid && failure_.empty())
    failure_ = fmt::format("no columns from {:.6g} s on: {}", t, columns.reason);
  if (columns.valid) take(step, t, tissue);
}

std::vector<std::vector<float>> ColumnCarrier::columns_at(
    std::vector<BodyPoint> ReferenceTissueModel::*face, const ReferenceTissue& tissue) const {
  std::vector<std::vector<float>> values(parameters_.size());
  for (std::size_t i = 0; i < (*model_.*face).size(); ++i) {
    const BodyPoint& point = (*model_.*face)[i];
    const SeenPoint seen{tissue.point(point), tissue.point_velocity(point), camera_};
    const Eigen::Matrix3Xd s = tissue.point_columns(point);
    for (std::size_t k = 0; k < parameters_.size(); ++k) {
      const auto sensor = parameters_[k].parameter.sensor;
      Vector3d change =
          sensor != nullptr ? sensor(seen) : Vector3d(s.col(static_cast<Eigen::Index>(k)));
      // In a mesh of another thickness the face lies at other points of it.
      const ColumnParameter& moved = parameters_[k].tissue;
      if (moved.changed != nullptr && moved.changed->face_inset != model_->face_inset)
        change += (tissue.point((*moved.changed.*face)[i]) - seen.p_W) / moved.step;
      for (int axis = 0; axis < 3; ++axis) values[k].push_back(static_cast<float>(change[axis]));
    }
  }
  return values;
}

void ColumnCarrier::tell_ends(double t, const std::vector<std::vector<float>>& values) {
  for (std::size_t k = 0; k < parameters_.size(); ++k) {
    if (ended_[k] != 0 || std::ranges::all_of(values[k], [](float x) { return std::isfinite(x); }))
      continue;
    ended_[k] = 1;
    warnings_.push_back(
        fmt::format("--columns: {} ends at {:.6g} s: its scene has no finite force on the path",
                    parameters_[k].parameter.name, t));
  }
}

ColumnRecorder::ColumnRecorder(std::vector<PreparedParameter> parameters, const Scene& scene,
                               std::shared_ptr<const ReferenceTissueModel> model, const Arm& base,
                               std::string folder, std::size_t frames, std::size_t stride)
    : ColumnCarrier(std::move(parameters), scene, std::move(model), base),
      folder_(std::move(folder)),
      planned_(frames),
      stride_(stride),
      upper_(folder_ + "/upper.npy",
             {this->parameters().size(), frames, scene.tissue.particles.size(), 3}) {
  for (const Vector3d& p : scene.tissue.particles) uv_.insert(uv_.end(), {p.x(), p.y()});
}

void ColumnRecorder::take(std::size_t /*step*/, double t, const ReferenceTissue& tissue) {
  OMENTUM_CHECK(time_.size() < planned_, "frame {} of {}", time_.size(), planned_);
  const std::size_t frame = time_.size();
  const std::vector<std::vector<float>> values =
      columns_at(&ReferenceTissueModel::upper_points, tissue);
  for (std::size_t k = 0; k < values.size(); ++k)
    upper_.write((k * planned_ + frame) * values[k].size(), values[k]);
  tell_ends(t, values);
  const Eigen::MatrixXd force = tissue.columns()->multiplier.topRows<3>();
  force_.insert(force_.end(), force.data(), force.data() + force.size());
  time_.push_back(t);
}

void ColumnRecorder::finish() {
  upper_.close();
  const std::size_t count = parameters().size();
  std::vector<std::string> names;
  std::vector<std::string> units;
  for (const PreparedParameter& p : parameters()) {
    names.push_back(p.parameter.name);
    units.push_back(p.parameter.unit);
  }
  std::vector<double> time = time_;
  time.resize(planned_, NAN);
  std::vector<double> force(count * planned_ * 3, NAN);  // [K, F, 3]
  for (std::size_t frame = 0; frame < time_.size(); ++frame) {
    for (std::size_t k = 0; k < count; ++k) {
      for (std::size_t axis = 0; axis < 3; ++axis)
        force[(k * planned_ + frame) * 3 + axis] = force_[(frame * count + k) * 3 + axis];
    }
  }
  NpzFile archive;
  archive.add("names", names);
  archive.add("units", units);
  archive.add("t_s", {planned_}, time);
  archive.add("uv_B", {uv_.size() / 2, 2}, uv_);
  archive.add("force", {count, planned_, 3}, force);
  archive.add_file("upper", upper_.path());
  archive.write(folder_ + "/columns.npz");
  std::filesystem::remove(upper_.path());
}

ColumnKeeper::ColumnKeeper(std::vector<PreparedParameter> parameters, const Scene& scene,
                           std::shared_ptr<const ReferenceTissueModel> model, const Arm& base,
                           std::vector<std::size_t> steps)
    : ColumnCarrier(std::move(parameters), scene, std::move(model), base),
      steps_(std::move(steps)) {}

bool ColumnKeeper::wants(std::size_t step) const {
  return std::binary_search(steps_.begin(), steps_.end(), step);
}

void ColumnKeeper::take(std::size_t step, double t, const ReferenceTissue& tissue) {
  StateColumns& state = kept[step];
  state.surface = columns_at(&ReferenceTissueModel::upper_points, tissue);
  const std::vector<std::vector<float>> lower =
      columns_at(&ReferenceTissueModel::lower_points, tissue);
  for (std::size_t k = 0; k < lower.size(); ++k)
    state.surface[k].insert(state.surface[k].end(), lower[k].begin(), lower[k].end());
  tell_ends(t, state.surface);
  const Eigen::MatrixXd force = tissue.columns()->multiplier.topRows<3>();
  for (Eigen::Index k = 0; k < force.cols(); ++k) state.force.emplace_back(force.col(k));
}

}  // namespace omentum

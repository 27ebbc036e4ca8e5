#include <algorithm>
#include <numeric>

#include "core/check.h"
#include "sim_worker/cluster/cluster_tissue.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// A last cluster of all particles.
void add_global_cluster(ClusterTissueModel& model) {
  for (int i = 0; i < static_cast<int>(model.body.particles.size()); ++i)
    model.clusters.member.push_back(i);
  model.clusters.begin.push_back(static_cast<int>(model.clusters.member.size()));
  model.cluster_weight.push_back(model.parameters.global_stiffness() /
                                 model.parameters.cluster_stiffness());
}

/// Rest offsets relative to the mean of the final members (docs/tissue.md 3.2 rule 3).
void set_rest_offsets(const std::vector<Vector3d>& mean, ClusterTissueModel& model) {
  for (int c = 0; c < model.clusters.count(); ++c) {
    for (const int i : model.clusters.members(c))
      model.rest.push_back(model.body.particles[i] - mean[c]);
  }
}

void add_links(ClusterTissueModel& model) {
  const double radius = model.parameters.link_radius_m();
  const auto& p = model.body.particles;
  for (std::size_t i = 0; i < p.size(); ++i) {
    for (std::size_t j = i + 1; j < p.size(); ++j) {
      const double distance = (p[i] - p[j]).norm();
      if (distance < radius) {
        model.links.push_back({static_cast<int>(i), static_cast<int>(j)});
        model.link_rest.push_back(distance);
      }
    }
  }
}

/// The four nearest clusters of each surface vertex, weight 1 / (distance^2 + (0.1 mm)^2),
/// normalised (docs/tissue.md 2).
void skin_surface(const std::vector<Vector3d>& mean, ClusterTissueModel& model) {
  std::vector<int> order(mean.size());
  for (const Vector3d& vertex : model.body.surface_vertices) {
    const auto distance2 = [&](int c) { return (vertex - mean[c]).squaredNorm(); };
    std::iota(order.begin(), order.end(), 0);
    std::ranges::stable_sort(order, {}, distance2);
    double total = 0;
    std::array<double, 4> weight{};
    for (std::size_t k = 0; k < std::min<std::size_t>(4, order.size()); ++k) {
      weight[k] = 1.0 / (distance2(order[k]) + 1e-8);  // [m^2]: finite at a centre
      total += weight[k];
    }
    for (std::size_t k = 0; k < 4; ++k) {
      const int c = order[std::min(k, order.size() - 1)];
      model.skin_cluster.push_back(c);
      model.skin_weight.push_back(weight[k] / total);
      model.skin_offset.push_back(vertex - mean[c]);
    }
  }
}

}  // namespace

std::shared_ptr<const ClusterTissueModel> make_cluster_model(const Scene& scene,
                                                             double control_period,
                                                             std::vector<std::string>& warnings) {
  refuse_effects(scene.config.tissue().effects(), kClusterModel, "TISSUE_CLUSTER");
  auto model = std::make_shared<ClusterTissueModel>();
  model->body = scene.tissue;
  model->effects = make_effects(scene.config.tissue().effects(), 0, model->body.particles);
  model->parameters = scene.config.tissue().cluster();
  model->areal_density = scene.config.tissue().density_kg_per_m3() * model->body.thickness;
  model->is_anchor.assign(model->body.particles.size(), 0);
  model->control_period = control_period;
  model->surroundings = make_surroundings(scene);
  if (model->effects.adhesion > 0 && model->surroundings.bodies.empty())
    throw_error("scene.tissue.effects.adhesion: nothing to stick to, needs a scene.rigid_body");
  if (model->effects.adhesion > 0 && scene.config.tissue().has_volume()) {
    throw_error(
        "scene.tissue.effects.adhesion: TISSUE_CLUSTER with a volume, allowed with a sheet");
  }

  model->clusters = cook_clusters(model->body.particles, model->parameters);
  require_no_orphans(model->clusters, model->parameters);
  if (model->clusters.tie_margin < 0.1e-6) {
    warnings.push_back(fmt::format(
        "tissue.cluster: tie margin {:.3g} um is below 0.1 um: the last bit of a distance "
        "decides the clusters",
        model->clusters.tie_margin * 1e6));
  }
  if (model->clusters.rigid_groups > 1) {
    warnings.push_back(
        fmt::format("tissue.cluster: {} groups of clusters share fewer than 3 non-collinear "
                    "particles and can part",
                    model->clusters.rigid_groups));
  }
  if (model->clusters.attached > 0) {
    warnings.push_back(
        fmt::format("tissue.cluster: {} orphan particles attached to their nearest cluster "
                    "(orphan_policy ORPHANS_ATTACH_NEAREST)",
                    model->clusters.attached));
  }
  model->cluster_weight.assign(model->clusters.count(), 1.0);
  if (model->parameters.global_stiffness() > 0 && model->parameters.cluster_stiffness() > 0) {
    add_global_cluster(*model);
  }
  std::vector<Vector3d> mean;
  for (int c = 0; c < model->clusters.count(); ++c)
    mean.push_back(mean_position(model->body.particles, model->clusters.members(c)));
  set_rest_offsets(mean, *model);
  if (model->parameters.link_radius_m() > 0) add_links(*model);
  if (!model->body.surface_is_particles) skin_surface(mean, *model);
  return model;
}

std::unique_ptr<Tissue<float>> ClusterTissueModel::make_tissue(
    const LaneKernel<float>& kernel) const {
  return std::make_unique<ClusterTissue<float>>(shared_from_this(), kernel);
}

std::unique_ptr<Tissue<double>> ClusterTissueModel::make_tissue(
    const LaneKernel<double>& kernel) const {
  return std::make_unique<ClusterTissue<double>>(shared_from_this(), kernel);
}

}  // namespace omentum

#include "sim_worker/reference/reference_clamp.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cmath>
#include <map>

#include "core/check.h"
#include "sim_worker/tissue/effect_laws.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

/// Part of the clamp's width that the nodes on a grid line across carry.
struct ClampPart {
  double middle = 0, half_width = 0;  ///< x_B [m]
};
ClampPart clamp_part(const ReferenceTissueModel& model, std::size_t ix) {
  const std::vector<double>& xs = model.lines[0];
  const double left = ix > 0 ? 0.5 * (xs[ix] - xs[ix - 1]) : 0;
  const double right = ix + 1 < xs.size() ? 0.5 * (xs[ix + 1] - xs[ix]) : 0;
  return {xs[ix] + 0.5 * (right - left), 0.5 * (left + right)};
}
std::size_t line_across(const ReferenceTissueModel& model, std::size_t node) {
  return (node / model.lines[2].size()) % model.lines[0].size();
}

/// The bed under all clamped strips, even over their width and through the thickness, line by line
/// across. Springs at the nodes would be three times as stiff against a turn.
std::vector<BedPoint> make_bed(const ReferenceTissueModel& model) {
  static const double kGauss = 0.5 / std::sqrt(3.0);
  std::vector<BedPoint> bed;
  const std::vector<double>& ys = model.lines[1];
  const double thickness = model.lines[2].back() - model.lines[2].front();
  // Cells `first` on; a clamp without a strip has one row of nodes instead.
  const auto add_strip = [&](int first, int cells) {
    for (int ix = 0; ix <= model.cells(0); ++ix) {
      const double length = 2 * clamp_part(model, static_cast<std::size_t>(ix)).half_width;
      for (int row = first; row < first + std::max(1, cells); ++row) {
        const int next = row + std::min(1, cells);
        const double wide = cells > 0 ? (ys[next] - ys[row]) / (ys[first + cells] - ys[first]) : 1;
        for (int iz = 0; iz < model.cells(2); ++iz) {
          const double layer = (model.lines[2][iz + 1] - model.lines[2][iz]) / thickness;
          for (int point = 0; point < (cells > 0 ? 4 : 2); ++point) {
            const double z = 0.5 + ((point & 1) != 0 ? kGauss : -kGauss);
            const double y = cells == 0 ? 0 : 0.5 + ((point & 2) != 0 ? kGauss : -kGauss);
            bed.push_back({{model.node_index(ix, row, iz), model.node_index(ix, row, iz + 1),
                            model.node_index(ix, next, iz), model.node_index(ix, next, iz + 1)},
                           {(1 - y) * (1 - z), (1 - y) * z, y * (1 - z), y * z},
                           length * wide * layer / (cells > 0 ? 4 : 2),
                           0});
          }
        }
      }
    }
  };
  if (model.unknown.front() < 0) add_strip(0, model.strip_cells());
  if (model.body.two_clamps)
    add_strip(model.cells(1) - model.second_strip_cells(), model.second_strip_cells());
  return bed;
}

}  // namespace

void release_anchors(ReferenceTissueModel& model) {
  const EffectValues& effects = model.effects;
  if (!effects.moves_anchor()) return;
  model.is_anchor.assign(model.nodes.size(), 0);
  model.anchor.assign(model.nodes.size(), 0);
  const auto detached_at = [&](std::size_t ix) {
    const ClampPart part = clamp_part(model, ix);
    return detached_share(effects, part.middle, part.half_width);
  };
  bool held = false;
  if (effects.anchor_compliance > 0) {
    model.bed = make_bed(model);
    for (BedPoint& point : model.bed) {
      const auto ix = line_across(model, static_cast<std::size_t>(point.node[0]));
      point.stiffness = (1 - detached_at(ix)) * point.length / effects.anchor_compliance;
      held = held || point.stiffness > 0;
    }
  }
  const auto layers = static_cast<double>(model.lines[2].size());
  for (std::size_t i = 0; i < model.nodes.size(); ++i) {
    if (model.unknown[i] >= 0) continue;
    const double detached = detached_at(line_across(model, i));
    if (effects.anchor_compliance > 0) {
      // on the bed
    } else if (detached > 0) {
      model.anchor[i] = model.material.young_modulus_pa() * model.body.thickness / layers *
                        (1 - detached) / detached;
    } else {
      held = true;
      continue;
    }
    held = held || model.anchor[i] > 0;
    model.unknown[i] = 0;
    model.is_anchor[i] = 1;
  }
  if (!held) {
    throw_error("scene.tissue.effects.anchor: {} ... {} m detaches the whole clamp, allowed less",
                effects.anchor_free_from, effects.anchor_free_to);
  }
}

std::vector<Vector3d> ReferenceTissueModel::bed_give(std::span<const Vector3d> force) const {
  std::vector<Vector3d> give(nodes.size(), Vector3d::Zero());
  const std::vector<BedPoint> points = make_bed(*this);
  const auto line_of = [this](const BedPoint& point) {
    return line_across(*this, static_cast<std::size_t>(point.node[0]));
  };
  for (std::size_t first = 0, last = 0; first < points.size(); first = last) {
    std::map<int, int> row;  // of the nodes of this line
    for (; last < points.size() && line_of(points[last]) == line_of(points[first]); ++last) {
      for (const int node : points[last].node) row.try_emplace(node, 0);
    }
    int rows = 0;
    for (auto& [node, at] : row) at = rows++;
    Eigen::MatrixXd springs = Eigen::MatrixXd::Zero(rows, rows);
    for (std::size_t k = first; k < last; ++k) {
      for (int a = 0; a < 4; ++a) {
        for (int b = 0; b < 4; ++b)
          springs(row[points[k].node[a]], row[points[k].node[b]]) +=
              points[k].length * points[k].share[a] * points[k].share[b];
      }
    }
    Eigen::MatrixX3d load(rows, 3);
    for (const auto& [node, at] : row) load.row(at) = force[static_cast<std::size_t>(node)];
    const Eigen::MatrixX3d moved = springs.ldlt().solve(load);
    for (const auto& [node, at] : row) give[static_cast<std::size_t>(node)] = moved.row(at);
  }
  return give;
}

double ReferenceTissueModel::piece_compliance(std::size_t node, double x) const {
  const ClampPart part = clamp_part(*this, line_across(*this, node));
  if (!(std::fabs(x - part.middle) <= part.half_width)) return 0;
  return static_cast<double>(lines[2].size()) /
         (material.young_modulus_pa() * body.thickness * 2 * part.half_width);
}

}  // namespace omentum

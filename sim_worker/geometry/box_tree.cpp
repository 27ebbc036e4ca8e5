#include "sim_worker/geometry/box_tree.h"

#include <algorithm>
#include <numeric>

namespace omentum {

using Eigen::Vector3d;
using Eigen::Vector3i;

constexpr std::int32_t kLeafSize = 4;

BoxTree::BoxTree(std::span<const Vector3i> triangles, std::span<const Vector3d> vertices)
    : triangles_(triangles.begin(), triangles.end()), order_(triangles.size()) {
  std::iota(order_.begin(), order_.end(), 0);
  split(0, static_cast<std::int32_t>(order_.size()), vertices);
  fit(vertices);
}

std::int32_t BoxTree::split(std::int32_t first, std::int32_t last,
                            std::span<const Vector3d> vertices) {
  const auto index = static_cast<std::int32_t>(boxes_.size());
  boxes_.emplace_back();
  boxes_.back().first = first;
  boxes_.back().last = last;
  if (last - first <= kLeafSize) return index;
  const auto centre = [&](std::int32_t t) -> Vector3d {  // times three
    const Vector3i& c = triangles_[t];
    return vertices[c[0]] + vertices[c[1]] + vertices[c[2]];
  };
  Eigen::AlignedBox3d centres;
  for (std::int32_t k = first; k < last; ++k) centres.extend(centre(order_[k]));
  int axis = 0;
  centres.sizes().maxCoeff(&axis);
  const std::int32_t middle = (first + last) / 2;
  // Equal centres in the order of the mesh: the tree is the same on every machine.
  std::nth_element(order_.begin() + first, order_.begin() + middle, order_.begin() + last,
                   [&](std::int32_t a, std::int32_t b) {
                     return std::pair(centre(a)[axis], a) < std::pair(centre(b)[axis], b);
                   });
  split(first, middle, vertices);
  boxes_[index].right = split(middle, last, vertices);
  return index;
}

void BoxTree::fit(std::span<const Vector3d> vertices) {
  for (std::size_t k = boxes_.size(); k-- > 0;) {
    Box& box = boxes_[k];
    box.box.setEmpty();
    if (box.right != 0) {
      box.box.extend(boxes_[k + 1].box);
      box.box.extend(boxes_[box.right].box);
      continue;
    }
    for (std::int32_t n = box.first; n < box.last; ++n) {
      for (const int corner : triangles_[order_[n]]) box.box.extend(vertices[corner]);
    }
  }
}

}  // namespace omentum

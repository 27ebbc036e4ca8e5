#include "sim_worker/tissue/kernel_shape.h"

#include <algorithm>

#include "core/check.h"

namespace omentum {

template <typename Real>
KernelShape<Real> make_kernel_shape(const RigidShape& body) {
  KernelShape<Real> shape{};
  const Eigen::Matrix3d R_SW = body.X_WS.linear().transpose();
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) shape.rotation[3 * r + c] = static_cast<Real>(R_SW(r, c));
    shape.origin[r] = static_cast<Real>(body.X_WS.translation()[r]);
    shape.size[r] = static_cast<Real>(body.size[r]);
  }
  shape.bound_radius = static_cast<Real>(body.size.norm());
  switch (body.kind) {
    case RigidShape::Kind::kSphere:
      shape.kind = ShapeKind::kSphere;
      shape.bound_radius = shape.size[0];
      break;
    case RigidShape::Kind::kEllipsoid:
      shape.kind = ShapeKind::kEllipsoid;
      break;
    case RigidShape::Kind::kBox:
      shape.kind = ShapeKind::kBox;
      break;
    case RigidShape::Kind::kHalfSpace:
      shape.kind = ShapeKind::kHalfSpace;
      break;
    case RigidShape::Kind::kMesh: {
      OMENTUM_CHECK(body.sdf != nullptr);
      shape.kind = ShapeKind::kSdf;
      shape.sdf = body.sdf->value.data();
      shape.sdf_pitch = static_cast<Real>(body.sdf->pitch);
      double bound = 0;
      for (const Eigen::Vector3d& v : body.surface.vertices) bound = std::max(bound, v.norm());
      shape.bound_radius = static_cast<Real>(bound);
      for (int k = 0; k < 3; ++k) {
        shape.sdf_count[k] = body.sdf->count[k];
        shape.sdf_origin[k] = static_cast<Real>(body.sdf->origin[k]);
      }
      break;
    }
  }
  return shape;
}

template KernelShape<float> make_kernel_shape(const RigidShape& body);
template KernelShape<double> make_kernel_shape(const RigidShape& body);

template <typename Real>
KernelShapes<Real> make_kernel_shapes(const Surroundings& around) {
  KernelShapes<Real> shapes;
  const auto next = [&]() -> KernelShape<Real>& {
    return shapes.shape.at(static_cast<std::size_t>(shapes.count++));
  };
  for (const RigidShape& body : around.bodies) next() = make_kernel_shape<Real>(body);
  if (around.tool_contact) {
    KernelShape<Real>& tool = next();
    tool.kind = ShapeKind::kCapsule;
    tool.size[0] = static_cast<Real>(around.tool_radius);
    tool.length = static_cast<Real>(around.tool_length);
  }
  return shapes;
}

template KernelShapes<float> make_kernel_shapes(const Surroundings& around);
template KernelShapes<double> make_kernel_shapes(const Surroundings& around);

}  // namespace omentum

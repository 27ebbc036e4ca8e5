#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/result.h"
#include "core/types.h"
#include "sim_worker/lanes/lane_kernel.h"
#include "sim_worker/scene/scene.h"
#include "sim_worker/tissue/effect_catalogue.h"
#include "sim_worker/tissue/surroundings.h"

namespace omentum {

/// What the tool does to one lane during a control step: the tip moves on a straight line, p_WT
/// [m], and a tool that is turned has its shaft's axis, from the tip up in W, at either end.
struct ToolMotion {
  Eigen::Vector3d from = Eigen::Vector3d::Zero();
  Eigen::Vector3d to = Eigen::Vector3d::Zero();
  struct Axis {
    Eigen::Vector3d from, to;
  };
  std::optional<Axis> axis = std::nullopt;  ///< none: Surroundings::shaft_axis
};

/// Parameters that may differ between lanes (domain randomisation). Factors on the scene's values;
/// effects instead of the scene's (scene.tissue.effects), where they are given.
struct LaneParameters {
  double stiffness_scale = 1;
  double gravity_scale = 1;
  double damping_scale = 1;
  double friction_scale = 1;
  std::optional<EffectValues> effects = std::nullopt;
  double thickness_scale = 1;  ///< clusters only: mass, collision distance, and what a jaw takes
};

/// Limits of lane parameters: what a randomised scene may ask for, with room. Saved states are
/// checked with it.
bool usable(const LaneParameters& parameters);

/// Nearest tissue point to a query.
struct Nearest {
  int particle = 0;
  double distance = 0;  ///< [m]
};

struct TissueModel;

/// A batch of environments of the same tissue, one per SIMD lane: the seam between the tissue
/// models and everything that uses them. Lane k of a batch equals a batch of one, bit for bit, at
/// every width. "Particles" are the points that a grasp can take and that recordings show:
/// particles of the cluster model, nodes of the elastic one. Real is float in the product and
/// double as oracle. One thread at a time. Everywhere 0 <= lane < lanes() and 0 <= particle <
/// particles(), which is not checked. Contract test: tests/sim_worker/lanes/lanes_test.cpp.
template <typename Real>
class Tissue {
 public:
  Tissue() = default;
  Tissue(const Tissue&) = delete;
  Tissue& operator=(const Tissue&) = delete;
  virtual ~Tissue() = default;

  virtual const TissueModel& model() const = 0;
  virtual int lanes() const = 0;
  virtual int particles() const = 0;
  /// The kernel whose width the lane arrays have.
  virtual const LaneKernel<Real>& kernel() const = 0;

  /// Rest shape moved by `offset` in W [m], velocity zero, nothing held.
  virtual void reset(int lane, const Eigen::Vector3d& offset) = 0;
  /// Precondition: usable(parameters), and effects with the added mass of the scene and an anchor
  /// that fits it, anchors_fit(); the models in lanes abort otherwise.
  virtual void set_parameters(int lane, const LaneParameters& parameters) = 0;

  /// Advances every lane by one control step. Aborts unless `motion` has lanes() entries.
  void step(std::span<const ToolMotion> motion);

  // The stages of step(), in this order; CoupledTissue calls those of its two bodies.

  /// Once per control step: slip of the grasp, what may touch what.
  virtual void begin_step(std::span<const ToolMotion> motion) = 0;
  /// Where the tool will be at the end of the substep, and where inertia takes the tissue.
  virtual void begin_substep(std::span<const ToolMotion> motion, int substep) = 0;
  /// Positions at the end of the substep.
  virtual void solve_substep() = 0;
  /// Velocities and what effects remember. `last` of the control step: the force on the tool too.
  virtual void end_substep(bool last) = 0;

  /// Takes hold of the tissue within `radius` of the tip [m]; it then moves with the tip, shape
  /// kept, until release. `collapse` pulls it onto the tip instead (a named defect of the seed).
  /// Fixed tissue cannot be held.
  virtual void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) = 0;
  /// What fades with time (local_force.decay_s) stays as it is while the clock is stopped, as
  /// tissue comes to rest before a recording. Not part of the state.
  virtual void stop_clock(int /*lane*/, bool /*stopped*/) {}
  /// Distance of a point from a body that lies beside the sheet and can be held with it [m]; 0
  /// inside, infinite where there is none.
  virtual double distance_to_body(int /*lane*/, const Eigen::Vector3d& /*p*/) {
    return std::numeric_limits<double>::infinity();
  }
  /// hold() of that body; what is held of the sheet stays so. From then on release(), held(),
  /// shift_held() and held_force() are of both.
  virtual void hold_body(int /*lane*/, const Eigen::Vector3d& /*tip*/, double /*radius*/,
                         bool /*collapse*/) {}
  virtual void release(int lane) = 0;
  /// Particles held now, ascending; empty = nothing is held.
  virtual std::span<const std::int32_t> held(int lane) const = 0;
  /// Moves the held patch relative to the tip (slip) [m].
  virtual void shift_held(int lane, const Eigen::Vector3d& by) = 0;
  /// Turns the held patch about the tip. Precondition: TissueModel::can_turn().
  virtual void turn_held(int /*lane*/, const Eigen::Matrix3d& /*R*/) {}
  /// Force of the tissue on the tool through the grasp at the end of the last step, in W [N].
  virtual Eigen::Vector3d held_force(int lane) const = 0;
  /// Thickness of a lane over that of the scene.
  virtual double thickness_scale(int /*lane*/) const { return 1; }

  virtual Eigen::Vector3d position(int lane, int particle) const = 0;
  virtual Eigen::Vector3d velocity(int lane, int particle) const = 0;
  virtual void set_position(int lane, int particle, const Eigen::Vector3d& p) = 0;
  virtual void set_velocity(int lane, int particle, const Eigen::Vector3d& v) = 0;

  /// Nearest particle to a point of each lane, p_W [m]; ties go to the lower index. Aborts unless
  /// both have lanes() entries.
  virtual void find_nearest(std::span<const Eigen::Vector3d> points,
                            std::span<Nearest> nearest) const = 0;

  /// Vertices of the drawn surface in W [m] for all lanes, [vertex][xyz][lane]; valid until the
  /// next call.
  virtual const Real* surface_positions() = 0;
  virtual int surface_vertices() const = 0;

  /// True while every number of the lane is finite and its solver has not given up.
  virtual bool healthy(int lane) const = 0;
  /// Why a lane is not healthy; empty while it is.
  virtual std::string failure(int lane) const {
    return healthy(lane) ? "" : "the state is not finite";
  }

  /// Whole state of a lane, canonical: particle order, independent of lane and width; save()
  /// appends it to `out`. load() refuses, changing nothing, bytes of another size or with a
  /// non-finite number or an index out of range; it returns the number of bytes used.
  virtual void save(int lane, Bytes& out) const = 0;
  virtual Result<std::size_t> load(int lane, std::span<const std::byte> state) = 0;
  virtual std::uint64_t hash(int lane) const = 0;
};

/// The immutable half of a tissue: what all lanes share. Made once per scene, safe to share by
/// threads.
struct TissueModel {
  virtual ~TissueModel() = default;
  virtual std::unique_ptr<Tissue<float>> make_tissue(const LaneKernel<float>& kernel) const = 0;
  virtual std::unique_ptr<Tissue<double>> make_tissue(const LaneKernel<double>& kernel) const = 0;
  virtual std::uint32_t substeps() const = 0;  ///< solver substeps per control step
  /// Held tissue follows a tool that is turned.
  virtual bool can_turn() const { return false; }
  double substep() const { return control_period / substeps(); }  ///< [s]

  TissueBody body;
  Surroundings surroundings;
  EffectValues effects;          ///< of the scene, as far as the model has them
  double control_period = 0.02;  ///< [s]
};

}  // namespace omentum

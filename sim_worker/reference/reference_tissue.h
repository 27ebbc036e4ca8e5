#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/reference/frontal_cholesky.h"
#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/reference_effects.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/tissue/grasp_patch.h"

namespace omentum {

/// The converged solid in motion (docs/tissue.md 13): one environment, double precision; see
/// Tissue. The yardstick of the fast models and what `mismatch` compares recordings with.
///
/// Each implicit step (BDF2 started by backward Euler, or backward Euler) is solved by Newton's
/// method with the exact tangent, a Cholesky factor and a line search until the residual is
/// newton_tolerance of the weight. A step begins with the factor of the last; one that does not
/// converge with that begins anew without, and then is done in two halves, five times at most; then
/// the tissue is unhealthy, failure() says why, and step() does nothing until reset() or load().
///
///   M ((x - x~) / beta^2 - v~ / beta + damping (x - x~) / beta - g) + dPsi/dx
///       + contact + friction + C^T pull = 0,      v = (x - x~) / beta
///
/// The rows C of the grasp are constraints, C x = targets + compliance * pull, and the pull on them
/// an unknown (the line search walks down an augmented Lagrangian): a spring instead, as stiff as a
/// rigid patch needs, drowns the residual in rounding.
///
/// Contact acts at the nodes of the lower and upper face: a stiff spring per area that starts
/// smoothly 2 um before touching; 2000 Pa, 68 times the weight of a 3 mm sheet, press 0.01 mm deep.
/// Friction is Coulomb's, smooth below friction_slip_speed_m_per_s; static_friction holds at a node
/// that was slower than this at the end of the last step, dynamic_friction otherwise.
class ReferenceTissue : public Tissue<double> {
 public:
  explicit ReferenceTissue(std::shared_ptr<const ReferenceTissueModel> model);

  int lanes() const override { return 1; }
  int particles() const override { return static_cast<int>(model_->body.particles.size()); }
  const LaneKernel<double>& kernel() const override { return f64x1(); }
  const ReferenceTissueModel& model() const override { return *model_; }

  void reset(int lane, const Eigen::Vector3d& offset) override;
  void set_parameters(int lane, const LaneParameters& parameters) override;
  void begin_step(std::span<const ToolMotion> motion) override;
  void begin_substep(std::span<const ToolMotion> motion, int substep) override;
  void solve_substep() override;
  void end_substep(bool last) override;
  /// The patch is the circle of rest tissue around the point of the mid-surface nearest to the tip;
  /// its radius is such that the sphere of `radius` around the tip goes through its rim. It moves
  /// with the tip, neither turning nor deforming in the mean (GraspPatch). `collapse` pulls its
  /// mean position onto the tip.
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override;
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  Eigen::Vector3d held_force(int lane) const override;
  Eigen::Vector3d position(int lane, int particle) const override;
  /// The parabolas of the elements count as moving with the nodes.
  Eigen::Vector3d velocity(int lane, int particle) const override;
  /// Moves the nodes around the particle by the least that brings it to p; neighbours follow. Fixed
  /// particles stay. For displacing a whole sheet use set_nodes().
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) override;
  void find_nearest(std::span<const Eigen::Vector3d> points,
                    std::span<Nearest> nearest) const override;
  const double* surface_positions() override;
  int surface_vertices() const override { return particles(); }
  bool healthy(int lane) const override;
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;
  std::uint64_t hash(int lane) const override;

  /// Why the tissue is unhealthy; empty while it is not.
  const std::string& failure() const { return failure_; }
  /// Newton iterations since construction.
  long newton_iterations() const { return newton_iterations_; }
  long factorisations() const { return factorisations_; }
  /// Implicit steps since construction, halves of a step that did not converge included.
  long implicit_steps() const { return implicit_steps_; }

  /// Nodes of the mesh in W [m], [m/s]; order of ReferenceTissueModel::nodes.
  const std::vector<Eigen::Vector3d>& node_positions() const { return state_.x; }
  const std::vector<Eigen::Vector3d>& node_velocities() const { return state_.v; }
  /// Gives every free node a new position and velocity; history and parabolas start anew.
  void set_nodes(const std::function<Eigen::Vector3d(int node)>& position,
                 const std::function<Eigen::Vector3d(int node)>& velocity);
  /// Point of the body in W [m].
  Eigen::Vector3d point(const BodyPoint& point) const;

  struct Energy {
    double kinetic = 0, elastic = 0, gravity = 0;  ///< [J]
    double total() const { return kinetic + elastic + gravity; }
  };
  Energy energy() const;
  /// Force of the rigid bodies on the tissue at the end of the last step, in W [N]: one entry per
  /// body of the scene, the tool's shaft last where it can touch.
  std::span<const Eigen::Vector3d> contact_forces() const { return contact_forces_; }
  /// Deepest penetration of a face node into a body now [m], 0 if none.
  double penetration() const;

 private:
  using Nodes = std::vector<Eigen::Vector3d>;
  using Bubbles = std::vector<std::array<double, 9>>;  ///< per element, [axis][xyz] [m]
  using Targets = Eigen::Matrix<double, 3, GraspPatch::kRows>;

  /// Added to the compliance of a row of the grasp where its miss counts as a force [m/N]: stiff
  /// against the tissue, yet 1e-17 m of rounding are 1e-11 N only.
  static constexpr double kMissCompliance = 1e-6;

  struct State {
    Nodes x, v;                ///< [m], [m/s]
    Nodes x_before, v_before;  ///< at the end of the step before
    double step_before = 0;    ///< its length [s]; 0 = no history
    Bubbles bubble;
    Targets pull = Targets::Zero();  ///< of the tissue on the rows of the grasp [N]
  };
  struct Grasp {
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< of the patch, x_B and y_B at rest [m]
    double radius = 0;                                 ///< [m]
    Targets offset = Targets::Zero();  ///< targets of the rows; the first is relative to the tip
    GraspPatch patch;
  };
  /// One implicit step: constants of the integrator and where the tool is.
  struct Terms {
    double h = 0, beta = 0;  ///< [s]
    Nodes x_tilde, v_tilde;
    Targets target = Targets::Zero();
    Eigen::Vector3d tip = Eigen::Vector3d::Zero();
    Eigen::Vector3d tool_velocity = Eigen::Vector3d::Zero();
  };
  struct FrictionPoint {
    int node = 0;
    int body = 0;
    Eigen::Vector3d normal, body_velocity;
    double limit = 0;  ///< friction force that cannot be exceeded [N]
  };
  struct Residual {
    double energy = 0;      ///< incremental potential and what the grasp adds to it [J]
    double scale = 0;       ///< sum of the magnitudes of its terms [J]
    Eigen::VectorXd force;  ///< of elements, contact and jaws on the unknowns and parabolas [N]
    Targets miss = Targets::Zero();        ///< of the rows of the grasp [m]
    Targets miss_force = Targets::Zero();  ///< what it counts as, see kMissCompliance [N]
    double norm = 0;                       ///< of everything [N]
    double energy_inside = 0;              ///< without contact and grasp
    Eigen::VectorXd inside;

    void count_energy(double term) {
      energy += term;
      scale += term < 0 ? -term : term;
    }
  };
  /// Tangent that the factor is of; with it a loaded state makes the same factor. The elements'
  /// part was taken at (x, bubble).
  struct Tangent {
    bool usable = false;  ///< for the next step
    double inertia = 0;   ///< on the masses [1/s^2]
    Nodes x;
    Bubbles bubble;
    std::vector<Eigen::Matrix3d> node_blocks;  ///< of the other forces, per node [N/m]
  };
  struct Contact {
    int node = 0, body = 0;
    Eigen::Vector3d normal;
    double force = 0, stiffness = 0, energy = 0;  ///< [N], [N/m], [J]
  };

  /// How much of the factor is made anew: nothing, what depends on the blocks of the nodes, all.
  enum class Renewal { kNone, kNodes, kAll };

  bool advance(double from, double to, int depth);
  Terms make_terms(double from, double to) const;
  bool solve(const Terms& terms);
  void finish(const Terms& terms);
  HexShape gather(std::size_t batch, const Nodes& x, const Bubbles& bubble) const;
  void evaluate(const Terms& terms, const Nodes& x, const Bubbles& bubble, Residual& out) const;
  void evaluate_outside(const Terms& terms, const Nodes& x, Residual& out) const;
  void add_force(int node, const Eigen::Vector3d& force, Residual& out) const;
  double inertia(const Terms& terms) const;
  bool renew_factor(const Terms& terms, Renewal renewal, bool must);
  bool make_factor(const Terms& terms, std::vector<Eigen::Matrix3d> blocks);
  bool carry_factor();
  int bubble_unknown(std::size_t element, int c) const {
    return model_->unknowns + 9 * static_cast<int>(element) + c;
  }
  bool newton_direction(const Residual& residual);
  void assemble();
  std::vector<Eigen::Matrix3d> node_blocks(const Terms& terms) const;
  void set_block(int node, const Eigen::Matrix3d& more);
  void move_trial(const Terms& terms, double share, const Nodes& x, const Bubbles& bubble);
  bool search_line(const Terms& terms, Residual& residual);
  int bodies() const;
  void find_contacts(const Terms& terms, const Nodes& x, std::vector<Contact>& contacts) const;
  void add_contact(const Terms& terms, const Nodes& x, Residual& out) const;
  void contact_stiffness(
      const Terms& terms,
      const std::function<void(int node, const Eigen::Matrix3d& block)>& add) const;
  void collect_contact_forces(const Terms& terms);
  void update_friction(const Terms& terms, const Nodes& x);
  static Eigen::Vector3d slip_velocity(const Terms& terms, const FrictionPoint& point,
                                       const Eigen::Vector3d& x);
  Targets patch_rows(const Nodes& x) const;
  Eigen::Vector4d grasp_compliances() const;
  void slip();
  void add_grasp(const Terms& terms, const Nodes& x, Residual& out) const;
  void prepare_constraint();
  void constrain(const Targets& miss, Eigen::Ref<Eigen::VectorXd> direction);
  std::optional<SheetPoint> nearest_point(const Eigen::Vector3d& tip) const;
  void move_particle(int particle, const Eigen::Vector3d& by, Nodes& field);
  Grasp make_grasp(const Eigen::Vector2d& centre, double radius) const;
  std::vector<double> pack_state() const;
  void save_tangent(std::vector<double>& values) const;
  void load_tangent(const double* next);

  std::shared_ptr<const ReferenceTissueModel> model_;
  State state_;
  LaneParameters parameters_;
  ToolMotion motion_;  ///< of this control step
  int substep_ = 0;
  ReferenceEffects effects_;
  Eigen::Vector3d gravity_ = Eigen::Vector3d::Zero();  ///< of the lane, tilted [m/s^2]
  double slipped_ = 0;                                 ///< way of the patch out of the jaws [m]
  std::optional<Grasp> grasp_;
  Eigen::Vector3d held_force_ = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> contact_forces_;
  std::string failure_;
  Tangent tangent_;
  long newton_iterations_ = 0, factorisations_ = 0, implicit_steps_ = 0;

  // Scratch of one implicit step.
  FrontalCholesky factor_;
  bool factored_ = false;                     ///< factor_ is of tangent_
  bool constrained_ = false;                  ///< the constraint's solver is of factor_ and grasp_
  std::vector<Eigen::Matrix3d> body_blocks_;  ///< of each node with itself, of the last assemble()
  int kept_ = 0;                              ///< factors since the last assemble()
  std::vector<HexInner> inner_;               ///< per four elements
  /// Of the grasp, with the factor: L^-1 C^T and c I + its square (see prepare_constraint).
  Eigen::MatrixXd constraint_response_;
  Eigen::LDLT<Eigen::MatrixXd> constraint_solver_;
  std::vector<FrictionPoint> friction_;
  Nodes trial_x_;
  Bubbles trial_bubble_;
  Targets trial_pull_ = Targets::Zero();
  Targets next_pull_ = Targets::Zero();  ///< with the direction
  Eigen::VectorXd direction_;            ///< of the unknowns, then of the parabolas [m]
  std::vector<double> surface_;
};

}  // namespace omentum

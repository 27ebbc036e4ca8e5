#pragma once

#include <Eigen/Cholesky>
#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "sim_worker/reference/frontal_cholesky.h"
#include "sim_worker/reference/hexahedron.h"
#include "sim_worker/reference/reference_columns.h"
#include "sim_worker/reference/reference_effects.h"
#include "sim_worker/reference/reference_model.h"
#include "sim_worker/tissue/grasp_patch.h"
#include "sim_worker/tissue/rotation.h"

namespace omentum {

/// The converged solid in motion (docs/tissue.md 13): one environment, double precision; see
/// Tissue.
///
/// Each implicit step (BDF2 started by backward Euler, or backward Euler) is solved by Newton's
/// method with the exact tangent, a Cholesky factor and a line search until the residual is
/// newton_tolerance of the weight:
///
///   M ((x - x~) / beta^2 - v~ / beta + damping (x - x~) / beta - g) + dPsi/dx
///       + contact + friction + C^T p = 0,   C x - c p = targets,   v = (x - x~) / beta
///
/// and, of jaws that turn, theta / C_turn = sum_r t_r x p_r of the slopes t_r that they lead.
///
/// The grasp is a constraint on its rows C with compliance c and multipliers p, and the line search
/// descends an augmented Lagrangian: a penalty as stiff as a rigid patch would lose the residual in
/// rounding. A step begins with the factor of the last; if it does not converge it is repeated from
/// where it began, then in two halves, five times at most. Then the tissue is unhealthy, failure()
/// says why, and step() does nothing until reset() or load().
///
/// Contact is a penalty per area at the nodes of the lower and upper face that starts smoothly 2 um
/// before touching; its stiffness is stiff against the sheet's inertia per area (rho t / h^2, 7500
/// Pa/m) and soft enough for rounding: 2000 Pa, 68 times the weight of a 3 mm sheet, press 0.01 mm
/// deep at 2e8 Pa/m. Coulomb
/// friction is smooth below friction_slip_speed_m_per_s; static_friction holds at a node that was
/// slower than this at the end of the last step, dynamic_friction at others.
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
  /// The patch is the circle of rest tissue around the point of the mid-surface nearest to the tip,
  /// its rim on the sphere of `radius` around the tip. It moves with the tip, neither rotating nor
  /// deforming in the mean (GraspPatch). `collapse` moves its mean position onto the tip.
  void hold(int lane, const Eigen::Vector3d& tip, double radius, bool collapse) override;
  void release(int lane) override;
  std::span<const std::int32_t> held(int lane) const override;
  void shift_held(int lane, const Eigen::Vector3d& by) override;
  Eigen::Vector3d held_force(int lane) const override;
  /// Moment about the tip that goes with it [N m].
  Eigen::Vector3d held_moment() const;
  Eigen::Vector3d position(int lane, int particle) const override;
  Eigen::Vector3d velocity(int lane, int particle) const override;
  /// By the least change of the nodes around the particle; neighbours follow, fixed particles stay.
  /// For displacing a whole sheet use set_nodes().
  void set_position(int lane, int particle, const Eigen::Vector3d& p) override;
  void set_velocity(int lane, int particle, const Eigen::Vector3d& v) override;
  void find_nearest(std::span<const Eigen::Vector3d> points,
                    std::span<Nearest> nearest) const override;
  const double* surface_positions() override;
  int surface_vertices() const override { return particles(); }
  bool healthy(int lane) const override;
  std::string failure(int lane) const override;
  void save(int lane, Bytes& out) const override;
  Result<std::size_t> load(int lane, std::span<const std::byte> state) override;
  std::uint64_t hash(int lane) const override;

  /// Newton iterations since construction.
  long newton_iterations() const { return newton_iterations_; }
  long factorisations() const { return factorisations_; }
  /// Implicit steps since construction, halves of a step that did not converge included.
  long implicit_steps() const { return implicit_steps_; }

  /// Nodes of the mesh in W [m], [m/s]; order of ReferenceTissueModel::nodes.
  const std::vector<Eigen::Vector3d>& node_positions() const { return state_.x; }
  const std::vector<Eigen::Vector3d>& node_velocities() const { return state_.v; }
  /// Sets position and velocity of every free node; resets history and parabolas.
  void set_nodes(const std::function<Eigen::Vector3d(int node)>& position,
                 const std::function<Eigen::Vector3d(int node)>& velocity);
  /// Point of the body in W [m].
  Eigen::Vector3d point(const BodyPoint& point) const;
  /// The parabolas of the elements are taken to move with the nodes [m/s].
  Eigen::Vector3d point_velocity(const BodyPoint& point) const;

  void stop_clock(int lane, bool stopped) override;

  /// Lets tissue come to rest, under gravity and on what it lies on, with the
  /// tool at `tip`; its columns with it. The speed that is left [m/s]: 1e-5 or less but for tissue
  /// that does not come to rest, or that fails on the way.
  double settle(const Eigen::Vector3d& tip);

  /// From now on every free node moves at this velocity in W [m/s]; columns but those of
  /// kStartVelocity stay.
  void start_moving(const Eigen::Vector3d& velocity);

  /// From the next step on derivatives by these parameters are carried along; now they are zero but
  /// for what moves the mesh itself. Throws Error where the scene has none.
  void carry_columns(std::vector<ColumnParameter> parameters);
  /// Of the tip at the start and the end of the coming control step, one column per parameter [m
  /// per unit]; told before its hold(). Zero until told, and when told without columns.
  void set_tip_columns(const Eigen::Matrix3Xd& from, const Eigen::Matrix3Xd& to);
  /// Null while none are carried.
  const ReferenceColumns* columns() const { return columns_.get(); }
  /// Derivative of a point of the body in W, one column per parameter [m per unit].
  Eigen::Matrix3Xd point_columns(const BodyPoint& point) const;

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
  using Modes = std::vector<std::array<double, 9>>;  ///< per element, [axis][xyz] [m]
  using Targets = Eigen::Matrix<double, 3, GraspPatch::kRows>;

  /// Added to the compliance of a row of the grasp where its residual is weighed as a force [m/N]:
  /// stiff against the tissue, yet 1e-17 m of rounding are 1e-11 N only.
  static constexpr double kMissCompliance = 1e-6;

  struct State {
    Nodes x, v;                ///< [m], [m/s]
    Nodes x_before, v_before;  ///< at the end of the step before
    double step_before = 0;    ///< its length [s]; 0 = no history
    Modes mode;
    Targets multiplier = Targets::Zero();  ///< p: force of the tissue on the grasp's rows [N]
    Turn turn;                             ///< of jaws that turn, from the targets
  };
  struct Grasp {
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< of the patch, x_B and y_B at rest [m]
    double radius = 0;                                 ///< [m]
    Targets offset = Targets::Zero();  ///< targets of the rows; the first is relative to the tip
    GraspPatch patch;
    // Of a pad (reference_pad.cpp); the first target is the way from the tip to its centre.
    std::vector<int> pad_node;          ///< lower and upper one of each column
    std::vector<double> pad_stiffness;  ///< of the bed at each node [N/m]
    Nodes arm;                         ///< of each node from the centre when it was taken, in W [m]
    std::vector<std::uint8_t> in_pad;  ///< per node of the mesh; empty = the means are held
  };
  /// How far a pad has given way and turned.
  struct PadPose {
    Eigen::Vector3d shift = Eigen::Vector3d::Zero();  ///< [m]
    Eigen::Vector3d angle = Eigen::Vector3d::Zero();  ///< rotation vector [rad]
    Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  };
  /// How jaws that turn lead the rows of the patch.
  struct PatchTurn {
    Targets targets;                                   ///< those of the slopes turned
    double energy = 0;                                 ///< of the turn's spring [J]
    Eigen::Vector3d moment = Eigen::Vector3d::Zero();  ///< of it less that of the multipliers [N m]
    Eigen::Matrix3d compliance = Eigen::Matrix3d::Zero();  ///< turn per moment [rad/(N m)]
  };
  using Vector6 = Eigen::Matrix<double, 6, 1>;
  using Matrix6 = Eigen::Matrix<double, 6, 6>;
  /// Constants of one implicit step: of the integrator, of the tool at its end.
  struct Terms {
    double h = 0, beta = 0;      ///< [s]
    double now = 1, before = 0;  ///< x~ = now x_n - before x_{n-1}
    double end = 1;              ///< fraction of the control step
    double slip_speed = 0;       ///< below this friction is smooth [m/s]
    Nodes x_tilde, v_tilde;
    Targets target = Targets::Zero();
    Eigen::Vector3d tip = Eigen::Vector3d::Zero();
    Eigen::Vector3d tool_velocity = Eigen::Vector3d::Zero();
  };
  struct FrictionPoint {
    int node = 0;
    int body = 0;
    Eigen::Vector3d normal, body_velocity;
    double coefficient = 0;
    double pressed = 0;  ///< normal force [N]
    double limit = 0;    ///< Coulomb limit [N]
  };
  struct Residual {
    double energy = 0;                     ///< augmented Lagrangian of the step [J]
    double scale = 0;                      ///< sum of the magnitudes of its terms [J]
    Eigen::VectorXd force;                 ///< its derivative by the unknowns and the parabolas [N]
    Targets miss = Targets::Zero();        ///< residual of the rows of the grasp [m]
    Targets miss_force = Targets::Zero();  ///< the same weighed as a force, see kMissCompliance [N]
    Eigen::Vector3d moment = Eigen::Vector3d::Zero();  ///< on jaws that turn [N m]
    double moment_force = 0;   ///< the same at the longest slope of the patch [N]
    double norm = 0;           ///< of force, miss_force and moment_force [N]
    double energy_inside = 0;  ///< energy without contact and grasp
    Eigen::VectorXd inside;    ///< force without contact and grasp
    Eigen::VectorXd elements;  ///< force of the elements

    void count_energy(double term) {
      energy += term;
      scale += term < 0 ? -term : term;
    }
  };
  /// Where the factor's matrix was taken: a loaded state makes the same factor from it.
  struct Tangent {
    bool usable = false;  ///< for the next step
    double inertia = 0;   ///< factor of the masses [1/s^2]
    Nodes x;              ///< of the elements' part, with the parabolas
    Modes mode;
    std::vector<Eigen::Matrix3d> node_blocks;  ///< of the other forces, per node [N/m]
  };
  struct Saved;
  struct Contact {
    int node = 0, body = 0;
    Eigen::Vector3d normal;
    double force = 0, stiffness = 0, energy = 0;  ///< [N], [N/m], [J]
  };

  /// What of the factor is renewed: nothing, what depends on the blocks of the nodes, all.
  enum class Renewal { kNone, kNodes, kAll };

  bool advance(double from, double to, int depth);
  Terms make_terms(double from, double to) const;
  bool solve(const Terms& terms, bool moving);
  void finish(const Terms& terms);
  std::array<Eigen::Vector3d, 8> nodes_of(int element) const;
  HexShape gather(std::size_t batch, const Nodes& x, const Modes& mode) const;
  void evaluate(const Terms& terms, const Nodes& x, const Modes& mode, Residual& out) const;
  void evaluate_elements(const Nodes& x, const Modes& mode, Residual& out) const;
  void evaluate_nodes(const Terms& terms, const Nodes& x, Residual& out) const;
  void evaluate_outside(const Terms& terms, const Nodes& x, Residual& out) const;
  void add_force(int node, const Eigen::Vector3d& force, Residual& out) const;
  double inertia(const Terms& terms) const;
  bool renew_factor(const Terms& terms, Renewal renewal, bool must);
  bool make_factor(const Terms& terms, std::vector<Eigen::Matrix3d> blocks);
  bool carry_factor();
  double rounding() const;
  double energy_rounding() const;
  /// Elements of a batch of Pack::kLanes.
  int elements_in(std::size_t batch) const {
    const std::size_t left = model_->elements.size() - Pack::kLanes * batch;
    return static_cast<int>(std::min<std::size_t>(Pack::kLanes, left));
  }
  /// Unknown of component c of the nodes of an element, -1 where clamped.
  int node_unknown(std::size_t element, int c) const {
    const int first = model_->unknown[model_->elements[element].node[c / 3]];
    return first < 0 ? -1 : first + c % 3;
  }
  int mode_unknown(std::size_t element, int c) const {
    return model_->unknowns + 9 * static_cast<int>(element) + c;
  }
  bool newton_direction(const Residual& residual);
  void assemble();
  void assemble(const Tangent& tangent, FrontalCholesky& factor, std::vector<HexInner>& inner,
                std::vector<Eigen::Matrix3d>& body_blocks) const;
  std::vector<Eigen::Matrix3d> node_blocks(const Terms& terms) const;
  void set_block(int node, const Eigen::Matrix3d& block, FrontalCholesky& factor) const;
  void move_trial(const Terms& terms, double length, const Nodes& x, const Modes& mode);
  bool search_line(const Terms& terms, Residual& residual);
  int bodies() const;
  std::vector<Contact> find_contacts(const Terms& terms, const Nodes& x) const;
  void add_contact(const Terms& terms, const Nodes& x, Residual& out) const;
  void contact_stiffness(
      const Terms& terms,
      const std::function<void(int node, const Eigen::Matrix3d& block)>& add) const;
  Eigen::Matrix3d normal_turn(const Terms& terms, int body, const Eigen::Vector3d& p) const;
  void friction_stiffness(
      const Terms& terms,
      const std::function<void(int node, const Eigen::Matrix3d& block)>& add) const;
  void add_limit_loads(const Terms& terms, const RightSides& s, RightSides& loads) const;
  void collect_contact_forces(const Terms& terms);
  FrictionPoint friction_point(const Terms& terms, const Contact& contact) const;
  void update_friction(const Terms& terms, const Nodes& x);
  void follow_friction(const Terms& terms, const ReferenceTissue& base);
  static Eigen::Vector3d slip_velocity(const Terms& terms, const FrictionPoint& point,
                                       const Eigen::Vector3d& x);
  Targets patch_rows(const Nodes& x) const;
  Eigen::Vector4d grasp_compliances() const;
  PatchTurn patch_turn(const Turn& turn, const Targets& targets, const Targets& multiplier) const;
  void add_grasp_compliance(const PatchTurn& turn, Eigen::Ref<Eigen::MatrixXd> rows) const;
  double patch_stiffness(const Eigen::Vector3d& along);
  void slip();
  void add_grasp(const Terms& terms, const Nodes& x, Residual& out) const;
  Eigen::MatrixXd grasp_columns() const;
  bool has_pad() const { return grasp_ && !grasp_->in_pad.empty(); }
  void make_pad(Grasp& grasp) const;
  void take_pad(const Eigen::Matrix3d& jaw, const Eigen::Vector3d& tip, bool collapse);
  Eigen::Matrix3d pad_turn_stiffness() const;
  Eigen::Matrix3d pad_turn_compliance() const;
  Matrix6 pad_springs(const PadPose& pose, const Nodes& x, Vector6& gradient) const;
  Matrix6 pad_balance(const PadPose& pose, const Nodes& x, Vector6& gradient) const;
  PadPose pad_pose(const Nodes& x) const;
  void add_pad(const Nodes& x, Residual& out) const;
  Eigen::MatrixXd pad_columns(const PadPose& pose, bool shifts, bool turns) const;
  Eigen::Matrix<double, 3, 2> pad_wrench(const PadPose& pose, const Nodes& x,
                                         const Eigen::Vector3d& tip) const;
  void remember_pad(const Terms& terms);
  bool prepare_constraint();
  void constrain(const Targets& miss, Eigen::Ref<Eigen::VectorXd> direction);
  bool turns() const { return grasp_ && !has_pad() && effects_.values().grasp_turn > 0; }
  std::optional<SheetPoint> nearest_point(const Eigen::Vector3d& tip) const;
  void move_particle(int particle, const Eigen::Vector3d& by, Nodes& field);
  Grasp make_grasp(const Eigen::Vector2d& centre, double radius) const;

  void stop();
  void advance_columns(const Terms& terms);
  bool factor_columns(const Terms& terms);
  void hold_columns(const Eigen::Matrix3d& jaw, bool collapse);
  // Of a pad (reference_pad_columns.cpp).
  Eigen::Matrix<double, 3, 2> pad_miss(const PadPose& pose, const Nodes& x) const;
  void hold_pad_columns(const Eigen::Matrix3d& jaw, bool collapse);
  void compare_pads();
  void prepare_pad_columns();
  Eigen::Matrix3Xd pad_place_columns(const Terms& terms, Eigen::Index k) const;
  void pad_column_loads(const Terms& terms, RightSides& nodes, Eigen::MatrixXd& grasp) const;
  void finish_pad_columns(const Terms& terms);
  Eigen::Matrix3Xd node_columns(int node) const;
  Eigen::MatrixXd patch_columns() const;
  Eigen::MatrixXd grasp_target_columns(const Terms& terms) const;
  Eigen::Matrix2Xd patch_shift() const;
  void follow(const ReferenceTissue& base);
  void evaluate_along(const ReferenceTissue& base, Terms terms, const Residual* elements,
                      Residual& out);
  void column_loads(const Terms& terms, RightSides& nodes, RightSides& modes,
                    Eigen::MatrixXd& grasp);
  Nodes clamp_forces() const;
  void clamp_loads(const Residual& same, RightSides& nodes, RightSides& modes,
                   Eigen::MatrixXd& grasp);
  void site_loads(const Terms& terms, RightSides& nodes, RightSides& modes) const;
  void add_obstacle_load(const ColumnParameter& sphere, Eigen::Index k, RightSides& nodes) const;
  void for_each_follower(const std::function<void(ReferenceTissue&)>& fn);
  void condense_columns(const RightSides& modes, RightSides& nodes) const;
  void solve_columns(const Eigen::MatrixXd& grasp, RightSides& nodes,
                     Eigen::MatrixXd& multiplier) const;
  void recover_modes() const;

  std::shared_ptr<const ReferenceTissueModel> model_;
  State state_;
  LaneParameters parameters_;
  ToolMotion motion_;  ///< of this control step
  int substep_ = 0;
  ReferenceEffects effects_;
  Eigen::Vector3d gravity_ = Eigen::Vector3d::Zero();  ///< of the lane, tilted [m/s^2]
  Eigen::Vector3d offset_ = Eigen::Vector3d::Zero();   ///< of the last reset [m]
  double slipped_ = 0;                                 ///< slip of the patch, summed [m]
  std::optional<Grasp> grasp_;
  Eigen::Vector3d pad_centre_ = Eigen::Vector3d::Zero();  ///< if it did not give way, of this step
  std::optional<PadPose> led_pose_;  ///< of the base's pad, of a tissue that follows it
  Eigen::Vector3d held_force_ = Eigen::Vector3d::Zero();
  std::vector<Eigen::Vector3d> contact_forces_;
  std::string failure_;
  std::unique_ptr<ReferenceColumns> columns_;
  Tangent tangent_;
  long newton_iterations_ = 0, factorisations_ = 0, implicit_steps_ = 0;
  double friction_smoothing_ = 1;  ///< times the slip speed of the scene, while it settles

  // Scratch of one implicit step.
  FrontalCholesky factor_;
  double rounding_ = 0;                       ///< rounding() at the last factor [N]
  bool factored_ = false;                     ///< factor_ belongs to tangent_
  bool constrained_ = false;                  ///< constraint_solver_ belongs to factor_ and grasp_
  std::vector<Eigen::Matrix3d> body_blocks_;  ///< diagonal blocks of the last assemble()
  int kept_ = 0;                              ///< factors since the last assemble()
  std::vector<HexInner> inner_;               ///< per four elements
  /// Y = L^-1 C^T of the grasp, S Y, and c I + Y^T S Y (see prepare_constraint).
  Eigen::MatrixXd constraint_response_, signed_response_;
  BorderSolver constraint_solver_;
  std::vector<FrictionPoint> friction_;
  Nodes trial_x_;
  Modes trial_mode_;
  Targets trial_multiplier_ = Targets::Zero();
  Targets next_multiplier_ = Targets::Zero();  ///< after a full step along direction_
  Turn trial_turn_;
  Eigen::Vector3d turn_step_ = Eigen::Vector3d::Zero();  ///< of a full step [rad]
  Eigen::VectorXd direction_;  ///< of the unknowns, then of the parabolas [m]
  std::vector<double> surface_;
};

}  // namespace omentum

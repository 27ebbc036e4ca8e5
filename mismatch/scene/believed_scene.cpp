#include "mismatch/scene/believed_scene.h"

#include <fmt/format.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <optional>

#include "core/check.h"
#include "core/constants.h"
#include "core/csv.h"
#include "core/table.h"
#include "core/trig.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr std::string_view kBlanks = " \t\r";

std::string_view trim(std::string_view text) {
  text.remove_prefix(std::min(text.find_first_not_of(kBlanks), text.size()));
  while (!text.empty() && kBlanks.find(text.back()) != std::string_view::npos)
    text.remove_suffix(1);
  return text;
}

/// A key that is a number or a vector, and what it may be.
struct NumberKey {
  const char* name;
  int count;  ///< of numbers
  double min, max;
};
constexpr double kAny = 1e9;
constexpr std::array kNumberKeys = {
    NumberKey{"sheet_size_x_m", 1, 0.002, 1},
    NumberKey{"sheet_size_y_m", 1, 0.002, 1},
    NumberKey{"sheet_thickness_m", 1, 1e-4, 0.5},
    NumberKey{"young_modulus_nominal_Pa", 1, 100, 1e8},
    NumberKey{"young_modulus_uncertainty_factor", 1, 1, 1000},
    NumberKey{"poisson_ratio_nominal", 1, 0, 0.5},
    NumberKey{"density_nominal_kg_per_m3", 1, 100, 5000},
    NumberKey{"sheet_origin_x_m", 1, -10, 10},
    NumberKey{"sheet_origin_y_m", 1, -10, 10},
    NumberKey{"sheet_origin_z_m", 1, -10, 10},
    NumberKey{"sheet_axis_x_in_W", 3, -kAny, kAny},
    NumberKey{"sheet_axis_y_in_W", 3, -kAny, kAny},
    NumberKey{"clamp_strip_width_m", 1, 0, 0.5},
    NumberKey{"board_plane_normal", 3, -kAny, kAny},
    NumberKey{"board_plane_z_m", 1, -10, 10},
    NumberKey{"board_friction_nominal", 1, 0, 5},
    NumberKey{"gravity_m_per_s2", 1, 0, 20},
    NumberKey{"gripper_patch_x_m", 1, 2e-4, 0.1},
    NumberKey{"gripper_patch_y_m", 1, 2e-4, 0.1},
    NumberKey{"camera_position_W_m", 3, -10, 10},
    NumberKey{"camera_view_direction_W", 3, -kAny, kAny},
    NumberKey{"sensor_depth_step_m", 1, 0, 0.1},
    NumberKey{"clock_offset_uncertainty_s", 1, 0, 100},
    NumberKey{"shaft_direction_W", 3, -kAny, kAny},
};
constexpr std::array<std::string_view, 11> kTextKeys = {"kind",
                                                        "mesh_file",
                                                        "rest_cloud_file",
                                                        "material",
                                                        "clamped_edge",
                                                        "tip_reference",
                                                        "cloud_content",
                                                        "force_sensor",
                                                        "camera_registration_uncertainty",
                                                        "sensor_noise_class",
                                                        "name"};

/// "pinch_point_12_sheet_m" for the stems "pinch_point_" and "_sheet_m"; the number.
std::optional<int> numbered(std::string_view key, std::string_view stem, std::string_view end) {
  if (!key.starts_with(stem) || !key.ends_with(end) || key.size() <= stem.size() + end.size())
    return std::nullopt;
  key.remove_prefix(stem.size());
  key.remove_suffix(end.size());
  if (key.size() > 4 ||
      !std::all_of(key.begin(), key.end(), [](char c) { return c >= '0' && c <= '9'; }))
    return std::nullopt;
  return std::stoi(std::string(key));
}

/// What a text says, before it is a scene.
class Belief {
 public:
  explicit Belief(std::string name) : name_(std::move(name)) {}

  Result<void> read(std::string_view text);
  double number(const std::string& key, double otherwise) const {
    const auto found = numbers_.find(key);
    return found == numbers_.end() ? otherwise : found->second.front();
  }
  std::optional<Vector3d> vector(const std::string& key) const {
    const auto found = numbers_.find(key);
    if (found == numbers_.end()) return std::nullopt;
    return Vector3d(found->second[0], found->second[1], found->second[2]);
  }
  bool has(const std::string& key) const { return numbers_.count(key) + texts_.count(key) > 0; }
  std::string text(const std::string& key) const {
    const auto found = texts_.find(key);
    return found == texts_.end() ? "" : found->second;
  }
  /// "name:line: key"
  std::string place(const std::string& key) const {
    const auto found = lines_.find(key);
    return found == lines_.end() ? name_ : fmt::format("{}:{}: {}", name_, found->second, key);
  }
  const std::map<std::string, std::size_t>& lines() const { return lines_; }
  const std::map<int, Vector3d>& pinch_sheet() const { return pinch_sheet_; }
  const std::map<int, Vector3d>& pinch_W() const { return pinch_W_; }
  const std::vector<std::string>& unknown() const { return unknown_; }

 private:
  Result<std::vector<double>> parse_numbers(std::size_t line, std::string_view key,
                                            std::string_view value, int least, int most) const;
  Result<void> take(std::size_t line, const std::string& key, std::string_view value);

  std::string name_;
  std::map<std::string, std::vector<double>> numbers_;
  std::map<std::string, std::string> texts_;
  std::map<std::string, std::size_t> lines_;
  std::map<int, Vector3d> pinch_sheet_, pinch_W_;
  std::vector<std::string> unknown_;
};

Result<std::vector<double>> Belief::parse_numbers(std::size_t line, std::string_view key,
                                                  std::string_view value, int least,
                                                  int most) const {
  std::vector<double> numbers;
  for (std::size_t at = 0; at < value.size();) {
    at = std::min(value.find_first_not_of(" \t,", at), value.size());
    const std::size_t end = std::min(value.find_first_of(" \t,", at), value.size());
    if (at == end) break;
    const std::optional<double> number = parse_number(value.substr(at, end - at));
    if (!number || !std::isfinite(*number)) {
      return Failure{fmt::format("{}:{}: {}: \"{}\" is no finite number", name_, line, shown(key),
                                 shown(value.substr(at, end - at)))};
    }
    numbers.push_back(*number);
    at = end;
  }
  const int count = static_cast<int>(numbers.size());
  if (count < least || count > most) {
    return Failure{fmt::format(
        "{}:{}: {}: {} numbers, needed {}", name_, line, shown(key), count,
        least == most ? fmt::format("{}", most) : fmt::format("{} or {}", least, most))};
  }
  return numbers;
}

Result<void> Belief::take(std::size_t line, const std::string& key, std::string_view value) {
  if (!lines_.emplace(key, line).second) {
    return Failure{fmt::format("{}:{}: {}: given a second time, first on line {}", name_, line,
                               shown(key), lines_.at(key))};
  }
  if (std::find(kTextKeys.begin(), kTextKeys.end(), key) != kTextKeys.end()) {
    texts_[key] = std::string(value);
    return {};
  }
  for (const auto& [end, points] : {std::pair{"_sheet_m", &pinch_sheet_}, {"_W_m", &pinch_W_}}) {
    const std::optional<int> number = numbered(key, "pinch_point_", end);
    if (!number) continue;
    const auto numbers = parse_numbers(line, key, value, 2, 3);
    if (!numbers) return Failure{numbers.error()};
    const std::vector<double>& p = numbers.value();
    (*points)[*number] = Vector3d(p[0], p[1], p.size() > 2 ? p[2] : 0);
    return {};
  }
  double factor = 1;
  std::string name = key;
  auto known = std::find_if(kNumberKeys.begin(), kNumberKeys.end(),
                            [&](const NumberKey& k) { return name == k.name; });
  if (known == kNumberKeys.end()) {  // in another unit
    if (const Result<SiColumn> si = si_column(key)) {
      name = si.value().name;
      factor = si.value().factor;
      known = std::find_if(kNumberKeys.begin(), kNumberKeys.end(),
                           [&](const NumberKey& k) { return name == k.name; });
    }
  }
  if (known == kNumberKeys.end()) {
    unknown_.push_back(key);
    return {};
  }
  const auto parsed = parse_numbers(line, key, value, known->count, known->count);
  if (!parsed) return Failure{parsed.error()};
  std::vector<double> numbers = parsed.value();
  for (double& number : numbers) {
    number *= factor;
    if (number >= known->min && number <= known->max) continue;
    return Failure{fmt::format("{}:{}: {}: {:.6g}, allowed {:g} ... {:g}", name_, line, shown(key),
                               number, known->min, known->max)};
  }
  if (name != key && !lines_.emplace(name, line).second) {
    return Failure{fmt::format("{}:{}: {}: given a second time, first on line {}", name_, line,
                               shown(key), lines_.at(name))};
  }
  numbers_[name] = numbers;
  return {};
}

Result<void> Belief::read(std::string_view text) {
  if (text.starts_with("\xef\xbb\xbf")) text.remove_prefix(3);
  if (text.find('\0') != std::string_view::npos)
    return Failure{name_ + ": bytes of zero, needed plain text (UTF-8)"};
  std::size_t line = 0;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t end = std::min(text.find('\n', at), text.size());
    std::string_view content = text.substr(at, end - at);
    content = trim(content.substr(0, content.find('#')));
    at = end + 1;
    ++line;
    if (content.empty()) continue;
    const std::size_t colon = content.find(':');
    if (colon == std::string_view::npos) {
      return Failure{
          fmt::format("{}:{}: \"{}\": no colon, needed key: value", name_, line, shown(content))};
    }
    const std::string key(trim(content.substr(0, colon)));
    const std::string_view value = trim(content.substr(colon + 1));
    if (key.empty()) return Failure{fmt::format("{}:{}: no key before the colon", name_, line)};
    if (value.empty()) {
      return Failure{fmt::format("{}:{}: {}: no value behind the colon", name_, line, shown(key))};
    }
    if (Result<void> taken = take(line, key, value); !taken) return taken;
  }
  return {};
}

/// The numbers before units of a text such as "2 mm, 0.5 deg", in SI.
struct StatedUncertainty {
  double metres = 0, radians = 0;
};
StatedUncertainty uncertainty_in(std::string_view text) {
  StatedUncertainty found;
  double number = -1;  // below zero: none
  for (std::size_t at = 0; at < text.size();) {
    at = std::min(text.find_first_not_of(" \t,;()+-~", at), text.size());
    std::size_t end = std::min(text.find_first_of(" \t,;()+~", at), text.size());
    std::string_view word = text.substr(at, end - at);
    if (word.empty()) break;
    std::size_t digits = 0;
    while (digits < word.size() &&
           std::string_view("0123456789.").find(word[digits]) != std::string_view::npos)
      ++digits;
    if (digits > 0) {
      number = parse_number(word.substr(0, digits)).value_or(-1);
      word.remove_prefix(digits);
    }
    if (number >= 0 && number < 1e6) {
      if (word == "mm") found.metres = 1e-3 * number;
      if (word == "m") found.metres = number;
      if (word == "deg" || word == "degree" || word == "degrees") found.radians = kDegree * number;
      if (word == "rad") found.radians = number;
    }
    if (!word.empty()) number = -1;
    at = end;
  }
  return found;
}

void set(pb::Vec3& to, const Vector3d& v) {
  to.set_x(v.x());
  to.set_y(v.y());
  to.set_z(v.z());
}

void add_prior(pb::Priors& priors, const std::string& path, double factor, double sd,
               const std::string& source) {
  pb::Prior& prior = *priors.add_prior();
  prior.set_path(path);
  if (factor > 1) prior.set_factor(factor);
  if (sd > 0) prior.set_sd(sd);
  prior.set_source(source);
}

/// X_WB of a sheet: origin in a corner of the clamped edge, x away from the clamp, y along it.
Result<Eigen::Isometry3d> sheet_pose(const Belief& belief, double size_x, double size_y,
                                     double thickness, std::vector<std::string>& warnings) {
  const bool stated = belief.has("sheet_origin_x_m") || belief.has("sheet_origin_y_m");
  // Unstated, W has its origin in the middle of the sheet and its axes are those of B.
  const Vector3d x = belief.vector("sheet_axis_x_in_W").value_or(Vector3d(0, 1, 0));
  const Vector3d y = belief.vector("sheet_axis_y_in_W").value_or(Vector3d(-1, 0, 0));
  if (!(x.cross(y).norm() > 0.1 * x.norm() * y.norm())) {
    return Failure{fmt::format("{}: parallel to sheet_axis_x_in_W, or one of them is zero",
                               belief.place("sheet_axis_y_in_W"))};
  }
  Eigen::Matrix3d R_WS;
  R_WS.col(0) = x.normalized();
  R_WS.col(2) = x.cross(y).normalized();
  R_WS.col(1) = R_WS.col(2).cross(R_WS.col(0));
  const double board = belief.number("board_plane_z_m", 0);
  Vector3d origin(belief.number("sheet_origin_x_m", 0), belief.number("sheet_origin_y_m", 0),
                  belief.number("sheet_origin_z_m", board));
  if (!stated) {
    origin -= R_WS * Vector3d(0.5 * size_x, 0.5 * size_y, 0);
    warnings.push_back(
        "sheet_origin_x_m, sheet_origin_y_m: not stated: the middle of the sheet is taken to be at "
        "x = y = 0");
  }
  Eigen::Isometry3d X_WB = Eigen::Isometry3d::Identity();
  X_WB.linear().col(0) = -R_WS.col(1);
  X_WB.linear().col(1) = R_WS.col(0);
  X_WB.linear().col(2) = R_WS.col(2);
  X_WB.translation() = origin + R_WS * Vector3d(0.5 * size_x, 0.5 * size_y, 0.5 * thickness);
  return X_WB;
}

void set_camera(const Belief& belief, const Vector3d& looks_at, pb::Scene& scene) {
  pb::Camera& camera = *scene.mutable_camera();
  const Vector3d position =
      belief.vector("camera_position_W_m").value_or(looks_at + Vector3d(0, 0, 0.3));
  const Vector3d toward = looks_at - position;
  Vector3d axis = belief.vector("camera_view_direction_W")
                      .value_or(toward.norm() > 1e-6 ? toward : Vector3d(0, 0, -1));
  if (!(axis.norm() > 0)) axis = Vector3d(0, 0, -1);
  axis.normalize();
  const Vector3d up = std::fabs(axis.z()) < 0.9 ? Vector3d(0, 0, 1) : Vector3d(0, 1, 0);
  set(*camera.mutable_position_m(), position);
  set(*camera.mutable_axis(), axis);
  set(*camera.mutable_up(), up);
  camera.set_near_m(std::max(1e-3, std::min(0.03, 0.1 * toward.norm())));
  camera.set_far_m(std::clamp(3 * toward.norm(), 0.1, 10.0));
}

void set_material(const Belief& belief, BelievedScene& made) {
  pb::Scene& scene = made.scene;
  std::vector<std::string>& warnings = made.warnings;
  pb::Tissue& tissue = *scene.mutable_tissue();
  pb::Material& material = *tissue.mutable_material();
  tissue.set_model(pb::TISSUE_ELASTIC);
  if (belief.has("young_modulus_nominal_Pa"))
    material.set_young_modulus_pa(belief.number("young_modulus_nominal_Pa", 0));
  if (belief.has("poisson_ratio_nominal")) {
    constexpr double kHighest = 0.49;  // of Material.poisson_ratio
    const double nu = belief.number("poisson_ratio_nominal", 0);
    if (nu > kHighest) {
      warnings.push_back(fmt::format("{}: {} is taken as {}, the highest that is simulated",
                                     belief.place("poisson_ratio_nominal"), nu, kHighest));
    }
    material.set_poisson_ratio(std::min(nu, kHighest));
  }
  if (belief.has("density_nominal_kg_per_m3"))
    tissue.set_density_kg_per_m3(belief.number("density_nominal_kg_per_m3", 0));
  const double factor = belief.number("young_modulus_uncertainty_factor", 0);
  if (factor > 1) {
    add_prior(made.priors, "scene.tissue.material.young_modulus_pa", factor, 0,
              "young_modulus_uncertainty_factor");
  }
}

/// Uncertainties of camera and clock; the texts that hold no number are told.
void set_sensor(const Belief& belief, BelievedScene& made) {
  pb::Scene& scene = made.scene;
  std::vector<std::string>& warnings = made.warnings;
  const StatedUncertainty registration =
      uncertainty_in(belief.text("camera_registration_uncertainty"));
  if (registration.metres > 0)
    add_prior(made.priors, "scene.depth_sensor.registration_m", 0, registration.metres,
              "camera_registration_uncertainty");
  if (registration.radians > 0)
    add_prior(made.priors, "scene.depth_sensor.registration_deg", 0, registration.radians / kDegree,
              "camera_registration_uncertainty");
  if (belief.has("camera_registration_uncertainty") && registration.metres == 0)
    warnings.push_back(belief.place("camera_registration_uncertainty") +
                       ": no number with mm or m in it: not used");
  const double noise = uncertainty_in(belief.text("sensor_noise_class")).metres;
  if (noise > 0 && noise <= 0.1) scene.mutable_depth_sensor()->set_noise_m(noise);
  if (belief.has("sensor_noise_class") && !(noise > 0 && noise <= 0.1))
    warnings.push_back(belief.place("sensor_noise_class") +
                       ": no number with mm or m in it: not used");
  if (belief.has("sensor_depth_step_m"))
    scene.mutable_depth_sensor()->set_depth_step_m(belief.number("sensor_depth_step_m", 0));
  if (const double clock = belief.number("clock_offset_uncertainty_s", 0); clock > 0)
    add_prior(made.priors, "scene.depth_sensor.time_offset_s", 0, clock,
              "clock_offset_uncertainty_s");
}

void set_board(const Belief& belief, pb::Scene& scene) {
  if (!belief.has("board_plane_z_m") && !belief.has("board_plane_normal")) return;
  pb::RigidBody& board = *scene.add_rigid_body();
  board.set_name("board");
  board.set_role(pb::ROLE_BOARD);
  board.set_half_space(true);
  board.mutable_pose()->mutable_translation_m()->set_z(belief.number("board_plane_z_m", 0));
  const Vector3d z = belief.vector("board_plane_normal").value_or(Vector3d(0, 0, 1));
  if (!(z.norm() > 0)) return;
  const Vector3d n = z.normalized();
  if ((n - Vector3d::UnitZ()).norm() < 1e-9) return;
  const Vector3d aside = std::fabs(n.x()) < 0.9 ? Vector3d(1, 0, 0) : Vector3d(0, 1, 0);
  const Vector3d x = (aside - aside.dot(n) * n).normalized();
  set(*board.mutable_pose()->mutable_x_axis(), x);
  set(*board.mutable_pose()->mutable_y_axis(), n.cross(x));
}

/// What the simulation has no place for.
void tell_unused(const Belief& belief, SetUp kind, std::vector<std::string>& warnings) {
  for (const std::string key :
       {"material", "clamped_edge", "tip_reference", "cloud_content", "force_sensor"}) {
    if (belief.has(key)) warnings.push_back(belief.place(key) + ": words, kept and not used");
  }
  for (const std::string& key : belief.unknown()) {
    const bool mass = key.starts_with("mass_");
    warnings.push_back(fmt::format("{}: {}: not used", belief.place(key),
                                   mass ? "no mass can be hung on a body yet" : "no such key"));
  }
  if (const auto shaft = belief.vector("shaft_direction_W")) {
    if (shaft->norm() > 0 && shaft->normalized().z() > -0.99)
      warnings.push_back(belief.place("shaft_direction_W") +
                         ": the simulated shaft points along -z_W: not used");
  }
  if (kind == SetUp::kArm || kind == SetUp::kCoupon) return;
  for (const char* key :
       {"young_modulus_nominal_Pa", "density_nominal_kg_per_m3", "sheet_thickness_m"}) {
    if (!belief.has(key))
      warnings.push_back(fmt::format("{}: not stated: that of the schema is taken", key));
  }
}

}  // namespace

void place_sheet(const SheetPlace& place, pb::Scene& scene, std::vector<std::string>& warnings) {
  constexpr double kWanted = 0.003;  // [m] from particle to particle
  constexpr double kTold = 5e-4;     // [m] of an edge
  const double shorter = std::min(place.size_x, place.size_y);
  double best = 1e9, pitch = shorter / 2;
  const int usual = static_cast<int>(std::clamp(std::round(shorter / kWanted), 4.0, 60.0));
  for (int n = std::max(4, usual - usual / 4); n <= usual + usual / 4; ++n) {
    const double p = shorter / n;
    const double longer = std::max(place.size_x, place.size_y);
    const double miss = std::fabs(std::clamp(std::round(longer / p), 1.0, 199.0) * p - longer);
    const double cost = miss + 1e-4 * std::fabs(n - usual);
    if (cost < best) {
      best = cost;
      pitch = p;
    }
  }
  const auto count = [&](double size) {
    return static_cast<std::uint32_t>(std::clamp(std::round(size / pitch), 1.0, 199.0)) + 1;
  };
  pb::Tissue& tissue = *scene.mutable_tissue();
  pb::GridMaker& grid = *tissue.mutable_grid();
  grid.set_pitch_m(pitch);
  grid.set_count_x(count(place.size_x));
  grid.set_count_y(count(place.size_y));
  const double made_y = (grid.count_y() - 1) * pitch;
  for (const auto& [name, size, made] :
       {std::tuple{"x_B", place.size_x, (grid.count_x() - 1) * pitch},
        {"y_B", place.size_y, made_y}}) {
    if (std::fabs(made - size) > kTold) {
      warnings.push_back(fmt::format("the sheet is {:.2f} mm long along {}, its grid {:.2f} mm",
                                     1e3 * size, name, 1e3 * made));
    }
  }
  tissue.set_thickness_m(place.thickness);
  tissue.set_particle_radius_m(0.5 * place.thickness);
  tissue.set_anchor_max_y_m(-0.5 * made_y + place.clamp + 1e-6);
  pb::Pose& pose = *tissue.mutable_pose();
  set(*pose.mutable_translation_m(), place.X_WB.translation());
  set(*pose.mutable_x_axis(), place.X_WB.linear().col(0));
  set(*pose.mutable_y_axis(), place.X_WB.linear().col(1));
  const Vector3d centre = place.X_WB.translation();
  const double half = 0.5 * std::hypot(place.size_x, place.size_y);
  // The arm stands to the sheet as in the scene omentum; the tip starts above its middle.
  set(*scene.mutable_tool()->mutable_base()->mutable_translation_m(),
      centre + Vector3d(0.1599, -0.0536, 0.1244));
  set(*scene.mutable_workspace_min_m(),
      centre - Vector3d(half + 0.02, half + 0.02, 0.5 * place.thickness - 5e-4));
  set(*scene.mutable_workspace_max_m(), centre + Vector3d(half + 0.02, half + 0.02, 0.085));
  set(*scene.mutable_tool_start_m(), centre + Vector3d(0, 0, 0.05));
  set(*scene.mutable_target_m(), centre + Vector3d(-0.02, 0, 0.07));
  // What a policy is sent to: the sheet halfway to its free edge.
  set(*scene.mutable_tumour_point_m(),
      place.X_WB * Vector3d(0, 0.25 * place.size_y, 0.5 * place.thickness));
}

Result<BelievedScene> parse_believed_scene(const std::string& name, std::string_view text) {
  Belief belief(name);
  if (Result<void> read = belief.read(text); !read) return Failure{read.error()};
  BelievedScene made;
  pb::Scene& scene = made.scene;
  const std::string kind = belief.has("kind") ? belief.text("kind") : "sheet";
  constexpr std::array<std::string_view, 4> kKinds = {"sheet", "solid", "arm", "coupon"};
  const auto found = std::find(kKinds.begin(), kKinds.end(), kind);
  if (found == kKinds.end()) {
    return Failure{fmt::format("{}: \"{}\", allowed sheet, solid, arm, coupon",
                               belief.place("kind"), shown(kind))};
  }
  made.kind = static_cast<SetUp>(found - kKinds.begin());
  scene.set_format_version(1);
  scene.set_name(belief.has("name") ? belief.text("name") : "believed");
  scene.set_source("scene_believed.txt");
  if (belief.has("gravity_m_per_s2"))
    scene.set_gravity_m_per_s2(belief.number("gravity_m_per_s2", 0));
  made.rest_cloud_file = belief.text("rest_cloud_file");
  tell_unused(belief, made.kind, made.warnings);
  if (made.kind != SetUp::kArm) set_material(belief, made);
  if (made.kind == SetUp::kCoupon) return made;
  set_sensor(belief, made);
  if (made.kind == SetUp::kArm) {
    set_camera(belief, Vector3d::Zero(), scene);
    return made;
  }
  SheetPlace place;
  place.size_x = belief.number("sheet_size_y_m", 0.09);  // along the clamp: x_B
  place.size_y = belief.number("sheet_size_x_m", 0.09);
  place.thickness = belief.number("sheet_thickness_m", 0.003);
  place.clamp = belief.number("clamp_strip_width_m", 0.003);
  if (!(place.clamp < place.size_y)) {
    return Failure{fmt::format("{}: {} m of a sheet of {} m, allowed less than all of it",
                               belief.place("clamp_strip_width_m"), place.clamp, place.size_y)};
  }
  const Result<Eigen::Isometry3d> pose =
      sheet_pose(belief, place.size_y, place.size_x, place.thickness, made.warnings);
  if (!pose) return Failure{pose.error()};
  place.X_WB = pose.value();
  place_sheet(place, scene, made.warnings);
  pb::Tissue& tissue = *scene.mutable_tissue();
  if (belief.has("board_friction_nominal")) {
    tissue.set_static_friction(belief.number("board_friction_nominal", 0));
    tissue.set_dynamic_friction(belief.number("board_friction_nominal", 0));
  }
  if (made.kind == SetUp::kSolid) {
    pb::VolumeMaker& volume = *tissue.mutable_volume();  // ends the grid
    tissue.mutable_material()->set_law(pb::LAW_STABLE_NEO_HOOKE);
    if (belief.has("mesh_file")) {
      volume.mutable_mesh()->set_path(belief.text("mesh_file"));
    } else {
      set(*volume.mutable_box_m(), Vector3d(place.size_x, place.size_y, place.thickness));
    }
    const double thinnest = std::min({place.size_x, place.size_y, place.thickness});
    volume.set_edge_length_m(std::clamp(0.4 * thinnest, 2e-4, 1.0));
    volume.set_particle_spacing_m(std::clamp(0.25 * thinnest, 2e-4, 0.1));
  } else if (belief.has("mesh_file")) {
    tissue.mutable_sheet()->mutable_mesh()->set_path(belief.text("mesh_file"));
  }
  set_board(belief, scene);
  set_camera(belief, place.X_WB.translation(), scene);
  pb::Tool& tool = *scene.mutable_tool();
  tool.set_contact(false);  // where the shaft is no belief says
  if (belief.has("gripper_patch_x_m") || belief.has("gripper_patch_y_m")) {
    const double along = belief.number("gripper_patch_x_m", belief.number("gripper_patch_y_m", 0));
    const double across = belief.number("gripper_patch_y_m", along);
    // x_C of a tool that is not rolled is y_W: the rectangle turns with the sheet.
    const Vector3d x_S = place.X_WB.linear().col(1);
    tool.set_roll_deg(std::remainder(trig::atan2(x_S.y(), x_S.x()) / kDegree - 90, 360));
    tool.mutable_grip()->set_shape(pb::GRIP_RECTANGLE);
    tool.mutable_grip()->set_half_x_m(0.5 * along);
    tool.mutable_grip()->set_half_y_m(0.5 * across);
  }
  for (const auto& [number, p] : belief.pinch_W()) made.pinch_W.push_back(p);
  for (const auto& [number, p] : belief.pinch_sheet()) {
    if (belief.pinch_W().count(number) > 0) continue;
    const Vector3d p_B(0.5 * place.size_x - p.y(), p.x() - 0.5 * place.size_y, p.z());
    made.pinch_W.push_back(place.X_WB * p_B);
  }
  return made;
}

}  // namespace omentum

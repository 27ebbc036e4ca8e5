#include "mismatch/calibrate/findings.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "core/constants.h"
#include "mismatch/calibrate/law_choice.h"
#include "mismatch/calibrate/number_words.h"
#include "mismatch/fit/camera_errors.h"
#include "mismatch/fit/fit_numbers.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

using Eigen::Vector3d;

constexpr double kNinety = 1.6448536;  // standard deviations of a two-sided interval of 90 %
constexpr double kUnseen = 0.9;        // of the prior's standard deviation is left
constexpr double kOddPull = 4;         // standard deviations of a prior
constexpr double kSurprise = 2.5;      // of a parameter: one in 80 by chance
constexpr const char* kBendingPath = "scene.tissue.effects.bending_change";

/// The mean of a posterior varies about the prior's by what the variance has become less.
double surprise_of(double x, double sd, double prior_sd) {
  constexpr double kLeast = 0.2;  // of the prior's standard deviation: less says nothing
  const double seen = prior_sd * prior_sd - sd * sd;
  return seen > kLeast * kLeast * prior_sd * prior_sd ? x / std::sqrt(seen) : 0;
}

double sd_of(const Findings& f, int k) {
  return std::sqrt(std::max(f.posterior.shared_covariance(k, k), 0.0));
}

CalibratedNumber shared_number(const Findings& f, int k) {
  const Unknown& unknown = f.data.unknowns[static_cast<std::size_t>(k)];
  const double x = f.found.state.shared[k], sd = sd_of(f, k);
  CalibratedNumber number;
  number.name = unknown.path;
  number.unit = unknown.unit;
  number.value = unknown.value(x);
  number.low90 = unknown.value(x - kNinety * sd);
  number.high90 = unknown.value(x + kNinety * sd);
  number.prior_value = unknown.value(0);
  number.prior_low90 = unknown.value(-kNinety * unknown.sd);
  number.prior_high90 = unknown.value(kNinety * unknown.sd);
  number.prior_source = unknown.prior;
  number.pull = x / unknown.sd;
  number.surprise = surprise_of(x, sd, unknown.sd);
  const Range range = range_of(unknown);
  const double near = 1e-3 * unknown.sd;
  number.at_bound = x < range.low + near || x > range.high - near;
  number.unseen = sd > kUnseen * unknown.sd;
  return number;
}

/// Numbers whose beliefs may be wrong instead of that of k: the recordings see them together, and
/// they are held mostly by what is believed.
std::string confused_with(const Findings& f, int k) {
  constexpr double kAlike = 0.4;   // correlation
  constexpr double kBelief = 0.3;  // of the prior's standard deviation is left
  std::string names;
  for (int j = 0; j < f.data.layout.unknowns.count; ++j) {
    const Unknown& other = f.data.unknowns[static_cast<std::size_t>(j)];
    const double sj = sd_of(f, j), sk = sd_of(f, k);
    if (j == k || !other.simulated() || sj < kBelief * other.sd) continue;
    if (std::fabs(f.posterior.shared_covariance(j, k)) < kAlike * sj * sk) continue;
    names += " or " + other.path;
  }
  return names;
}

int index_of(const Findings& f, const char* path) {
  const auto& list = f.data.unknowns;
  const auto found = std::ranges::find(list, path, &Unknown::path);
  return found == list.end() ? -1 : static_cast<int>(found - list.begin());
}

/// Lifts see thickness and bending together (bending times the thickness squared), so that a wide
/// belief in the bending hides a wrong thickness. A body that is homogeneous through it has no
/// other bending: how thick it would have to be is held against the thickness believed.
void add_thickness_of_even_body(const Findings& f, std::vector<std::string>& warnings) {
  const int thickness = index_of(f, kThicknessPath), bending = index_of(f, kBendingPath);
  if (thickness < 0 || bending < 0) return;
  const Unknown& unknown = f.data.unknowns[static_cast<std::size_t>(thickness)];
  const Unknown& bent = f.data.unknowns[static_cast<std::size_t>(bending)];
  const auto n = f.posterior.shared_covariance.rows();
  Eigen::MatrixXd precision =
      f.posterior.shared_covariance.ldlt().solve(Eigen::MatrixXd::Identity(n, n));
  Eigen::VectorXd x = f.found.state.shared.head(n);
  x[bending] -= bent.at(0);
  const Eigen::VectorXd known = precision * x;
  precision(thickness, thickness) -= 1 / (unknown.sd * unknown.sd);  // what is believed of it
  std::vector<Eigen::Index> others;
  for (Eigen::Index k = 0; k < n; ++k) {
    if (k != bending) others.push_back(k);
  }
  const Eigen::LDLT<Eigen::MatrixXd> factor(precision(others, others));
  if (!factor.isPositive()) return;
  const Eigen::Index at = thickness - (bending < thickness ? 1 : 0);
  const double even = factor.solve(known(others))[at];
  const double variance = factor.solve(Eigen::VectorXd::Unit(n - 1, at))[at];
  const double deviations = even / std::sqrt(variance + unknown.sd * unknown.sd);
  // Recordings that know it less well than the belief are led astray by what the model leaves out.
  if (!(variance < unknown.sd * unknown.sd && std::fabs(deviations) > kSurprise)) return;
  const double spread = kNinety * std::sqrt(variance);
  const CalibratedNumber change = shared_number(f, bending);
  const std::string thick = number_in_line(unknown.value(even), unknown.value(even - spread),
                                           unknown.value(even + spread), unknown.unit);
  warnings.push_back(fmt::format(
      "{}: if the body is homogeneous through its thickness, the recordings make it {} thick, "
      "{:.1f} standard deviations {} the belief of {}; measure it, or its bending differs "
      "by {:+.0f} % ({:.0f} - {:.0f})",
      unknown.path, thick, std::fabs(deviations), deviations < 0 ? "below" : "above",
      told_belief(shared_number(f, thickness)), 100 * change.value, 100 * change.low90,
      100 * change.high90));
}

bool recordings_move(const Findings& f) {
  const int k = f.data.layout.clock.begin;
  return sd_of(f, k) < kUnseen * f.data.beliefs.shared_sd[k];
}

/// What of the stiffness is seen with others alone: its value where they are as believed.
void add_traded_stiffness(const Findings& f, Calibration& result) {
  const int stiffness = kStiffnessUnknown;
  const auto n = f.data.layout.unknowns.count;
  const Eigen::MatrixXd C = f.posterior.shared_covariance.topLeftCorner(n, n);
  std::vector<int> others;
  Eigen::VectorXd slope;
  // Variance of the stiffness where the others are known.
  const auto left = [&](const std::vector<int>& list) {
    const Eigen::MatrixXd among = C(list, list);
    const Eigen::VectorXd with = C(list, stiffness);
    slope = among.ldlt().solve(with);
    return C(stiffness, stiffness) - with.dot(slope);
  };
  double variance = C(stiffness, stiffness);
  constexpr std::size_t kMost = 3;
  constexpr double kWorth = 0.75;  // of the variance is left
  while (others.size() < kMost) {
    int best = -1;
    double least = kWorth * variance;
    for (int k = 0; k < n; ++k) {
      if (k == stiffness || std::ranges::count(others, k) > 0) continue;
      std::vector<int> more = others;
      more.push_back(k);
      if (const double v = left(more); v < least) {
        least = v;
        best = k;
      }
    }
    if (best < 0) break;
    others.push_back(best);
    variance = least;
  }
  constexpr double kTogether = 0.25;  // of the variance: half the interval
  if (others.empty() || variance > kTogether * C(stiffness, stiffness)) return;
  left(others);
  double x = f.found.state.shared[stiffness];
  const Unknown& unknown = f.data.unknowns[static_cast<std::size_t>(stiffness)];
  NumberGroup group;
  group.members = {unknown.path};
  std::string names;
  for (std::size_t k = 0; k < others.size(); ++k) {
    const Unknown& other = f.data.unknowns[static_cast<std::size_t>(others[k])];
    x -= slope[static_cast<Eigen::Index>(k)] * f.found.state.shared[others[k]];
    group.members.push_back(other.path);
    names += (k > 0 ? ", " : "") + other.path;
  }
  const double spread = kNinety * std::sqrt(std::max(variance, 0.0));
  group.name = "stiffness for the believed values of the others";
  group.unit = unknown.unit;
  group.value = unknown.value(x);
  group.low90 = unknown.value(x - spread);
  group.high90 = unknown.value(x + spread);
  group.text = fmt::format(
      "Can be exchanged for {}, whose own intervals are mostly those of the prior: measure them, "
      "or take this value with what was believed of them.",
      names);
  result.groups.push_back(std::move(group));
}

}  // namespace

CalibratedNumber plain_number(const std::string& name, const std::string& unit, double x, double sd,
                              double prior_sd, const std::string& source) {
  CalibratedNumber number;
  number.name = name;
  number.unit = unit;
  number.value = x;
  number.low90 = x - kNinety * sd;
  number.high90 = x + kNinety * sd;
  number.prior_low90 = -kNinety * prior_sd;
  number.prior_high90 = kNinety * prior_sd;
  number.prior_source = source;
  number.pull = x / prior_sd;
  number.unseen = sd > kUnseen * prior_sd;
  return number;
}

void add_own_numbers(const Findings& f, std::size_t fitted, const Layout::Columns& columns,
                     const std::string& source, Calibration& result) {
  const std::size_t r = f.fitted[fitted];
  const std::vector<FitNumber> numbers = numbers_of(f.data);
  for (int k = 0; k < columns.count; ++k) {
    const FitNumber& named = numbers[static_cast<std::size_t>(columns.begin + k)];
    const int own = f.data.layout.among_own(columns) + k;
    CalibratedNumber number =
        plain_number(named.name, named.unit, f.found.state.own[r][own],
                     f.posterior.own_sd[fitted][own], f.found.scales.own_sd[own], source);
    number.recording = f.data.observations[r].name;
    number.name = fmt::format("{}: {}", number.recording, named.name);
    result.nuisances.push_back(std::move(number));
  }
}

void add_numbers(const Findings& f, Calibration& result) {
  for (int k = 0; k < f.data.layout.unknowns.count; ++k) {
    const bool parameter = f.data.unknowns[static_cast<std::size_t>(k)].in_scene();
    (parameter ? result.parameters : result.nuisances).push_back(shared_number(f, k));
  }
  const Layout& layout = f.data.layout;
  const std::vector<FitNumber> numbers = numbers_of(f.data);
  const auto number_at = [&](int column) { return numbers[static_cast<std::size_t>(column)]; };
  const auto add_shared = [&](int column) {
    const FitNumber& number = number_at(column);
    result.nuisances.push_back(plain_number(number.name, number.unit, f.found.state.shared[column],
                                            sd_of(f, column), f.data.beliefs.shared_sd[column],
                                            "believed"));
  };
  for (int k = 0; k < layout.registration.count; ++k) add_shared(layout.registration.begin + k);
  add_shared(layout.clock.begin);
  result.nuisances.back().low90 = f.clock.low;  // no normal distribution
  result.nuisances.back().high90 = f.clock.high;
  for (std::size_t i = 0; i < f.fitted.size(); ++i) {
    for (const Layout::Columns& columns : {layout.pinch, layout.stiffness_factor, layout.own_clock})
      add_own_numbers(f, i, columns, "the other recordings and docs/calibrate.md 3", result);
  }
  for (std::size_t i = 0; i < f.fitted.size(); ++i) {
    if (!f.data.observations[f.fitted[i]].has_force()) continue;
    for (const Layout::Columns& columns : {layout.force_zero, layout.force_gain})
      add_own_numbers(f, i, columns, "docs/calibrate.md 2", result);
  }
  for (int k = 0; k < kTimeFunctions; ++k) {
    const double sd = f.found.scales.own_sd[layout.among_own(layout.modes) + k * layout.cosines()];
    result.nuisances.push_back(plain_number(discrepancy_name(k), "m", 0, sd, sd,
                                            "standard deviation of each smooth mode"));
  }
  result.numerics_m = std::sqrt(f.mesh_m * f.mesh_m + f.step_m * f.step_m + f.law_m * f.law_m);
}

void add_groups(const Findings& f, Calibration& result) {
  const pb::Scene& scene = result.scene;
  // Exact for recordings of places alone: docs/mismatch.md 1.
  const double weight = scene.tissue().density_kg_per_m3() *
                        (1 + scene.tissue().effects().density_change()) * scene.gravity_m_per_s2() *
                        scene.gravity_scale();
  const auto stiffness =
      std::ranges::find(result.parameters, std::string("scene.tissue.material.young_modulus_pa"),
                        &CalibratedNumber::name);
  const bool with_force = std::ranges::any_of(
      f.fitted, [&](std::size_t r) { return f.data.observations[r].has_force(); });
  if (stiffness != result.parameters.end() && weight > 0 && !with_force) {
    NumberGroup group;
    group.name = "E/(rho g)";
    group.unit.assign(1, 'm');
    group.value = stiffness->value / weight;
    group.low90 = stiffness->low90 / weight;
    group.high90 = stiffness->high90 / weight;
    group.members = {"scene.tissue.material.young_modulus_pa", "scene.tissue.density_kg_per_m3"};
    group.text =
        "Without a force the recordings see stiffness against weight alone: E is that of the "
        "stated "
        "density. A force channel parts them, or a known mass hung on the body.";
    result.groups.push_back(std::move(group));
  }
  add_traded_stiffness(f, result);
  const int clock = f.data.layout.clock.begin;
  if (!recordings_move(f)) {
    result.warnings.push_back(
        "scene.depth_sensor.time_offset_s: the recordings show tissue at rest, which tells nothing "
        "of the camera's clock; it stays at its prior; record while the tissue moves");
  } else {
    NumberGroup group;
    group.name = "latency";
    group.unit.assign(1, 's');
    group.value = f.found.state.shared[clock];
    group.low90 = f.clock.low;
    group.high90 = f.clock.high;
    group.members = {"scene.depth_sensor.time_offset_s", "scene.arm.transport_delay_s"};
    group.text =
        "Clock of the camera and delay of the arm are seen as their sum alone. It stands in the "
        "scene as the camera's. A third channel on the robot's clock parts them.";
    result.groups.push_back(std::move(group));
  }
  for (int i = 0; i < f.data.layout.unknowns.count; ++i) {
    const Unknown& a = f.data.unknowns[static_cast<std::size_t>(i)];
    if (!a.simulated()) continue;
    if (sd_of(f, i) > kUnseen * a.sd) {
      NumberGroup group;
      const CalibratedNumber number = shared_number(f, i);
      group.name = "unseen";
      group.unit = a.unit;
      group.value = number.value;
      group.low90 = number.low90;
      group.high90 = number.high90;
      group.members = {a.path};
      group.text =
          "The recordings say nothing of it: value and interval are those believed before.";
      result.groups.push_back(std::move(group));
    }
    for (int j = i + 1; j < f.data.layout.unknowns.count; ++j) {
      const Unknown& b = f.data.unknowns[static_cast<std::size_t>(j)];
      const double si = sd_of(f, i), sj = sd_of(f, j);
      if (!(si > 0 && sj > 0)) continue;
      const double correlation = f.posterior.shared_covariance(i, j) / (si * sj);
      constexpr double kAlike = 0.95;
      if (std::fabs(correlation) < kAlike || si > kUnseen * a.sd || sj > kUnseen * b.sd) continue;
      NumberGroup group;
      group.name = correlation < 0 ? "product" : "ratio";
      group.unit.assign(1, '1');
      const double sign = correlation < 0 ? 1 : -1;
      const double x = f.found.state.shared[i] / si + sign * f.found.state.shared[j] / sj;
      group.value = x;
      const double spread = kNinety * std::sqrt(2 * (1 - std::fabs(correlation)));
      group.low90 = x - spread;
      group.high90 = x + spread;
      group.members = {a.path, b.path};
      group.text = fmt::format(
          "Correlation {:.3f}: one can be exchanged for the other; each interval holds for any "
          "value "
          "of the other.",
          correlation);
      result.groups.push_back(std::move(group));
    }
  }
}

void add_warnings(const Findings& f, Calibration& result) {
  std::vector<std::string>& warnings = result.warnings;
  const Layout& layout = f.data.layout;
  for (const auto* numbers : {&result.parameters, &result.nuisances}) {
    for (const CalibratedNumber& number : *numbers) {
      if (!number.at_bound) continue;
      warnings.push_back(fmt::format(
          "{}: {} is at the bound of what can be believed ({}): a sign of physics that the model "
          "leaves out, or of a wrong belief",
          with_words(number.name), told(number), number.prior_source));
    }
  }
  for (int k = 0; k < f.data.layout.unknowns.count; ++k) {
    if (!f.data.unknowns[static_cast<std::size_t>(k)].simulated()) continue;
    const CalibratedNumber number = shared_number(f, k);
    if (number.at_bound || std::fabs(number.surprise) < kSurprise) continue;
    warnings.push_back(fmt::format(
        "{}: {} against the belief of {}: the recordings alone, without its prior, put it "
        "at {:.1f} standard deviations {} that belief; measure it{}",
        with_words(number.name), told(number), told_belief(number), std::fabs(number.surprise),
        number.surprise < 0 ? "below" : "above", confused_with(f, k)));
  }
  add_thickness_of_even_body(f, warnings);
  const Vector3d shift = f.found.state.shared.segment<3>(layout.registration.begin);
  const Vector3d turn = f.found.state.shared.segment<3>(layout.registration.begin + 3);
  const double metres = f.data.beliefs.shared_sd[layout.registration.begin];
  const double angle = f.data.beliefs.shared_sd[layout.registration.begin + 3];
  if (shift.norm() > 3 * metres || turn.norm() > 3 * angle) {
    warnings.push_back(fmt::format(
        "registration: the clouds are moved by {:.1f} mm ({:.1f}, {:.1f}, {:.1f}) and turned by "
        "{:.1f} deg about the camera, whose place is believed to {:.1f} mm and {:.1f} deg: "
        "register "
        "it again",
        1e3 * shift.norm(), 1e3 * shift.x(), 1e3 * shift.y(), 1e3 * shift.z(),
        turn.norm() / kDegree, 1e3 * metres, angle / kDegree));
  }
  for (const CalibratedNumber& number : result.nuisances) {
    if (number.name == "numerics.mesh" && std::fabs(number.pull) > 2.5) {
      warnings.emplace_back(
          "numerics.mesh: the recordings ask for another mesh: give a smaller --tolerance-mm");
    } else if (!number.recording.empty() && std::fabs(number.pull) > kOddPull) {
      warnings.push_back(fmt::format("{}: {}, {:.1f} standard deviations from what was believed",
                                     number.name, told(number), std::fabs(number.pull)));
    }
  }
  double worst = 0, floor = 0;
  for (const FitRow& row : result.fit) {
    if (row.role != "fitted") continue;
    worst = std::max(worst, row.rmse_model);
    floor = std::max(floor, row.floor);
  }
  if (worst > 3 * floor && worst > 0.002) {
    warnings.push_back(fmt::format(
        "the fit leaves {:.2f} mm where the sensor has {:.2f} mm: physics is missing, run "
        "mismatch explain",
        1e3 * worst, 1e3 * floor));
  }
  if (result.numerics_m > 0.5 * std::max(worst, 1e-9)) {
    warnings.push_back(fmt::format(
        "numerics: mesh, step and law may be off by {:.2f} mm, as much as the fit leaves",
        1e3 * result.numerics_m));
  }
}

void finish_scene(const Findings& f, Calibration& result) {
  pb::Scene& scene = result.scene;
  scene.mutable_tissue()->set_model(pb::TISSUE_ELASTIC);
  // The law stiffens with the square of a stretch that recordings do not reach and policies do: a
  // sheet pulled to twice its length slips out of the jaws (decision 0035). All laws are the same
  // at small strain.
  pb::Material& material = *scene.mutable_tissue()->mutable_material();
  if (material.law() == pb::LAW_ST_VENANT_KIRCHHOFF) {
    result.warnings.push_back(fmt::format(
        "scene.tissue.material.law: {} was fitted; scene.txtpb has the corotated law, the same at "
        "small strain: its force at the stretches that policies reach is a guess",
        law_name(material.law())));
    material.set_law(pb::LAW_COROTATED);
  }
  set_camera_errors(f.data, f.found.state, scene);
  // What is known now is the belief of whoever calibrates next.
  for (int k = 0; k < f.data.layout.unknowns.count; ++k) {
    const Unknown& unknown = f.data.unknowns[static_cast<std::size_t>(k)];
    if (!unknown.in_scene()) continue;
    pb::Prior& prior = *result.priors.add_prior();
    prior.set_path(unknown.path);
    if (unknown.scale == Unknown::Scale::kShift) {
      prior.set_sd(std::max(sd_of(f, k), 1e-4));
    } else {
      prior.set_factor(std::exp(std::max(sd_of(f, k), 1e-3)));
    }
    prior.set_source("mismatch calibrate");
  }
  scene.set_source("mismatch calibrate");
}

}  // namespace omentum

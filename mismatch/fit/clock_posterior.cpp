#include "mismatch/fit/clock_posterior.h"

#include <algorithm>
#include <cmath>
#include <functional>

namespace omentum {
namespace {

constexpr double kUnlikely = 4.5;  // of a log density below the largest: three standard deviations

/// All numbers but the clock fitted at one.
struct Node {
  double clock = 0, log_density = 0;
  FitState state;
  FitPosterior posterior;
};
using FitAt = std::function<Node(double clock, const FitState& from)>;

bool is_likely(const Node& node, const std::vector<Node>& nodes) {
  return node.log_density >
         std::ranges::max_element(nodes, {}, &Node::log_density)->log_density - kUnlikely;
}

/// Ever longer steps both ways until a clock is unlikely.
std::vector<Node> walk(const FitAt& fit_at, const Node& middle, double step, const Range& range) {
  constexpr double kLonger = 1.6;
  std::vector<Node> nodes = {middle};
  for (const double side : {-1.0, 1.0}) {
    Node last = middle;
    for (double by = step; is_likely(last, nodes); by *= kLonger) {
      const double clock = std::clamp(last.clock + side * by, range.low, range.high);
      if (clock == last.clock) break;
      last = fit_at(clock, last.state);
      nodes.push_back(last);
    }
  }
  std::ranges::sort(nodes, {}, &Node::clock);
  return nodes;
}

/// More places where the density falls steeply among likely ones.
void refine(const FitAt& fit_at, std::vector<Node>& nodes) {
  constexpr int kMost = 10;
  constexpr double kSteep = 1.5;  // of a log density, between neighbours
  for (int k = 0; k < kMost; ++k) {
    std::size_t worst = 0;
    double largest = kSteep;
    for (std::size_t i = 1; i < nodes.size(); ++i) {
      const double fall = std::fabs(nodes[i].log_density - nodes[i - 1].log_density);
      if (fall < largest || !(is_likely(nodes[i], nodes) || is_likely(nodes[i - 1], nodes)))
        continue;
      largest = fall;
      worst = i;
    }
    if (worst == 0) return;
    const Node &left = nodes[worst - 1], &right = nodes[worst];
    const FitState& from = (left.log_density > right.log_density ? left : right).state;
    const double clock = 0.5 * (left.clock + right.clock);
    nodes.insert(nodes.begin() + static_cast<std::ptrdiff_t>(worst), fit_at(clock, from));
  }
}

/// A fit that ended beside its best place is begun again where a neighbour's ended, both ways along
/// the clocks.
void even_out(const FitAt& fit_at, std::vector<Node>& nodes) {
  constexpr double kNoise = 0.2;  // of a log density
  const auto follow = [&](Node& node, const Node& neighbour) {
    if (!(neighbour.log_density > node.log_density + kNoise)) return;
    Node again = fit_at(node.clock, neighbour.state);
    if (again.log_density > node.log_density) node = std::move(again);
  };
  for (std::size_t i = 1; i < nodes.size(); ++i) follow(nodes[i], nodes[i - 1]);
  for (std::size_t i = nodes.size() - 1; i > 0; --i) follow(nodes[i - 1], nodes[i]);
}

/// How well the frames tell a clock at most [1/s^2]: each by how long the tissue takes there for
/// what it may be apart from the model (NoiseModel::along_motion).
double motion_information(const std::vector<Prediction>& predictions, const Which& which,
                          double along_motion) {
  double sum = 0;
  for (const std::size_t r : which) {
    for (const PredictedFrame& frame : predictions[r].frames) {
      double squares = 0;
      for (const Eigen::Vector3d& v : frame.velocity) squares += v.squaredNorm();
      if (frame.valid)
        sum += squares / static_cast<double>(frame.velocity.size()) / (along_motion * along_motion);
    }
  }
  return sum;
}

/// How far the surface of a frame, the one that moves most, is at one clock from where it is at
/// another [m, rms].
double moved_between(const std::vector<Prediction>& predictions, const Which& which,
                     double simulated_at, double clock, double other) {
  double most = 0;
  std::vector<Eigen::Vector3d> here, there, velocity;
  for (const std::size_t r : which) {
    for (const PredictedFrame& frame : predictions[r].frames) {
      if (!frame.valid) continue;
      move_in_time(frame, simulated_at - clock, here, velocity);
      move_in_time(frame, simulated_at - other, there, velocity);
      double squares = 0;
      for (std::size_t i = 0; i < here.size(); ++i) squares += (here[i] - there[i]).squaredNorm();
      most = std::max(most, squares / static_cast<double>(here.size()));
    }
  }
  return std::sqrt(most);
}

/// Mean and covariances over the clocks.
void mix(const std::vector<Node>& nodes, const std::vector<double>& weights, const Which& which,
         ClockPosterior& made) {
  made.state = nodes.front().state;
  made.posterior = nodes.front().posterior;
  Eigen::VectorXd& shared = made.state.shared;
  Eigen::MatrixXd& covariance = made.posterior.shared_covariance;
  shared.setZero();
  covariance.setZero();
  for (std::size_t k = 0; k < nodes.size(); ++k) shared += weights[k] * nodes[k].state.shared;
  for (std::size_t k = 0; k < nodes.size(); ++k) {
    const Eigen::VectorXd by = nodes[k].state.shared - shared;
    covariance += weights[k] * (nodes[k].posterior.shared_covariance + by * by.transpose());
  }
  for (std::size_t i = 0; i < which.size(); ++i) {
    Eigen::VectorXd& own = made.state.own[which[i]];
    own.setZero();
    for (std::size_t k = 0; k < nodes.size(); ++k) own += weights[k] * nodes[k].state.own[which[i]];
    Eigen::ArrayXd squares = Eigen::ArrayXd::Zero(own.size());
    for (std::size_t k = 0; k < nodes.size(); ++k) {
      squares += weights[k] * (nodes[k].posterior.own_sd[i].array().square() +
                               (nodes[k].state.own[which[i]] - own).array().square());
    }
    made.posterior.own_sd[i] = squares.sqrt();
  }
}

/// A short part of the line between two places, and how much of the whole is in it.
struct Piece {
  std::size_t left = 0;  ///< place before it
  double share = 0;      ///< of the way to the next
  double mass = 0;
};

std::vector<Piece> pieces_of(const KnownDensity& density) {
  constexpr int kParts = 100;  // between two places
  const double most = *std::ranges::max_element(density.log_density);
  std::vector<Piece> pieces;
  double whole = 0;
  for (std::size_t i = 0; i + 1 < density.x.size(); ++i) {
    const double a = density.log_density[i], b = density.log_density[i + 1];
    for (int k = 0; k < kParts; ++k) {
      const double share = (k + 0.5) / kParts;
      const double mass =
          std::exp(a + share * (b - a) - most) * (density.x[i + 1] - density.x[i]) / kParts;
      pieces.push_back({i, share, mass});
      whole += mass;
    }
  }
  for (Piece& piece : pieces) piece.mass /= whole;
  return pieces;
}

}  // namespace

std::vector<double> KnownDensity::weights() const {
  std::vector<double> list(x.size(), 0);
  for (const Piece& piece : pieces_of(*this)) {
    list[piece.left] += (1 - piece.share) * piece.mass;
    list[piece.left + 1] += piece.share * piece.mass;
  }
  return list;
}

double KnownDensity::quantile(double share) const {
  double sum = 0;
  for (const Piece& piece : pieces_of(*this)) {
    sum += piece.mass;
    if (sum >= share) return x[piece.left] + piece.share * (x[piece.left + 1] - x[piece.left]);
  }
  return x.back();
}

Range KnownDensity::shortest(double share) const {
  constexpr int kTried = 50;
  Range best{x.front(), x.back()};
  for (int k = 0; k <= kTried; ++k) {
    const double below = (1 - share) * k / kTried;
    const Range range{quantile(below), quantile(below + share)};
    if (range.high - range.low < best.high - best.low) best = range;
  }
  return best;
}

ClockPosterior integrate_clock(const FitData& data, const Linearisation& linear, const Which& which,
                               const SearchState& found, const FitPosterior& posterior) {
  constexpr double kFarthest = 3;  // standard deviations of the belief
  constexpr double kFirst = 0.6;   // of the standard deviation by curvature
  constexpr int kSteps = 8;        // of Gauss and Newton, from a neighbour
  const Scales& scales = found.scales;
  const FitAt fit_at = [&](double clock, const FitState& from) {
    Node node{clock, 0, {}, {}};
    SearchLimits limits;
    limits.held_clock = clock;
    node.state = improve(data, linear, which, kSteps, limits, {from, scales}).state;
    node.posterior = posterior_at(data, linear, which, limits, {node.state, scales});
    node.log_density =
        -cost_of(data, linear, which, node.state, scales) - 0.5 * node.posterior.log_determinant;
    return node;
  };
  const int k = data.layout.clock.begin;
  const double belief = data.beliefs.shared_sd[k];
  const Node middle = fit_at(found.state.shared[k], found.state);
  // Where the motion of all frames tells less than is believed, a clock at which no surface is
  // visibly elsewhere is as likely as this one: what fits differ by is how well they ended.
  const bool rests =
      motion_information(linear.predictions, which, scales.noise.along_motion) * belief * belief <
      1;
  const FitAt node_at = [&](double clock, const FitState& from) {
    if (!rests || moved_between(linear.predictions, which, linear.at.shared[k], middle.clock,
                                clock) > scales.noise.along_motion)
      return fit_at(clock, from);
    Node node = middle;
    node.clock = node.state.shared[k] = clock;
    node.log_density += 0.5 * (middle.clock * middle.clock - clock * clock) / (belief * belief);
    return node;
  };
  const double reach = std::min(kFarthest * belief, kTrajectoryReach);
  const Range range{std::max(-kFarthest * belief, linear.at.shared[k] - reach),
                    std::min(kFarthest * belief, linear.at.shared[k] + reach)};
  const double sd = std::min(std::sqrt(std::max(posterior.shared_covariance(k, k), 0.0)), belief);
  std::vector<Node> nodes = walk(node_at, middle, kFirst * sd, range);
  even_out(node_at, nodes);
  refine(node_at, nodes);
  even_out(node_at, nodes);
  KnownDensity density;
  for (const Node& node : nodes) {
    density.x.push_back(node.clock);
    density.log_density.push_back(node.log_density);
  }
  ClockPosterior made;
  mix(nodes, density.weights(), which, made);
  made.clock = density.shortest(0.9);
  return made;
}

}  // namespace omentum

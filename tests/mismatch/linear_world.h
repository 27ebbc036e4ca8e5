// Recordings of small linear worlds: rows y = J x + noise of sd 1, and their normal equations.
#pragma once

#include <Eigen/Core>
#include <Eigen/LU>
#include <algorithm>
#include <cmath>
#include <limits>
#include <random>
#include <string>
#include <vector>

#include "mismatch/evidence/evidence.h"

namespace omentum {

/// One recording by its rows; the last columns are atoms.
struct LinearRows {
  Eigen::MatrixXd J;
  Eigen::VectorXd y;
};

struct LinearWorld {
  std::vector<Evidence> recordings;
  std::vector<LinearRows> rows;
};

inline Evidence evidence_of(const LinearRows& rows, std::vector<Number> numbers, std::string name) {
  const auto count = static_cast<double>(rows.y.size());
  return {std::move(name), std::move(numbers), rows.J.transpose() * rows.J,
          rows.J.transpose() * rows.y,
          -rows.y.squaredNorm() / 2 - count / 2 * std::log(2 * std::acos(-1.0))};
}

struct WorldSize {
  int base = 3, numerics = 1, own = 2, atoms = 3, recordings = 7, rows = 60;
};

/// Numbers of recording `r`: base (the first free, others with sd 0.5), numerics of all recordings
/// (sd 1), own nuisances (sd 0.3), atoms (sd 10).
inline std::vector<Number> numbers_of(const WorldSize& size, int r) {
  const auto letter = [](const char* kind, int k) { return kind + std::to_string(k); };
  std::vector<Number> numbers;
  for (int k = 0; k < size.base; ++k) {
    Number& number = numbers.emplace_back();
    number.key = letter("base", k);
    if (k > 0) number.sd = 0.5;
  }
  for (int k = 0; k < size.numerics; ++k) {
    Number& number = numbers.emplace_back();
    number = {letter("numerics", k), "", NumberRole::kNumerics, 0, 1, "1"};
  }
  for (int k = 0; k < size.own; ++k) {
    Number& number = numbers.emplace_back();
    number = {letter("own", k), letter("recording", r), NumberRole::kNuisance, 0, 0.3, "m"};
  }
  for (int k = 0; k < size.atoms; ++k) {
    Number& number = numbers.emplace_back();
    number = {letter("atom", k), "", NumberRole::kAtom, 0, 10, "1"};
  }
  return numbers;
}

/// Rows are normal draws; atom 0 looks like base 0 in part, atom 2 like atom 1. `truth` of atoms.
inline LinearWorld draw_world(unsigned seed, const std::vector<double>& truth,
                              const WorldSize& size = {}) {
  std::mt19937 random(seed);
  std::normal_distribution<double> normal;
  const auto draw = [&]() { return normal(random); };
  LinearWorld world;
  for (int r = 0; r < size.recordings; ++r) {
    const std::vector<Number> numbers = numbers_of(size, r);
    const auto count = static_cast<Eigen::Index>(numbers.size());
    const Eigen::Index first = count - size.atoms;
    LinearRows rows{Eigen::MatrixXd::NullaryExpr(size.rows, count, draw), {}};
    rows.J.col(first) += 0.7 * rows.J.col(0);
    if (size.atoms > 2)
      rows.J.col(first + 2) = 0.8 * rows.J.col(first + 1) + 0.6 * rows.J.col(first + 2);
    Eigen::VectorXd x = Eigen::VectorXd::Constant(count, 0.2);
    x.segment(size.base + size.numerics, size.own) =
        0.3 * Eigen::VectorXd::NullaryExpr(size.own, draw);
    x.tail(size.atoms).setZero();
    for (std::size_t k = 0; k < truth.size(); ++k)
      x[first + static_cast<Eigen::Index>(k)] = truth[k];
    rows.y = rows.J * x + Eigen::VectorXd::NullaryExpr(size.rows, draw);
    world.recordings.push_back(evidence_of(rows, numbers, "recording" + std::to_string(r)));
    world.rows.push_back(rows);
  }
  return world;
}

/// Log density of the rows of all recordings with the numbers of each prior integrated and one atom
/// held, by the covariance of the rows; free numbers have a prior of sd 1e3 here.
inline double dense_log_density(const LinearWorld& world, const std::string& atom,
                                double amplitude) {
  Eigen::Index total = 0;
  for (const LinearRows& rows : world.rows) total += rows.y.size();
  Eigen::MatrixXd C = Eigen::MatrixXd::Identity(total, total);
  Eigen::VectorXd residual(total);
  Eigen::Index at = 0;
  for (std::size_t r = 0; r < world.rows.size(); ++r) {
    const auto& numbers = world.recordings[r].numbers;
    const Eigen::Index height = world.rows[r].y.size();
    residual.segment(at, height) = world.rows[r].y;
    for (std::size_t k = 0; k < numbers.size(); ++k) {
      const Eigen::VectorXd column = world.rows[r].J.col(static_cast<Eigen::Index>(k));
      if (numbers[k].role == NumberRole::kAtom) {
        if (numbers[k].key == atom) residual.segment(at, height) -= amplitude * column;
        continue;
      }
      const double sd = std::min(numbers[k].sd, 1e3);
      Eigen::Index beside = 0;
      for (std::size_t other = 0; other < world.rows.size(); ++other) {
        const Eigen::Index other_height = world.rows[other].y.size();
        if (other == r || numbers[k].owner.empty()) {
          C.block(at, beside, height, other_height) +=
              sd * sd * column * world.rows[other].J.col(static_cast<Eigen::Index>(k)).transpose();
        }
        beside += other_height;
      }
    }
    at += height;
  }
  const Eigen::PartialPivLU<Eigen::MatrixXd> lu(C);
  return -residual.dot(lu.solve(residual)) / 2 -
         lu.matrixLU().diagonal().array().abs().log().sum() / 2 -
         static_cast<double>(total) / 2 * std::log(2 * std::acos(-1.0));
}

}  // namespace omentum

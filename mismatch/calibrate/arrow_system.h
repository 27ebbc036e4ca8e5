#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "mismatch/calibrate/likelihood.h"

namespace omentum {

/// What is believed before the recordings: independent normal distributions.
struct Beliefs {
  Eigen::VectorXd shared_sd;  ///< [Layout::shared()], about 0
  Eigen::VectorXd own_sd;     ///< [Layout::own()], about 0, the same for every recording
};

/// One step of Gauss and Newton, and how sure it is.
struct ArrowStep {
  Eigen::VectorXd shared;            ///< change of the shared numbers
  std::vector<Eigen::VectorXd> own;  ///< of those of each block
  Eigen::MatrixXd shared_covariance;
  std::vector<Eigen::VectorXd> own_sd;  ///< standard deviations
  double log_determinant = 0;           ///< of the inverse of the covariance of all numbers
};

/// Shared numbers and those of one recording meet in that recording alone: the matrix has the shape
/// of an arrow, and each recording is eliminated by itself. `shared`, `own`: where the numbers
/// stand. `information`: what the blocks count for in the covariance. `fixed`: shared numbers that
/// the step leaves where they are; empty: none. The covariance does not know of them.
ArrowStep solve_arrow(std::span<const Block* const> blocks, const Layout& layout,
                      const Beliefs& beliefs, const Eigen::VectorXd& shared,
                      std::span<const Eigen::VectorXd> own, double information,
                      const std::vector<bool>& fixed = {});

/// Scale of Student's t: 1.4826 times the median of the deviations of all blocks; `least` where
/// there are none.
double robust_scale(std::span<const Block* const> blocks, std::vector<double> Block::*deviations,
                    double least);

/// What a weighted row is worth as information, against its weight: E[psi']^2 / (E[psi^2] E[w]) of
/// the deviations found [Huber81, chapter 3].
double row_information(std::span<const Block* const> blocks, const NoiseModel& noise);

}  // namespace omentum

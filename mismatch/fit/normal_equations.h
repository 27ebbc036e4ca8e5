#pragma once

#include <Eigen/Core>
#include <span>
#include <vector>

#include "mismatch/fit/likelihood.h"

namespace omentum {

/// What is believed before the recordings: independent normal distributions about 0.
struct Beliefs {
  Eigen::VectorXd shared_sd;  ///< [Layout::shared()]
  Eigen::VectorXd own_sd;     ///< [Layout::own()], the same for every recording
};

/// The normal approximation of a posterior: the step to its mean, and its covariance.
struct FitPosterior {
  Eigen::VectorXd shared_step;
  std::vector<Eigen::VectorXd> own_step;  ///< of each recording
  Eigen::MatrixXd shared_covariance;
  std::vector<Eigen::VectorXd> own_sd;  ///< standard deviations
  double log_determinant = 0;           ///< of the inverse of the covariance of all numbers
};

/// Shared numbers and those of one recording meet in that recording alone: the own ones are
/// eliminated recording by recording (Schur complement). `shared`, `own`: where the numbers stand.
/// `information`: what the rows count for in the covariance. `fixed`: shared numbers that the step
/// leaves where they are; empty: none. The covariance does not know of them.
FitPosterior solve_normal_equations(std::span<const NormalEquations> recordings,
                                    const Layout& layout, const Beliefs& beliefs,
                                    const Eigen::VectorXd& shared,
                                    std::span<const Eigen::VectorXd> own, double information,
                                    const std::vector<bool>& fixed = {});

/// Scale of Student's t: 1.4826 times the median of the deviations of all recordings; `least` where
/// there are none.
double robust_scale(std::span<const NormalEquations> recordings,
                    std::vector<double> NormalEquations::*deviations, double least);

/// What a weighted row is worth as information, against its weight: E[psi']^2 / (E[psi^2] E[w]) of
/// the deviations found [Huber81, chapter 3].
double row_information(std::span<const NormalEquations> recordings, const NoiseModel& noise);

/// What of the frames of markers is worth as much as if they were independent: what is left of one
/// is like that of the frame before.
double independent_share(std::span<const NormalEquations> recordings);

}  // namespace omentum

#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/catalogue/effect_names.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// An amplitude of an effect at one place that may have been left out: an atom of the evidence,
/// held at zero (docs/mismatch.md 5.6).
struct Candidate {
  std::string effect;   ///< name of docs/mismatch.md 4
  std::string key;      ///< unique; begins with the effect and its number
  std::string column;   ///< its derivative (sim_worker/playback/parameters.h); empty: the next two
  int pinch_axis = -1;  ///< its column is that of the place of the pinch along x_B or y_B
  /// It is simulated at this amplitude, and its column is the difference over it: what begins only
  /// somewhere on the way has no derivative at zero. 0: it has one.
  double secant = 0;
  std::string unit;                           ///< of the amplitude
  double sd = 1;                              ///< of the amplitude before anything is seen: wide
  bool one_sided = false;                     ///< below zero it is nothing
  std::optional<Eigen::Vector2d> place = {};  ///< x_B, y_B [m]
  double size = 0;                            ///< radius or half size of its place [m]
  /// Beside the place, what else it begins at: the angle of fibres [rad], a relaxation time [s],
  /// the height of an obstacle's nearest point [m], a force from which jaws slip [N].
  double setting = 0;
};

/// A number of an effect as a search steps it: the value, or its logarithm.
struct EffectNumber {
  std::string name;  ///< of docs/mismatch.md 4; x and y are its place in B
  std::string unit;
  bool log = false;
  double start = 0;         ///< value
  double step = 0, sd = 1;  ///< of the value or its logarithm: a difference; a belief about `start`
  double low = 0, high = 0;  ///< of the value

  double value(double searched) const;
  double searched(double value) const;
};

/// Effects and their places on the sheet of a scene that have columns, but for those that are ruled
/// out by name.
std::vector<Candidate> candidates_of(const Scene& scene, const std::vector<std::string>& ruled_out);

/// Numbers of the effect in the base that begin at these amplitudes of it and its companions, at
/// `place` where it has one. Companions are candidates of the same effect without a place that
/// belong to it as further axes.
std::vector<EffectNumber> effect_numbers(const Candidate& candidate,
                                         const std::vector<Candidate>& candidates,
                                         const std::vector<double>& amplitudes,
                                         const std::optional<Eigen::Vector2d>& place,
                                         const Scene& scene);
/// The candidate and its companions, in the order of `candidates`.
std::vector<Candidate> with_companions(const Candidate& candidate,
                                       const std::vector<Candidate>& candidates);

/// The effect with these values of effect_numbers().
NamedEffect effect_of(const Candidate& candidate, const std::vector<EffectNumber>& numbers,
                      const std::vector<double>& values, const Scene& scene);

/// A candidate that is simulated, with its amplitude `secant`.
NamedEffect secant_effect(const Candidate& candidate, const Scene& scene);

}  // namespace omentum

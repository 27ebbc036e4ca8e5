#pragma once

#include <Eigen/Core>
#include <optional>
#include <string>
#include <vector>

#include "mismatch/catalogue/effect_names.h"
#include "sim_worker/scene/scene.h"

namespace omentum {

/// A number of an effect at one place that may have been left out: an atom of the evidence, held at
/// zero (docs/mismatch.md 5.6).
struct Candidate {
  std::string effect;   ///< name of docs/mismatch.md 4
  std::string key;      ///< unique; begins with the effect and its number
  std::string column;   ///< its derivative (sim_worker/playback/parameters.h); empty: `pinch_axis`
  int pinch_axis = -1;  ///< else its column is that of the place of the pinch along x_B or y_B
  std::string unit;     ///< of the amplitude
  double sd = 1;        ///< of the amplitude before anything is seen: wide
  bool one_sided = false;                     ///< below zero it is nothing
  std::optional<Eigen::Vector2d> place = {};  ///< x_B, y_B [m]
  double size = 0;                            ///< radius or half size of its place [m]
};

/// Effects and their places on the sheet of a scene, but for those that are ruled out by name.
std::vector<Candidate> candidates_of(const Scene& scene, const std::vector<std::string>& ruled_out);

/// The effect with an amplitude, at `place` where it has one.
NamedEffect effect_of(const Candidate& candidate, double amplitude,
                      const std::optional<Eigen::Vector2d>& place, const Scene& scene);

}  // namespace omentum

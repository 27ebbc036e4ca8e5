#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <string>
#include <vector>

namespace omentum {

/// What the tool was told to do in a recording: the path of the jaw tip T and the jaw.
struct ToolTrack {
  std::vector<double> time;           ///< [s], increasing
  std::vector<Eigen::Vector3d> p_WT;  ///< commanded jaw tip in W [m]
  std::vector<double> jaw_rad;        ///< full opening angle commanded; empty = not recorded
  std::string path;                   ///< of the table or file it was read from
  std::vector<std::uint32_t> lines;   ///< of each row in the table; empty: it is no table

  double begin() const { return time.front(); }
  double end() const { return time.back(); }
  /// Linear between rows, constant before the first and after the last.
  Eigen::Vector3d tip_at(double t) const;
  /// Of the last row at or before t (a jaw command is a step).
  double jaw_at(double t) const;
  /// How far the tip goes from where it begins [m].
  double travel() const;
  /// "path:line" of a row, or "path: at 1.2 s".
  std::string place(std::size_t row) const;
};

}  // namespace omentum

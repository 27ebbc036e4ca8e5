#pragma once

namespace omentum {

/// Smooth difference between model and tissue, along the surface's normal: cosines along the sides
/// of the sheet, each times four functions of time (discrepancy_in_time()).
inline constexpr int kTimeFunctions = 4;

/// Columns of the normal equations of a recording, by name: the numbers that all recordings share,
/// then those that this one has of its own. Offsets of markers are three numbers each.
struct Layout {
  /// Numbers that belong together. `own()` of a Layout says where they stand among the own ones.
  struct Columns {
    int begin = 0, count = 0;
    int end() const { return begin + count; }
  };
  Columns unknowns;      ///< what the simulation depends on, and further columns
  Columns registration;  ///< shift, then turn of the camera
  Columns clock;         ///< of the camera, common to all
  Columns markers;
  Columns pinch;             ///< held patch from the tip, x_B, y_B
  Columns stiffness_factor;  ///< logarithm of a factor on E
  Columns own_clock;         ///< beside the common one
  Columns force_zero, force_gain;
  Columns held_place;  ///< where the body was held at the start; none unless it was
  Columns modes;       ///< of the smooth difference: all cosines for each function of time

  Layout() : Layout(0, 0, 0, 0) {}
  Layout(int unknown_count, int marker_count, int held_count, int cosine_count);

  int shared() const { return markers.end(); }
  int size() const { return modes.end(); }
  int own() const { return size() - shared(); }
  /// Of a marker, the first of its three.
  int marker(int k) const { return markers.begin + 3 * k; }
  /// Of the smooth difference, times one function of time.
  int cosines() const { return modes.count / kTimeFunctions; }
  /// Place of an own column among the own ones.
  int among_own(const Columns& columns) const { return columns.begin - shared(); }
};

inline Layout::Layout(int unknown_count, int marker_count, int held_count, int cosine_count) {
  int next = 0;
  const auto place = [&](Columns& columns, int count) {
    columns = {next, count};
    next += count;
  };
  place(unknowns, unknown_count);
  place(registration, 6);
  place(clock, 1);
  place(markers, 3 * marker_count);
  place(pinch, 2);
  place(stiffness_factor, 1);
  place(own_clock, 1);
  place(force_zero, 3);
  place(force_gain, 1);
  place(held_place, held_count);
  place(modes, kTimeFunctions * cosine_count);
}

}  // namespace omentum

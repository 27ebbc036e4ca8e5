#include <fmt/format.h>

#include "mismatch/intake/intake.h"

namespace omentum {
namespace {

std::string shown_unit(const std::string& unit) { return unit.empty() ? "(share)" : unit; }

}  // namespace

std::string print_intake(const IntakeFigures& figures) {
  std::string text;
  for (const SamplingFigures& s : figures.sampling) {
    text +=
        fmt::format("  /{}: {} samples, {:.6g} ... {:.6g} s", s.topic, s.rows, s.begin_s, s.end_s);
    if (s.period_s > 0) text += fmt::format(", {:.4g} Hz", 1 / s.period_s);
    if (s.gaps > 0) text += fmt::format(", {} gaps up to {:.3g} s", s.gaps, s.longest_gap_s);
    text += '\n';
  }
  for (const ClockFigures& c : figures.clocks) {
    text += fmt::format("  clock of /{}: {:+.1f} +- {:.1f} ms against /{} (correlation {:.3f})",
                        c.topic, 1e3 * c.offset_s, 1e3 * c.sd_s, c.reference, c.correlation);
    if (c.drift_sd_ppm > 0)
      text += fmt::format(", drift {:+.0f} +- {:.0f} ppm", c.drift_ppm, c.drift_sd_ppm);
    text += '\n';
  }
  for (const NoiseFigures& n : figures.noise) {
    text += fmt::format("  noise of /{}: {:.3g} {} in {} {}", n.topic, n.sd, shown_unit(n.unit),
                        n.windows, n.in_holds ? "holds" : "quiet stretches");
    if (n.correlation_s > 0) text += fmt::format(", correlated over {:.2g} s", n.correlation_s);
    if (n.outliers > 0) text += fmt::format(", {} outliers", n.outliers);
    text += '\n';
  }
  for (const ClippedFigures& c : figures.clipped)
    text += fmt::format("  {} stays at {:.6g} in {} stretches, {} samples: clipped?\n", c.column,
                        c.value, c.stretches, c.rows);
  return text;
}

std::string print_floor(const std::vector<FloorFigures>& floor) {
  std::string text;
  for (const FloorFigures& f : floor)
    text +=
        fmt::format("  floor of /{}{}: {:.3g} {} rms of {} repeats, largest difference {:.3g} {}\n",
                    f.topic, f.less.empty() ? "" : " less " + f.less, f.rms, shown_unit(f.unit),
                    f.repeats, f.largest, shown_unit(f.unit));
  return text;
}

}  // namespace omentum

#include "core/psm_instrument.h"

#include <fmt/format.h>

#include <vector>

#include "core/check.h"

namespace omentum {
namespace {

constexpr double kClassicLength = 0.4162;
constexpr double kSiLength = 0.4670;

/// What a family of instruments has in common.
struct Wrist {
  double pitch_to_yaw;
  double roll, pitch, yaw;  ///< +- [rad]
  double jaw_effort;
  std::array<double, 16> joints_of_discs;
};

constexpr Wrist kDriverWrist = {
    0.0091,
    4.53786,
    1.39626,
    1.39626,
    0.16,
    {-1.5632, 0, 0, 0, 0, 1.0186, 0, 0, 0, -0.8306, 0.6089, 0.6089, 0, 0, -1.2177, 1.2177}};
constexpr Wrist kProGraspWrist = {
    0.0107,  4.53786,
    1.39626, 1.39626,
    0.16,    {-1.5631, 0, 0, 0, 0, 1, 0, 0, 0, -0.5068, -0.5135, -0.5135, 0, 0, -0.5279, 0.5279}};
constexpr Wrist kBipolarWrist = {
    0.0107,
    4.4506,
    1.2217,
    1.5708,
    0.19,
    {-1.563233, 0, 0, 0, 0, 1, 0, 0, 0, -0.630273, 0.457982, 0.457982, 0, 0, -0.915964, 0.915964}};

constexpr double kWideJaw = -0.698;
constexpr double kNarrowJaw = -0.349;

constexpr PsmInstrument make(const char* name, const char* number, double length,
                             const Wrist& wrist, double jaw_min) {
  return {name,
          number,
          length,
          wrist.pitch_to_yaw,
          {{{"yaw", -1.588, 1.588},
            {"pitch", -0.925025, 0.925025},
            {"insertion", 0.0, 0.24},
            {"roll", -wrist.roll, wrist.roll},
            {"wrist_pitch", -wrist.pitch, wrist.pitch},
            {"wrist_yaw", -wrist.yaw, wrist.yaw}}},
          {"jaw", jaw_min, 1.396},
          {3.316, 3.316, 9.878, 0.33, 0.25, 0.20},
          wrist.jaw_effort,
          wrist.joints_of_discs};
}

constexpr std::array<PsmInstrument, 12> kInstruments = {{
    make("large_needle_driver", "400006", kClassicLength, kDriverWrist, kWideJaw),
    make("large_needle_driver_si", "420006", kSiLength, kDriverWrist, kNarrowJaw),
    make("cadiere", "400049", kClassicLength, kDriverWrist, kNarrowJaw),
    make("cadiere_si", "420049", kSiLength, kDriverWrist, kNarrowJaw),
    make("debakey", "400036", kClassicLength, kDriverWrist, kNarrowJaw),
    make("debakey_si", "420036", kSiLength, kDriverWrist, kNarrowJaw),
    make("prograsp", "400093", kClassicLength, kProGraspWrist, kNarrowJaw),
    make("prograsp_si", "420093", kSiLength, kProGraspWrist, kNarrowJaw),
    make("fenestrated_bipolar", "400205", kClassicLength, kBipolarWrist, kWideJaw),
    make("fenestrated_bipolar_si", "420205", kSiLength, kBipolarWrist, kWideJaw),
    make("maryland_bipolar", "400172", kClassicLength, kBipolarWrist, kNarrowJaw),
    make("maryland_bipolar_si", "420172", kSiLength, kBipolarWrist, kNarrowJaw),
}};

}  // namespace

Eigen::Matrix4d PsmInstrument::disc_coupling() const {
  return Eigen::Map<const Eigen::Matrix<double, 4, 4, Eigen::RowMajor>>(joints_of_discs.data());
}

std::span<const PsmInstrument> psm_instruments() { return kInstruments; }

const PsmInstrument& large_needle_driver() { return kInstruments[0]; }

const PsmInstrument& find_instrument(std::string_view name) {
  std::vector<std::string> names;
  for (const PsmInstrument& instrument : kInstruments) {
    if (name == instrument.name || name == instrument.number) return instrument;
    names.push_back(fmt::format("{} ({})", instrument.name, instrument.number));
  }
  throw_error("instrument: {}, allowed: {}", name, fmt::join(names, ", "));
}

}  // namespace omentum

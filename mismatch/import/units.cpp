#include "mismatch/import/units.h"

#include <fmt/format.h>

#include <array>

#include "core/constants.h"
#include "core/table.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

struct Unit {
  std::string_view name, si;
  double factor;
};
constexpr double kGramForce = 9.80665e-3;  // [N] CGPM 1901
constexpr double kInch = 0.0254;           // [m] by definition
constexpr std::array<Unit, 39> kUnits = {{{"m", "m", 1},
                                          {"cm", "m", 1e-2},
                                          {"mm", "m", 1e-3},
                                          {"um", "m", 1e-6},
                                          {"in", "m", kInch},
                                          {"s", "s", 1},
                                          {"ms", "s", 1e-3},
                                          {"us", "s", 1e-6},
                                          {"ns", "s", 1e-9},
                                          {"min", "s", 60},
                                          {"rad", "rad", 1},
                                          {"mrad", "rad", 1e-3},
                                          {"deg", "rad", kDegree},
                                          {"turn", "rad", 2 * kPi},
                                          {"N", "N", 1},
                                          {"mN", "N", 1e-3},
                                          {"kN", "N", 1e3},
                                          {"gf", "N", kGramForce},
                                          {"Nm", "Nm", 1},
                                          {"Nmm", "Nm", 1e-3},
                                          {"Ncm", "Nm", 1e-2},
                                          {"mNm", "Nm", 1e-3},
                                          {"Pa", "Pa", 1},
                                          {"kPa", "Pa", 1e3},
                                          {"MPa", "Pa", 1e6},
                                          {"bar", "Pa", 1e5},
                                          {"kg", "kg", 1},
                                          {"g", "kg", 1e-3},
                                          {"Hz", "Hz", 1},
                                          {"m_per_s", "m_per_s", 1},
                                          {"mm_per_s", "m_per_s", 1e-3},
                                          {"rad_per_s", "rad_per_s", 1},
                                          {"deg_per_s", "rad_per_s", kDegree},
                                          {"rpm", "rad_per_s", kPi / 30},
                                          {"m2", "m2", 1},
                                          {"cm2", "m2", 1e-4},
                                          {"mm2", "m2", 1e-6},
                                          {"percent", "", 1e-2},
                                          {"", "", 1}}};

}  // namespace

Result<UnitFactor> find_unit(std::string_view unit) {
  std::string known;
  for (const Unit& u : kUnits) {
    if (u.name == unit) return UnitFactor{u.si, u.factor};
    known += u.name.empty() ? "" : fmt::format(" {}", u.name);
  }
  return Failure{fmt::format("unit \"{}\" is not known, allowed{}", shown(unit), known)};
}

std::string_view unit_of_column(std::string_view column) {
  for (const std::string_view si : {"m_per_s", "rad_per_s", "m", "s", "rad", "N", "Nm", "Pa"}) {
    if (column.size() > si.size() && column.ends_with(si) &&
        column[column.size() - si.size() - 1] == '_')
      return si;
  }
  return "";
}

Result<double> factor_to_column(std::string_view unit, std::string_view column) {
  const Result<UnitFactor> found = find_unit(unit);
  if (!found) return Failure{found.error()};
  const std::string_view wanted = unit_of_column(column);
  if (found.value().si == wanted) return found.value().factor;
  return Failure{fmt::format("unit {} of column {}, which is in {}", unit, shown(column),
                             wanted.empty() ? "no unit" : wanted)};
}

}  // namespace omentum

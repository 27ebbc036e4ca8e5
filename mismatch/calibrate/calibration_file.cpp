#include "mismatch/calibrate/calibration_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "mismatch/calibrate/number_words.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

using Json = nlohmann::ordered_json;

/// Ten digits: no more is known, and the last bits are no message.
Json number(double value) {
  if (!std::isfinite(value)) return nullptr;
  return std::stod(fmt::format("{:.10g}", value));
}

Json json_of(const CalibratedNumber& n) {
  return {{"name", n.name},
          {"unit", n.unit},
          {"value", number(n.value)},
          {"low90", number(n.low90)},
          {"high90", number(n.high90)},
          {"prior",
           {{"value", number(n.prior_value)},
            {"low90", number(n.prior_low90)},
            {"high90", number(n.prior_high90)},
            {"source", n.prior_source}}},
          {"at_bound", n.at_bound}};
}

}  // namespace

std::string print_calibration(const Calibration& c) {
  Json json;
  json["format_version"] = 1;
  json["method"] = c.method;
  json["parameters"] = Json::array();
  for (const CalibratedNumber& n : c.parameters) json["parameters"].push_back(json_of(n));
  json["groups"] = Json::array();
  for (const NumberGroup& g : c.groups) {
    json["groups"].push_back({{"name", g.name},
                              {"unit", g.unit},
                              {"value", number(g.value)},
                              {"low90", number(g.low90)},
                              {"high90", number(g.high90)},
                              {"members", g.members},
                              {"text", g.text}});
  }
  json["nuisances"] = Json::array();
  for (const CalibratedNumber& n : c.nuisances) json["nuisances"].push_back(json_of(n));
  json["fit"] = Json::array();
  for (const FitRow& row : c.fit) {
    Json entry = {{"recording", row.recording},
                  {"role", row.role},
                  {"rmse_base", number(row.rmse_base)},
                  {"rmse_model", number(row.rmse_model)},
                  {"floor", number(row.floor)},
                  {"mean_model", number(row.mean_model)},
                  {"far", number(row.far)}};
    if (row.paper > 0) entry["paper"] = number(row.paper);
    json["fit"].push_back(std::move(entry));
  }
  json["laws"] = Json::array();
  for (const LawRow& row : c.laws) {
    Json parameters = Json::array();
    for (const auto& [path, value] : row.parameters)
      parameters.push_back({{"name", path}, {"value", number(value)}});
    json["laws"].push_back(
        {{"law", row.law}, {"behind", number(row.behind)}, {"parameters", std::move(parameters)}});
  }
  json["numerics_m"] = number(c.numerics_m);
  json["warnings"] = c.warnings;
  json["core_seconds"] = std::round(10 * c.core_seconds) / 10;
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

std::string summarise_calibration(const Calibration& c) {
  std::string text = c.parameters.empty() ? "" : "with intervals of 90 %:\n";
  for (const CalibratedNumber& n : c.parameters) {
    text += fmt::format("{}: {}{}\n", with_words(n.name), told(n),
                        n.unseen ? ", as believed: the recordings do not see it" : "");
  }
  for (const NumberGroup& g : c.groups) {
    if (g.name == "unseen") continue;
    text += fmt::format("seen together only: {} = {}\n", g.name,
                        number_in_line(g.value, g.low90, g.high90, g.unit));
  }
  for (const LawRow& row : c.laws) {
    text += row.behind == 0 ? fmt::format("law of elasticity: {}\n", row.law)
                            : fmt::format("law of {}: log likelihood {} by {:.1f}\n", row.law,
                                          row.behind > 0 ? "less" : "more", std::fabs(row.behind));
  }
  for (const std::string role : {"fitted", "left_out", "held_out"}) {
    double base = 0, model = 0, mean = 0, floor = 0, count = 0;
    for (const FitRow& row : c.fit) {
      if (row.role != role || !std::isfinite(row.rmse_model + row.rmse_base)) continue;
      base += row.rmse_base * row.rmse_base;
      model += row.rmse_model * row.rmse_model;
      floor += row.floor * row.floor;
      mean += row.mean_model;
      ++count;
    }
    if (count == 0) continue;
    text += fmt::format(
        "{}: {:.3f} mm rms from point to surface ({:.3f} mm mean), {:.3f} mm before, {:.3f} mm of "
        "it noise of the sensor\n",
        role == "left_out" ? "pinch points left out in turn"
        : role == "fitted" ? "fitted"
                           : "held out",
        1e3 * std::sqrt(model / count), 1e3 * mean / count, 1e3 * std::sqrt(base / count),
        1e3 * std::sqrt(floor / count));
  }
  text += fmt::format("numerics: {:.3f} mm rms", 1e3 * c.numerics_m);
  for (const std::string& part : c.numerics) text += ", " + part;
  return text + "\n";
}

}  // namespace omentum

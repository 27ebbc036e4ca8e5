#include "mismatch/intake/intake_json.h"

namespace omentum {

using Json = nlohmann::ordered_json;

Json intake_json(const IntakeFigures& figures) {
  Json made = {{"channels", Json::array()},
               {"clocks", Json::array()},
               {"noise", Json::array()},
               {"clipped", Json::array()}};
  for (const SamplingFigures& s : figures.sampling)
    made["channels"].push_back({{"topic", s.topic},
                                {"samples", s.rows},
                                {"begin_s", s.begin_s},
                                {"end_s", s.end_s},
                                {"period_s", s.period_s},
                                {"gaps", s.gaps},
                                {"longest_gap_s", s.longest_gap_s}});
  for (const ClockFigures& c : figures.clocks)
    made["clocks"].push_back({{"topic", c.topic},
                              {"reference", c.reference},
                              {"offset_s", c.offset_s},
                              {"sd_s", c.sd_s},
                              {"drift_ppm", c.drift_ppm},
                              {"drift_sd_ppm", c.drift_sd_ppm},
                              {"correlation", c.correlation}});
  for (const NoiseFigures& n : figures.noise)
    made["noise"].push_back({{"topic", n.topic},
                             {"unit", n.unit},
                             {"sd", n.sd},
                             {"windows", n.windows},
                             {"in_holds", n.in_holds},
                             {"correlation_s", n.correlation_s},
                             {"outliers", n.outliers}});
  for (const ClippedFigures& c : figures.clipped)
    made["clipped"].push_back({{"column", c.column},
                               {"value", c.value},
                               {"samples", c.rows},
                               {"stretches", c.stretches}});
  return made;
}

Json floor_json(const std::vector<FloorFigures>& floor) {
  Json made = Json::array();
  for (const FloorFigures& f : floor)
    made.push_back({{"topic", f.topic},
                    {"unit", f.unit},
                    {"less", f.less},
                    {"repeats", f.repeats},
                    {"rms", f.rms},
                    {"largest", f.largest}});
  return made;
}

}  // namespace omentum

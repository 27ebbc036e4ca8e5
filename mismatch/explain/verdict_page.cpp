#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "mismatch/calibrate/number_words.h"
#include "mismatch/explain/explain.h"
#include "mismatch/explain/verdict_words.h"
#include "report/html.h"
#include "report/plot.h"
#include "report/replay3d.h"
#include "report/section_parts.h"

namespace omentum {
namespace {

using TableRows = std::vector<std::vector<std::string>>;

/// Distance of neighbouring places along an axis; none where all are at one.
std::optional<double> distance_along(std::vector<double> places) {
  constexpr double kSame = 1e-6;  // [mm]
  std::ranges::sort(places);
  std::optional<double> least;
  for (std::size_t k = 1; k < places.size(); ++k) {
    const double apart = places[k] - places[k - 1];
    if (apart > kSame && (!least || apart < *least)) least = apart;
  }
  return least;
}

/// Cells as wide and as high as places are apart, so that none covers another and no gap is left.
void set_cells(PlaneMap& map) {
  constexpr double kAlone = 5;  // [mm]
  const std::optional<double> x = distance_along(map.x), y = distance_along(map.y);
  map.cell_x = x.value_or(y.value_or(kAlone));
  map.cell_y = y.value_or(map.cell_x);
}

/// Scores of an effect over its places; empty where it has none.
std::string map_of(const pb::Verdict& verdict, const std::string& effect) {
  PlaneMap map;
  double most = 0;  // with its sign: what is softer at one place is stiffer beside it
  for (const pb::VerdictScore& score : verdict.scores()) {
    if (score.effect() != effect || score.place_m_size() != 2) continue;
    map.x.push_back(1e3 * score.place_m(0));
    map.y.push_back(1e3 * score.place_m(1));
    map.value.push_back(score.z());
    if (std::fabs(score.z()) <= std::fabs(most)) continue;
    map.best = map.value.size() - 1;
    most = score.z();
  }
  if (map.value.size() < 4) return "";
  for (double& z : map.value) z = std::max(0.0, most < 0 ? -z : z);
  map.title = effect + ": where it would explain most";
  map.x_label = "x_B, mm";
  map.y_label = "y_B, mm";
  map.scale_label = most < 0 ? "-z" : "z";
  set_cells(map);
  map.high = std::ceil(std::max(std::fabs(most), 1.0));
  map.best_label = "best place";
  return card(draw_plane_map(map));
}

std::string error_bars(const pb::Verdict& verdict) {
  TableRows rows = {{"recording", "role", "before, mm", "after, mm", "noise floor, mm",
                     "share of the misfit left", "shell before", "shell after"}};
  for (const pb::VerdictFit& row : verdict.fit()) {
    rows.push_back({row.recording(), row.role() == "held_out" ? "held out" : row.role(),
                    mm(row.rmse_base()), mm(row.rmse_model()), mm(row.floor()),
                    row.has_r() ? percent(row.r()) : "no misfit",
                    row.has_rmse_shell_base() ? mm(row.rmse_shell_base()) : "",
                    row.has_rmse_shell_model() ? mm(row.rmse_shell_model()) : ""});
  }
  return card(make_table(rows, {2, 3, 4, 5, 6, 7}));
}

std::string limits_table(const pb::Verdict& verdict) {
  TableRows rows = {{"effect", "would be seen from", "at any place from", "named from",
                     "two correct models differ by", "by", "most similar effect"}};
  for (const pb::VerdictLimit& row : verdict.detection_limits()) {
    const std::string words = limit_words(row);
    const std::string name = row.effect() + (words.empty() ? "" : ", " + words);
    if (!row.testable()) {
      rows.push_back({name, "never", "", "", "", row.why_not(), ""});
      continue;
    }
    rows.push_back({name, least_size(row.amplitude(), row), anywhere_text(row),
                    least_size(row.amplitude_named(), row), least_size(row.floor_amplitude(), row),
                    nuisance_words(row.floor_from()), key_text(row.look_alike())});
  }
  return card(make_table(rows, {1, 2, 3, 4}));
}

/// Rivals that were refitted by simulations, then what columns alone claim.
std::string rivals_tables(const pb::Verdict& verdict) {
  TableRows refitted = {{"refitted by simulations", "gain, nats", "numbers"}};
  TableRows claimed = {
      {"by its columns", "gain, nats", "leaves to others, nats", "alone it is enough"}};
  for (const pb::VerdictRival& rival : verdict.rivals()) {
    const std::string gain = nats(rival.gain());
    if (rival.simulated()) {
      refitted.push_back({rival.name(), gain, numbers_of(rival)});
      continue;
    }
    std::string left;
    for (const pb::VerdictLeft& other : rival.left()) {
      if (other.gain() < 1) continue;
      left += fmt::format("{}{}: {}", left.empty() ? "" : "; ", key_text(other.name()),
                          nats(other.gain()));
    }
    claimed.push_back({key_text(rival.key()), gain, left.empty() ? "nothing" : left,
                       rival.adequate() ? "yes" : "no"});
  }
  std::string html;
  for (const TableRows& rows : {refitted, claimed}) {
    if (rows.size() > 1) html += card(make_table(rows, {1}));
  }
  return html;
}

/// Where the error is, which is not where its cause is.
std::string residual_maps(const ResidualMap& residuals) {
  constexpr double kRound = 0.1;  // [mm] so that the numbers beside the scale are short
  std::string html;
  for (const auto& [values, when] :
       {std::pair{&residuals.at_rest, "at rest"}, {&residuals.lifted, "lifted"}}) {
    PlaneMap map;
    double most = 0;
    for (std::size_t p = 0; p < residuals.places.size(); ++p) {
      if (!std::isfinite((*values)[p])) continue;
      map.x.push_back(1e3 * residuals.places[p].x());
      map.y.push_back(1e3 * residuals.places[p].y());
      map.value.push_back(1e3 * std::fabs((*values)[p]));
      if (map.value.back() > most) {
        most = map.value.back();
        map.best = map.value.size() - 1;
      }
    }
    if (map.value.size() < 4) continue;
    map.title = fmt::format("{}: where the error is, not its cause", when);
    map.x_label = "x_B, mm";
    map.y_label = "y_B, mm";
    map.scale_label = "mm";
    set_cells(map);
    map.high = std::max(std::ceil(most / kRound) * kRound, kRound);
    map.best_label = "largest";
    html += card(draw_plane_map(map));
  }
  return html;
}

std::string list_of(const google::protobuf::RepeatedPtrField<std::string>& lines) {
  std::string html = "<ul>";
  for (const std::string& line : lines) html += "<li>" + escape_html(line) + "</li>";
  return html + "</ul>";
}

std::string viewer(const Explanation& found, const std::string& folder) {
  std::vector<SurfaceReplay> replays;
  for (const PredictedRecording& r : found.predictions) {
    if (r.times.empty()) continue;
    for (const bool after : {false, true}) {
      SurfaceReplay replay;
      replay.label = fmt::format("{}: {}", r.name, after ? "after" : "before");
      replay.times = r.times;
      replay.vertices = after ? r.model : r.base;
      replay.clouds = r.seen;
      replay.tips = r.tips;
      replay.notes.assign(r.times.size(), "");
      replays.push_back(std::move(replay));
    }
  }
  return make_surface_markup(make_scene(found.scene, folder), found.triangles, replays);
}

std::string when_table(const pb::VerdictEffect& effect) {
  if (effect.when_size() == 0) return "";
  TableRows rows = {{"recording", "phases that gain by it", "from, s", "90 % from", "to"}};
  for (const pb::VerdictWhen& when : effect.when()) {
    const auto seconds = [](double t) { return fmt::format("{:.2f}", t); };
    rows.push_back({when.recording(), fmt::format("{}", fmt::join(when.phases(), ", ")),
                    seconds(when.onset_s().value()), seconds(when.onset_s().low90()),
                    seconds(when.onset_s().high90())});
  }
  return card(make_table(rows, {2, 3, 4}));
}

std::string effect_table(const pb::VerdictEffect& effect) {
  TableRows rows = {{"number", "value", "90 % from", "to"}};
  for (const pb::VerdictParameter& p : effect.parameters()) {
    const ShownNumber number = shown(p);
    rows.push_back({named(effect.class_().members(0).name(), p.name()), number.value + number.unit,
                    number.low + number.unit, number.high + number.unit});
  }
  std::string html = make_table(rows, {1, 2, 3});
  html += "<p>" +
          escape_html(fmt::format("Gain {} nats. {}", nats(effect.gain()),
                                  effect.confirmed()
                                      ? "Recordings that were held out confirm it."
                                      : "Not confirmed: " + effect.why_not_confirmed() + ".")) +
          "</p>";
  for (const std::string& recording : effect.rests_on())
    html += "<p>" + escape_html("It rests on " + recording + " alone.") + "</p>";
  return card(html);
}

std::string channels_of(const pb::Verdict& v) {
  std::string html;
  for (const pb::VerdictChannel& channel : v.channels())
    html += "<p>" + escape_html(channel_text(channel)) + "</p>";
  return html.empty() ? "" : card(html);
}

/// Its first number, which says how strong it is, and the one that is known best as a share of
/// itself; of a number at the end of its range half of the interval is cut off.
std::vector<const pb::VerdictParameter*> told_numbers(const pb::VerdictEffect& effect) {
  const auto open = [](const pb::VerdictParameter& p) {
    const double share = (p.high90() - p.low90()) / std::max(std::fabs(p.value()), 1e-12);
    return std::pair(p.at_bound(), share);
  };
  std::vector<const pb::VerdictParameter*> told;
  if (effect.parameters_size() == 0) return told;
  const pb::VerdictParameter& first = effect.parameters(0);
  if (!first.at_bound()) told.push_back(&first);
  const auto best = std::ranges::min_element(effect.parameters(), {}, open);
  if (told.empty() || &*best != &first) told.push_back(&*best);
  return told;
}

}  // namespace

std::string verdict_sentence(const pb::Verdict& v) {
  if (v.status() == "bad_recording")
    return "A recording cannot be what it says: " + v.reason() + ".";
  if (v.status() == "no_mismatch_detectable")
    return "No mismatch is detectable: nothing that these recordings could show was left out.";
  if (v.status() == "unexplained")
    return "Something is left out, and what it is cannot be told: " + with_keys_read(v.reason()) +
           ".";
  const pb::VerdictEffect& effect = v.effects(0);
  std::string text = fmt::format("The simulation leaves out {}", told_names(effect));
  const std::string where = where_text(effect.where());
  if (!where.empty()) text += " " + where;
  for (const pb::VerdictParameter* p : told_numbers(effect)) {
    const ShownNumber number = shown(*p);
    const std::string words = words_of(effect.class_().members(0).name(), p->name());
    text += fmt::format(", {}{} = {}{} (90 %: {} - {}{})", p->name(),
                        words.empty() ? "" : " (" + words + ")", number.value, number.unit,
                        number.low, number.high, number.unit);
  }
  if (v.status() == "partly_explained")
    text += ", and that is not all: " + with_keys_read(v.reason());
  return text + ".";
}

std::string make_verdict_page(const Explanation& found, const std::string& folder) {
  const pb::Verdict& v = found.verdict;
  std::string status = v.status();
  std::ranges::replace(status, '_', ' ');  // a line breaks there on a narrow page
  std::vector<Tile> tiles = {{status, "status", with_keys_read(v.reason())}};
  double before = 0, after = 0, count = 0;
  for (const pb::VerdictFit& row : v.fit()) {
    if (row.role() != "held_out" || !row.has_r()) continue;  // where there was something to explain
    before += row.rmse_base() * row.rmse_base();
    after += row.rmse_model() * row.rmse_model();
    ++count;
  }
  if (count > 0) {
    tiles.push_back({mm(std::sqrt(after / count)) + " mm", "error of recordings held out",
                     "rms where something was to be explained; before " +
                         mm(std::sqrt(before / count)) + " mm"});
  }
  std::vector<Section> sections;
  std::string what;
  for (const pb::VerdictEffect& effect : v.effects())
    what += effect_table(effect) + when_table(effect);
  std::string maps;
  for (const std::string effect : {"inclusion", "adhesion"}) {
    // Beside a claim only its own map: another would be read as a second place.
    const bool claimed =
        v.effects_size() > 0 &&
        std::ranges::any_of(v.effects(0).class_().members(), [&](const pb::VerdictMember& m) {
          return m.name() == effect || (m.name() == "soft_spot" && effect == "inclusion");
        });
    if (v.effects_size() == 0 || claimed) maps += map_of(v, effect);
  }
  sections.push_back({"what", "What, where, how much",
                      v.effects_size() > 0
                          ? "Numbers with intervals of 90 %, the frames in which it shows, and how "
                            "well it would explain the recordings at each place."
                          : "How well an inclusion or an adhesion would explain the recordings.",
                      what + row(maps + residual_maps(found.residuals))});
  sections.push_back(
      {"fit", "Before and after",
       "How far the cloud is from the simulated surface, in blocks of 20 mm and 0.2 s "
       "(rms of their medians). What was held out was never fitted. The noise floor is what the "
       "noise of the sensor alone leaves, of what was held out also what is not known of its own "
       "numbers.",
       error_bars(v) + channels_of(v)});
  sections.push_back({"surface", "Recordings and simulation",
                      "Cloud over the simulated surface, before and after.",
                      viewer(found, folder)});
  if (v.rivals_size() > 0) {
    sections.push_back(
        {"rivals", "Rivals",
         "What else would explain the recordings, and what each leaves to the others.",
         rivals_tables(v)});
  }
  sections.push_back({"limits", "What would have been seen",
                      fmt::format("Smallest size of each effect that these recordings would show "
                                  "({} nats).",
                                  nats(v.threshold())),
                      limits_table(v)});
  TableRows pull_rows = {{"nuisance", "standard deviations from its belief"}};
  for (const pb::VerdictPull& pull : v.pulls())
    pull_rows.push_back({named_nuisance(pull.name()), fmt::format("{:.1f}", pull.pull())});
  sections.push_back({"pulls", "Nuisances and numerics", "Above 4 is odd, above 5 a finding.",
                      card(make_table(pull_rows, {1}))});
  sections.push_back({"use", "Use it",
                      "In the folder of this page: a policy trains in the repaired scene; it "
                      "foretells what other commands would do (RECORDINGS), in a new folder (OUT).",
                      card("<pre>learner --preset omentum_elastic --set "
                           "scene_file=\"$PWD/scene.repaired.txtpb\"\n"
                           "mismatch predict . -r RECORDINGS -o OUT</pre>")});
  if (v.warnings_size() > 0)
    sections.push_back({"warnings", "Warnings", "", card(list_of(v.warnings()))});
  return make_page("What the simulation left out", verdict_sentence(v), make_tiles(tiles), sections,
                   replay_script(),
                   fmt::format("mismatch explain, {:.0f} core-seconds", v.core_seconds()));
}

}  // namespace omentum

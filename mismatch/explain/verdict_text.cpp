#include "mismatch/explain/verdict_text.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "mismatch/explain/explain.h"
#include "mismatch/explain/verdict_words.h"

namespace omentum {
namespace {

/// Rows of cells in columns as wide as they need; numbers are right aligned, which are the columns
/// behind the first up to the one that `last_number` counts.
class Columns {
 public:
  void add(std::vector<std::string> row) { rows_.push_back(std::move(row)); }
  bool empty() const { return rows_.size() < 2; }  ///< but for its head
  std::string text(std::size_t last_number = 100) const {
    std::vector<std::size_t> width;
    for (const auto& row : rows_) {
      width.resize(std::max(width.size(), row.size()));
      for (std::size_t k = 0; k < row.size(); ++k) width[k] = std::max(width[k], row[k].size());
    }
    std::string all;
    for (const auto& row : rows_) {
      std::string line;
      for (std::size_t k = 0; k < row.size(); ++k) {
        line += k == 0 || k > last_number ? fmt::format("  {:<{}}", row[k], width[k])
                                          : fmt::format("  {:>{}}", row[k], width[k]);
      }
      line.erase(line.find_last_not_of(' ') + 1);
      all += line + "\n";
    }
    return all;
  }

 private:
  std::vector<std::vector<std::string>> rows_;
};

/// Text of others must not steer a terminal: control characters become '?'.
std::string printable(std::string text) {
  for (char& c : text) {
    const auto code = static_cast<unsigned char>(c);
    if ((code < 0x20 && c != '\n') || code == 0x7f) c = '?';
  }
  return text;
}

std::string sentence(const pb::Verdict& v) { return verdict_sentence(v) + "\n"; }

/// Places to a tenth of a millimetre.
long tenths(double metres) {
  constexpr double kFar = 1e3;  // [m]
  return std::isfinite(metres) ? std::lround(1e4 * std::clamp(metres, -kFar, kFar)) : 0;
}

/// "inclusion.k" of "inclusion.k@x=0.01:y=0".
std::string number_of(const pb::VerdictScore& score) {
  return score.key().substr(0, score.key().find('@'));
}

/// Scores of one number over its places, x_B to the right and y_B upwards.
std::string map_of(const std::string& number, const std::vector<const pb::VerdictScore*>& scores) {
  std::set<long> x, y;
  std::map<std::pair<long, long>, double> at;
  for (const pb::VerdictScore* score : scores) {
    const long i = tenths(score->place_m(0)), j = tenths(score->place_m(1));
    x.insert(i);
    y.insert(j);
    at[{i, j}] = score->z();
  }
  Columns table;
  std::vector<std::string> head = {"y \\ x, mm"};
  for (const long i : x) head.push_back(fmt::format("{:.1f}", 0.1 * static_cast<double>(i)));
  table.add(std::move(head));
  for (auto j = y.rbegin(); j != y.rend(); ++j) {
    std::vector<std::string> row = {fmt::format("{:.1f}", 0.1 * static_cast<double>(*j))};
    for (const long i : x) {
      const auto found = at.find({i, *j});
      row.push_back(found == at.end() ? "." : fmt::format("{:.1f}", found->second));
    }
    table.add(std::move(row));
  }
  return number + ", z by place:\n" + table.text();
}

std::string place_text(const pb::Verdict& v) {
  std::string text;
  for (const pb::VerdictEffect& effect : v.effects()) {
    const std::string where = where_text(effect.where());
    text += fmt::format("{}: {}\n", names_of(effect),
                        where.empty() ? "of the whole set-up, no place" : where);
  }
  if (v.effects_size() == 0) text += "Nothing is named, so that there is no place of it.\n";
  return text;
}

std::string class_text(const pb::Verdict& v) {
  Columns table;
  table.add({"named", "share of the class"});
  for (const pb::VerdictEffect& effect : v.effects()) {
    for (const pb::VerdictMember& member : effect.class_().members())
      table.add({member.name(), fmt::format("{:.2f}", member.probability())});
  }
  if (table.empty()) return "";
  std::string text = table.text();
  for (const pb::VerdictEffect& effect : v.effects()) {
    text += fmt::format("  gain {} nats, claimed above {}; {}\n", nats(effect.gain()),
                        nats(v.threshold()),
                        effect.confirmed() ? "recordings that were held out confirm it"
                                           : "not confirmed: " + effect.why_not_confirmed());
    for (const std::string& recording : effect.rests_on())
      text += fmt::format("  it rests on {} alone\n", recording);
  }
  return text;
}

std::string left_by(const pb::VerdictRival& rival, int most) {
  std::vector<std::string> left;
  for (const pb::VerdictLeft& other : rival.left()) {
    if (other.gain() < 1 || static_cast<int>(left.size()) >= most) continue;
    left.push_back(fmt::format("{}: {}", key_text(other.name()), nats(other.gain())));
  }
  if (left.empty()) return "nothing";
  return fmt::format("{}", fmt::join(left, "; "));
}

std::string rivals_text(const pb::Verdict& v, int most, int most_left) {
  Columns refitted, claimed;
  refitted.add({"refitted by simulations", "gain, nats", "numbers"});
  claimed.add({"claimed by columns", "gain, nats", "leaves to others, nats"});
  for (const pb::VerdictRival& rival : v.rivals()) {
    const std::string gain = nats(rival.gain());
    if (rival.simulated()) {
      refitted.add({rival.name(), gain, numbers_of(rival)});
    } else if (most-- > 0) {
      claimed.add({key_text(rival.key()), gain, left_by(rival, most_left)});
    }
  }
  std::string text;
  for (const Columns* table : {&refitted, &claimed}) {
    if (!table->empty()) text += table->text(1);
  }
  return text;
}

std::string numbers_text(const pb::Verdict& v) {
  std::string text;
  for (const pb::VerdictEffect& effect : v.effects()) {
    Columns table;
    const std::string& name = effect.class_().members(0).name();
    table.add({name, "value", "90 % from", "to", "", ""});
    for (const pb::VerdictParameter& p : effect.parameters()) {
      const ShownNumber number = shown(p);
      table.add({p.name(), number.value + number.unit, number.low + number.unit,
                 number.high + number.unit, words_of(name, p.name()),
                 p.at_bound() ? "at the end of its range" : ""});
    }
    text += table.text(3);
    if (effect.has_explained_share())
      text +=
          fmt::format("  of the squared error {:.0f} % is gone\n", 100 * effect.explained_share());
  }
  if (v.effects_size() == 0) text = "Nothing is named: the base alone was refitted.\n";
  return text;
}

std::string fit_text(const pb::Verdict& v) {
  Columns table;
  table.add({"recording", "role", "before, mm", "after", "noise floor, mm", "in the shell before",
             "after"});
  for (const pb::VerdictFit& row : v.fit()) {
    table.add({row.recording(), row.role(), mm(row.rmse_base()), mm(row.rmse_model()),
               mm(row.floor()), row.has_rmse_shell_base() ? mm(row.rmse_shell_base()) : "",
               row.has_rmse_shell_model() ? mm(row.rmse_shell_model()) : ""});
  }
  std::string text = table.empty() ? "" : table.text();
  for (const pb::VerdictChannel& channel : v.channels()) text += channel_text(channel) + "\n";
  return text;
}

}  // namespace

std::string limits_text(const pb::Verdict& v) {
  Columns table;
  table.add({"would be seen", "from", "at any place", "named from", "models differ by", "of"});
  for (const pb::VerdictLimit& row : v.detection_limits()) {
    const std::string words = limit_words(row);
    if (!row.testable()) {
      table.add({row.effect(), "never", "", "", "", words});
      continue;
    }
    table.add({row.effect(), least_size(row.amplitude(), row), anywhere_text(row),
               least_size(row.amplitude_named(), row), least_size(row.floor_amplitude(), row),
               words});
  }
  return table.empty() ? "" : printable(table.text(4));
}

std::string locate_text(const pb::Verdict& v) {
  std::map<std::string, std::vector<const pb::VerdictScore*>> maps;
  Columns single;
  single.add({"at one place", "z", "x, mm", "y, mm"});
  for (const pb::VerdictScore& score : v.scores()) {
    if (score.place_m_size() == 2) maps[number_of(score)].push_back(&score);
  }
  std::string text = place_text(v);
  for (const auto& [number, scores] : maps) {
    constexpr std::size_t kMap = 4;  // places of the smallest
    if (scores.size() >= kMap) {
      text += map_of(number, scores);
      continue;
    }
    for (const pb::VerdictScore* score : scores) {
      single.add({number, fmt::format("{:.1f}", score->z()), mm(score->place_m(0)),
                  mm(score->place_m(1))});
    }
  }
  if (!single.empty()) text += single.text();
  if (!maps.empty())
    text += "Scores rank; claims are decided by how well left-out recordings are predicted.\n";
  return printable(text);
}

std::string name_text(const pb::Verdict& v) {
  constexpr int kAll = 1000;
  std::string text = sentence(v) + "status: " + v.status() + "\n";
  if (!v.reason().empty()) text += "reason: " + with_keys_read(v.reason()) + "\n";
  return printable(text + class_text(v) + rivals_text(v, kAll, kAll));
}

std::string model_text(const pb::Verdict& v, const std::string& scene) {
  std::string text = numbers_text(v);
  if (!v.scene_patch().empty()) text += "in the scene:\n" + v.scene_patch();
  if (!v.scene_patch().empty() && !v.scene_patch().ends_with('\n')) text += "\n";
  return printable(text + "the whole scene, base refitted: " + scene + "\n");
}

std::string show_text(const pb::Verdict& v, const std::string& scene) {
  constexpr int kRivals = 4, kLeft = 3;
  std::string text = sentence(v) + "status: " + v.status() + "\n";
  if (!v.reason().empty()) text += "reason: " + with_keys_read(v.reason()) + "\n";
  if (v.effects_size() > 0) text += place_text(v) + class_text(v) + numbers_text(v);
  text += rivals_text(v, kRivals, kLeft) + fit_text(v) + limits_text(v);
  for (const std::string& warning : v.warnings()) text += "warning: " + warning + "\n";
  return printable(text + "the scene, base refitted: " + scene + "\n");
}

}  // namespace omentum

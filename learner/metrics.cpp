#include "learner/metrics.h"

#include <fmt/core.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <limits>
#include <utility>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/regular_file.h"
#include "learner/json.h"

namespace omentum {

namespace {

/// `update` of a stored row; 0 when there is none (header).
std::uint64_t update_of_csv(std::string_view line) {
  std::uint64_t number = 0;
  std::from_chars(line.data(), line.data() + line.size(), number);
  return number;
}
std::uint64_t update_of_json(std::string_view line) {
  const Json row = Json::parse(line, nullptr, false);
  if (!row.is_object() || !row.contains("update")) return 0;
  const Json& update = row["update"];
  return update.is_number_unsigned() ? update.get<std::uint64_t>() : 0;
}

std::vector<std::string> cells_of(const std::string& line) {
  std::vector<std::string> cells(1);
  for (const char c : line) {
    if (c == ',') {
      cells.emplace_back();
    } else {
      cells.back() += c;
    }
  }
  return cells;
}

/// The cells of a row below another header, as an earlier version wrote it, in the order of ours.
std::string reordered(const std::string& row, const std::string& theirs, const std::string& ours) {
  const std::vector<std::string> cells = cells_of(row), names = cells_of(theirs);
  std::string line;
  for (const std::string& name : cells_of(ours)) {
    const auto at =
        static_cast<std::size_t>(std::find(names.begin(), names.end(), name) - names.begin());
    line += (line.empty() ? "" : ",") + (at < cells.size() ? cells[at] : std::string());
  }
  return line;
}

/// Rewrites a row file without the rows after `last_update` and without a torn last line, with the
/// columns of `header`, where there is one.
void drop_rows_after(const std::string& path, std::uint64_t last_update,
                     std::uint64_t (*update_of)(std::string_view), const std::string& header) {
  std::string kept = header;
  if (last_update > 0 && std::filesystem::exists(path)) {
    if (const Result<void> regular = require_regular_file(path); !regular)
      throw_error("{}", regular.error());
    std::ifstream file(path);
    const std::string ours = header.substr(0, header.find('\n'));
    std::string theirs = ours;
    std::string line;
    while (std::getline(file, line) && !file.eof()) {
      if (line.starts_with("update,")) theirs = line;
      const std::uint64_t update = update_of(line);
      if (update < 1 || update > last_update) continue;
      kept += (theirs == ours ? line : reordered(line, theirs, ours)) + "\n";
    }
  }
  if (const Result<void> result = write_durably(path, kept); !result) {
    throw_error("{}", result.error());
  }
}

std::string csv_header(const std::vector<std::string>& names) {
  std::string header = "update,wall_time_s";
  for (const std::string& name : names) header += "," + name;
  return header + "\n";
}

}  // namespace

std::vector<std::string> metric_names(const std::vector<std::string>& branches) {
  std::vector<std::string> names;
  const auto group = [&](const std::string& prefix, const std::vector<std::string>& members) {
    for (const std::string& member : members) names.push_back(fmt::format("{}/{}", prefix, member));
  };
  group("charts", {"episodic_return", "episodic_length", "SPS", "learning_rate", "steps_total",
                   "physics_steps_total", "success_rate", "exposure_fraction"});
  group("losses", {"policy_loss", "value_loss", "entropy"});
  for (const std::string& branch : branches) names.push_back("losses/entropy_" + branch);
  group("losses", {"approx_kl", "old_approx_kl", "approx_kl_max"});
  for (const std::string& branch : branches) names.push_back("losses/kl_" + branch);
  group("losses", {"clipfrac", "explained_variance", "grad_norm", "ratio_mean", "ratio_min",
                   "ratio_max", "adam_max_second_moment", "value_delta"});
  group("policy",
        {"version", "lag_min", "lag_mean", "lag_max", "epsilon", "beta", "logp_check_max"});
  group("ledger", {"granted", "regranted", "received", "admitted", "duplicate", "stale", "invalid",
                   "cancelled", "outstanding", "audit_mismatch"});
  group("workers", {"alive", "lanes", "steps_per_s", "sim_time_fraction", "wait_fraction",
                    "lost_leases", "declined"});
  group("time", {"wait_s", "check_s", "update_s", "publish_s", "save_s"});
  return names;
}

MetricsRow::MetricsRow(std::vector<std::string> branches)
    : branches_(std::move(branches)), names_(metric_names(branches_)) {}

bool MetricsRow::has(std::string_view name) const {
  return std::find(names_.begin(), names_.end(), name) != names_.end();
}

void MetricsRow::set(std::string_view name, double value) {
  OMENTUM_CHECK(has(name), "no metric is called {}", name);
  values_.insert_or_assign(std::string(name), value);
}

double MetricsRow::get(std::string_view name) const {
  const auto found = values_.find(name);
  return found == values_.end() ? std::numeric_limits<double>::quiet_NaN() : found->second;
}

void MetricsRow::set_update(const UpdateStats& stats) {
  set("charts/learning_rate", stats.learning_rate);
  set("losses/policy_loss", stats.policy_loss);
  set("losses/value_loss", stats.value_loss);
  set("losses/entropy", stats.entropy);
  for (std::size_t b = 0; b < branches_.size(); ++b) {
    set("losses/entropy_" + branches_[b], stats.branch_entropy[b]);
    set("losses/kl_" + branches_[b], stats.branch_kl[b]);
  }
  set("losses/approx_kl", stats.approx_kl);
  set("losses/old_approx_kl", stats.old_approx_kl);
  set("losses/approx_kl_max", stats.approx_kl_max);
  set("losses/clipfrac", stats.clip_fraction);
  set("losses/explained_variance", stats.explained_variance);
  set("losses/grad_norm", stats.gradient_norm);
  set("losses/ratio_mean", stats.ratio_mean);
  set("losses/ratio_min", stats.ratio_min);
  set("losses/ratio_max", stats.ratio_max);
  set("losses/adam_max_second_moment", stats.adam_max_second_moment);
  set("losses/value_delta", stats.value_delta);
  set("policy/version", static_cast<double>(stats.version));
  set("policy/epsilon", stats.clip);
  set("policy/beta", stats.entropy_coefficient);
}

std::vector<Scalar> MetricsRow::scalars() const {
  std::vector<Scalar> scalars;
  for (const std::string& name : names_) {
    const auto found = values_.find(name);
    if (found != values_.end()) scalars.emplace_back(*found);
  }
  return scalars;
}

MetricsWriter::MetricsWriter(const std::string& folder, const std::vector<std::string>& branches,
                             std::uint64_t resume_update, bool mlagents_aliases)
    : names_(metric_names(branches)), mlagents_aliases_(mlagents_aliases), tensorboard_(folder) {
  const std::string csv = folder + "/metrics.csv", jsonl = folder + "/metrics.jsonl";
  drop_rows_after(csv, resume_update, update_of_csv, csv_header(names_));
  drop_rows_after(jsonl, resume_update, update_of_json, "");
  csv_.emplace(csv, csv_header(names_));
  jsonl_.emplace(jsonl);
}

Result<void> MetricsWriter::write(std::uint64_t update, double wall_time_s, const MetricsRow& row) {
  std::string line = fmt::format("{},{:.3f}", update, wall_time_s);
  Json json = {{"update", update}, {"wall_time_s", json_number(wall_time_s)}};
  for (const std::string& name : names_) {
    const double value = row.get(name);
    line += std::isfinite(value) ? fmt::format(",{}", value) : ",";
    if (!std::isnan(value)) json[name] = json_number(value);
  }

  std::vector<Scalar> scalars = row.scalars();
  if (mlagents_aliases_) {
    const std::pair<const char*, const char*> aliases[] = {
        {"Environment/Cumulative Reward", "charts/episodic_return"},
        {"Environment/Episode Length", "charts/episodic_length"},
        {"Losses/Policy Loss", "losses/policy_loss"},
        {"Losses/Value Loss", "losses/value_loss"},
        {"Policy/Learning Rate", "charts/learning_rate"},
        {"Policy/Epsilon", "policy/epsilon"},
        {"Policy/Beta", "policy/beta"},
        {"Policy/Entropy", "losses/entropy"},
    };
    for (const auto& [alias, name] : aliases) scalars.emplace_back(alias, row.get(name));
  }
  const double steps = row.get("charts/steps_total");
  const auto position =
      static_cast<std::int64_t>(std::isfinite(steps) ? steps : static_cast<double>(update));
  // A file that cannot be written takes no other along.
  const Result<void> results[] = {csv_->append(line + "\n"),
                                  jsonl_->append(json_text(json, -1) + "\n"),
                                  tensorboard_.write(position, scalars)};
  std::string reasons;
  for (const Result<void>& result : results) {
    if (!result) reasons += (reasons.empty() ? "" : "; ") + result.error();
  }
  if (reasons.empty()) return {};
  ++incomplete_;
  return Failure{reasons};
}

}  // namespace omentum

#include "dvrk_gateway/recording/sensor_samples.h"

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <filesystem>
#include <limits>
#include <nlohmann/json.hpp>
#include <optional>
#include <utility>

#include "core/check.h"
#include "core/cloud_message.h"
#include "core/csv.h"
#include "core/ply.h"
#include "core/read_file.h"
#include "core/table.h"
#include "proto/foxglove.pb.h"
#include "proto/robot_recording.pb.h"

namespace omentum {
namespace {

using nlohmann::json;

constexpr double kNotTold = std::numeric_limits<double>::quiet_NaN();
constexpr std::array<std::pair<const char*, SensorKind>, 6> kKinds = {
    {{"force", SensorKind::kForce},
     {"markers", SensorKind::kMarkers},
     {"tracker", SensorKind::kTracker},
     {"cloud", SensorKind::kCloud},
     {"color", SensorKind::kColor},
     {"depth", SensorKind::kDepth}}};

SensorMessage force_message(double t_s, const std::array<double, 6>& wrench) {
  auto sample = std::make_shared<pb::ForceSample>();
  sample->set_t_s(t_s);
  sample->set_fx_n(wrench[0]);
  sample->set_fy_n(wrench[1]);
  sample->set_fz_n(wrench[2]);
  sample->set_tx_nm(wrench[3]);
  sample->set_ty_nm(wrench[4]);
  sample->set_tz_nm(wrench[5]);
  return sample;
}

SensorMessage cloud_message(double t_s, const std::vector<float>& xyz) {
  const double ns = std::isfinite(t_s) && t_s >= 0 && t_s < 9e9 ? 1e9 * t_s : 0;
  return std::make_shared<foxglove::PointCloud>(make_cloud(
      xyz.data(), static_cast<std::uint32_t>(xyz.size() / 3), static_cast<std::uint64_t>(ns)));
}

/// Reads the members of one object; the first fault stays.
class Members {
 public:
  explicit Members(const json& object) : object_(object) {}

  double number(const char* name, std::optional<double> otherwise = {}) {
    ++known_;
    const auto found = object_.find(name);
    if (found == object_.end()) {
      --known_;
      if (!otherwise) fail(fmt::format("{} is missing", name));
      return otherwise.value_or(0);
    }
    const double value = found->is_number() ? found->get<double>() : kNotTold;
    if (!std::isfinite(value)) fail(fmt::format("{} is no finite number", name));
    return value;
  }
  bool has(const char* name) const { return object_.contains(name); }
  /// A list of a multiple of three numbers.
  std::vector<double> points(const char* name) {
    std::vector<double> values;
    const auto found = object_.find(name);
    if (found == object_.end() || !found->is_array()) {
      fail(fmt::format("{} is missing or no list", name));
      return values;
    }
    ++known_;
    for (const json& value : *found) {
      values.push_back(value.is_number() ? value.get<double>() : kNotTold);
      if (!std::isfinite(values.back())) fail(fmt::format("{} has what is no finite number", name));
    }
    if (values.empty() || values.size() % 3 != 0)
      fail(fmt::format("{} has {} numbers, needed x y z of each point", name, values.size()));
    return values;
  }
  /// What is wrong, a member that nobody asked for included; empty where nothing is.
  std::string fault() {
    if (known_ != object_.size()) fail("a member that is not known");
    return fault_;
  }

 private:
  void fail(const std::string& why) {
    if (fault_.empty()) fault_ = why;
  }
  const json& object_;
  std::size_t known_ = 0;
  std::string fault_;
};

SensorMessage tracker_message(double t_s, const Eigen::Vector3d& p,
                              const std::optional<Eigen::Vector4d>& wxyz) {
  auto sample = std::make_shared<pb::TrackerSample>();
  sample->set_t_s(t_s);
  for (const double value : p) sample->add_position_m(value);
  if (wxyz) {
    for (const double value : *wxyz) sample->add_orientation_wxyz(value);
  }
  return sample;
}

SensorMessage message_of(SensorKind kind, Members& members) {
  const double t_s = members.number("t_s");
  if (kind == SensorKind::kForce) {
    return force_message(
        t_s, {members.number("fx_N"), members.number("fy_N"), members.number("fz_N"),
              members.number("tx_Nm", 0), members.number("ty_Nm", 0), members.number("tz_Nm", 0)});
  }
  if (kind == SensorKind::kTracker) {
    const Eigen::Vector3d p(members.number("x_m"), members.number("y_m"), members.number("z_m"));
    std::optional<Eigen::Vector4d> q;
    if (members.has("qw")) {
      q.emplace(members.number("qw"), members.number("qx"), members.number("qy"),
                members.number("qz"));
    }
    return tracker_message(t_s, p, q);
  }
  const std::vector<double> points = members.points("p_m");
  if (kind == SensorKind::kCloud) return cloud_message(t_s, {points.begin(), points.end()});
  auto markers = std::make_shared<pb::MarkersSample>();
  markers->set_t_s(t_s);
  for (const double value : points) markers->add_position_m(value);
  return markers;
}

/// Tables of numbers.
std::vector<SensorMessage> numbers_of(SensorKind kind, const Table& table) {
  const std::vector<double>* t = table.find("t_s");
  const auto cell = [&table](const char* name, std::size_t row) {
    const std::vector<double>* column = table.find(name);
    return column == nullptr ? 0 : (*column)[row];
  };
  std::vector<const std::vector<double>*> coordinates;
  for (std::size_t k = 0; k < table.names.size(); ++k) {
    if (table.names[k] != "t_s") coordinates.push_back(&table.columns[k]);
  }
  if (kind == SensorKind::kMarkers && (coordinates.empty() || coordinates.size() % 3 != 0))
    throw_error("{}:1: {} columns beside t_s, needed x y z of each marker", table.path,
                coordinates.size());
  if (kind == SensorKind::kForce) {
    for (const char* name : {"fx_N", "fy_N", "fz_N"}) table.column(name);
  }
  if (kind == SensorKind::kTracker) {
    for (const char* name : {"tip_optical_x_m", "tip_optical_y_m", "tip_optical_z_m"})
      table.column(name);
  }
  std::vector<SensorMessage> messages;
  for (std::size_t i = 0; i < table.rows(); ++i) {
    const double t_s = t == nullptr ? kNotTold : (*t)[i];
    if (kind == SensorKind::kForce) {
      messages.push_back(
          force_message(t_s, {cell("fx_N", i), cell("fy_N", i), cell("fz_N", i), cell("tx_Nm", i),
                              cell("ty_Nm", i), cell("tz_Nm", i)}));
    } else if (kind == SensorKind::kTracker) {
      std::optional<Eigen::Vector4d> q;
      if (table.find("tip_optical_qw") != nullptr) {
        q.emplace(cell("tip_optical_qw", i), cell("tip_optical_qx", i), cell("tip_optical_qy", i),
                  cell("tip_optical_qz", i));
      }
      messages.push_back(tracker_message(
          t_s, {cell("tip_optical_x_m", i), cell("tip_optical_y_m", i), cell("tip_optical_z_m", i)},
          q));
    } else {
      auto markers = std::make_shared<pb::MarkersSample>();
      markers->set_t_s(t_s);
      for (const auto* column : coordinates) markers->add_position_m((*column)[i]);
      messages.push_back(markers);
    }
  }
  return messages;
}

SensorMessage file_message(SensorKind kind, double t_s, const std::string& path) {
  const Result<std::string> bytes = read_file(path);
  if (!bytes) throw_error("{}", bytes.error());
  if (kind == SensorKind::kCloud) {
    const auto points = parse_ply(path, bytes.value());
    if (!points) throw_error("{}", points.error());
    std::vector<float> xyz;
    for (const Eigen::Vector3f& p : points.value()) xyz.insert(xyz.end(), p.begin(), p.end());
    return cloud_message(t_s, xyz);
  }
  if (!bytes.value().starts_with("\x89PNG\r\n\x1a\n")) throw_error("{}: no PNG", path);
  auto image = std::make_shared<foxglove::CompressedImage>();
  const double ns = std::isfinite(t_s) && t_s >= 0 && t_s < 9e9 ? 1e9 * t_s : 0;
  image->mutable_timestamp()->set_seconds(static_cast<std::int64_t>(ns / 1e9));
  image->mutable_timestamp()->set_nanos(static_cast<std::int32_t>(std::fmod(ns, 1e9)));
  image->set_frame_id("camera");
  image->set_format("png");
  image->set_data(bytes.value());
  return image;
}

/// clouds.csv, color.csv, depth.csv: t_s, file.
std::vector<SensorMessage> files_of(SensorKind kind, const std::string& folder,
                                    const Result<CsvTable>& read) {
  if (!read) throw_error("{}", read.error());
  const CsvTable& table = read.value();
  const auto file = table.column("file");
  if (!file) throw_error("{}:1: column file is missing", table.path);
  std::vector<SensorMessage> messages;
  for (std::size_t row = 0; row < table.rows.size(); ++row) {
    const std::filesystem::path name = table.rows[row][*file].text;
    messages.push_back(file_message(kind, table.number(row, "t_s"),
                                    (std::filesystem::path(folder) / name).string()));
  }
  return messages;
}

}  // namespace

std::optional<SensorKind> sensor_kind(std::string_view name) {
  for (const auto& [known, kind] : kKinds) {
    if (name == known) return kind;
  }
  return std::nullopt;
}

std::string sensor_topic(SensorKind kind) {
  for (const auto& [name, known] : kKinds) {
    if (kind == known) return std::string("/") + name;
  }
  return "";
}

Result<SensorMessage> parse_sensor_json(SensorKind kind, std::string_view text) {
  if (kind == SensorKind::kColor || kind == SensorKind::kDepth)
    return Failure{"images come by files"};
  const json parsed = json::parse(text, nullptr, false);
  if (!parsed.is_object()) return Failure{"no JSON object"};
  Members members(parsed);
  SensorMessage message = message_of(kind, members);
  if (const std::string fault = members.fault(); !fault.empty()) return Failure{fault};
  return message;
}

Result<std::vector<SensorMessage>> parse_sensor_rows(SensorKind kind, const std::string& name,
                                                     const std::string& folder,
                                                     const std::string& header,
                                                     std::string_view lines) {
  const std::string text = header + "\n" + std::string(lines);
  const bool files =
      kind == SensorKind::kCloud || kind == SensorKind::kColor || kind == SensorKind::kDepth;
  try {
    if (files) return files_of(kind, folder, parse_csv(name, text));
    return numbers_of(kind, parse_table(name, text));
  } catch (const Error& error) {
    return Failure{error.what()};
  }
}

}  // namespace omentum

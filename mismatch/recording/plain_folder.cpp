#include "mismatch/recording/plain_folder.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iterator>
#include <limits>
#include <numeric>
#include <set>

#include "core/check.h"
#include "core/config.h"
#include "core/file_name.h"
#include "core/output_folder.h"
#include "core/ply.h"
#include "core/recording_info.h"
#include "core/regular_file.h"
#include "core/table.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/pcd.h"
#include "mismatch/recording/table_columns.h"
#include "mismatch/recording/text_table.h"
#include "proto/scene.pb.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

double rate_of(const pb::RecordingInfo& info, std::string_view file) {
  if (file == "tool.csv") return info.tool_rate_hz();
  if (file == "joints.csv") return info.joints_rate_hz();
  if (file == "tracker.csv") return info.tracker_rate_hz();
  if (file == "force.csv") return info.force_rate_hz();
  if (file == "markers.csv") return info.markers_rate_hz();
  if (file == "coupon.csv") return info.coupon_rate_hz();
  if (file == "depth.csv") return info.depth_rate_hz();
  if (file == "color.csv") return info.color_rate_hz();
  return info.cloud_rate_hz();
}

bool has_times(const TextTable& table) {
  return std::ranges::any_of(table.names(), [](const std::string& name) {
    const Result<SiColumn> si = si_column(name);
    return si && si.value().name == "t_s";
  });
}

/// Rows and their times; those of the nominal rate where there is no time.
struct TimedRows {
  std::vector<std::size_t> rows;
  std::vector<std::int64_t> time_ns;
};

TimedRows times_of(const TextTable& table, double rate_hz, std::vector<std::string>& warnings) {
  std::optional<std::size_t> column;
  double factor = 1;
  for (std::size_t k = 0; k < table.names().size(); ++k) {
    const Result<SiColumn> si = si_column(table.names()[k]);
    if (!si || si.value().name != "t_s") continue;
    if (column)
      throw_error("{}: {} beside {}, needed one column of times", table.header_place(k),
                  shown(table.names()[k]), shown(table.names()[*column]));
    column = k;
    factor = si.value().factor;
  }
  TimedRows timed;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    timed.rows.push_back(row);
    timed.time_ns.push_back(column ? table.time_ns(row, *column, factor)
                                   : std::llround(static_cast<double>(row) / rate_hz * 1e9));
  }
  keep_increasing(table, column.value_or(0), timed.rows, timed.time_ns, warnings);
  return timed;
}

void read_table_file(const std::string& folder, std::string_view file, Recording& recording) {
  const std::string path = folder + "/" + std::string(file);
  const TextTable table = TextTable::read(path, {});
  if (table.names().size() == 1 && table.names()[0].find_first_of(";\t") != std::string::npos)
    throw_error(
        "{}:1: separated by semicolons or tabs, needed commas, or --map with source {{ files: "
        "\"{}\" delimiter: \"{}\" named: true }}",
        path, file, table.names()[0].find(';') != std::string::npos ? ";" : "\\t");
  const auto [rows, times] = times_of(table, rate_of(recording.info, file), recording.warnings);
  if (file == "tool.csv" && !has_times(table) && !recording.info.has_tool_rate_hz()) {
    recording.warnings.push_back(fmt::format(
        "{}:1: no column t_s and no tool_rate_hz in recording.txtpb: rows are taken to be {:g} s "
        "apart",
        path, 1 / recording.info.tool_rate_hz()));
  }
  recording.warnings.insert(recording.warnings.end(), table.warnings().begin(),
                            table.warnings().end());
  if (table.open_end() && table.rows() > 0) {
    recording.warnings.push_back(
        fmt::format("{}:{}: the last line has no end: is a part of its last number missing?", path,
                    table.lines().back()));
  }
  struct Taken {
    std::size_t column = 0;
    double factor = 1;
  };
  std::map<std::string, std::vector<Taken>> taken;
  std::map<std::string, Series> found;
  for (std::size_t k = 0; k < table.names().size(); ++k) {
    const Result<SiColumn> si = si_column(table.names()[k]);
    if (!si) throw_error("{}: {}", table.header_place(k), si.error());
    if (si.value().name == "t_s") continue;
    const auto place = place_of_column(file, si.value().name);
    if (!place) {
      recording.warnings.push_back(fmt::format("{}: column {} is none of {}: left out",
                                               table.header_place(k), shown(table.names()[k]),
                                               file));
      continue;
    }
    taken[place->topic].push_back({k, si.value().factor});
    found[place->topic].columns.push_back(si.value().name);
  }
  for (auto& [topic, series] : found) {
    series.time_ns = times;
    series.path = path;
    series.values.reserve(times.size() * series.columns.size());
    for (const std::size_t row : rows) {
      series.lines.push_back(table.lines()[row]);
      for (const auto& [column, factor] : taken[topic])
        series.values.push_back(table.number(row, column) * factor);
    }
    if (Result<void> whole = normalise(file, series); !whole)
      throw_error("{}:1: {}", path, whole.error());
    transform_series(transform_to_world(recording.info, std::string(file)), series);
    if (const std::string told = told_never_known(series); series.rows() > 0 && !told.empty())
      recording.warnings.push_back(fmt::format("{}: {}", path, told));
    if (series.rows() > 0) recording.series.emplace(topic, std::move(series));
  }
}

/// Number at the end of the name of a file, before its extension.
std::optional<std::uint32_t> number_in(const std::string& file) {
  const std::string stem = fs::path(file).stem().string();
  std::size_t begin = stem.size();
  while (begin > 0 && stem[begin - 1] >= '0' && stem[begin - 1] <= '9') --begin;
  if (begin == stem.size() || stem.size() - begin > 9) return std::nullopt;
  return static_cast<std::uint32_t>(std::stoul(stem.substr(begin)));
}

/// A table of times and files; empty where there is none.
std::vector<std::string> read_index(const std::string& folder, std::string_view file, double rate,
                                    std::vector<std::int64_t>& time_ns,
                                    std::vector<std::uint32_t>& number,
                                    std::vector<std::string>& warnings) {
  const std::string path = folder + "/" + std::string(file);
  if (!fs::exists(path)) return {};
  const TextTable table = TextTable::read(path, {});
  const std::size_t column = table.column("file");
  TimedRows timed = times_of(table, rate, warnings);
  time_ns = std::move(timed.time_ns);
  std::vector<std::string> files;
  bool numbered = true;
  for (const std::size_t row : timed.rows) {
    files.emplace_back(folder + "/" + std::string(table.cell(row, column)));
    if (!fs::is_regular_file(files.back()))
      throw_error("{}: {}: cannot be opened", table.place(row, column), shown(files.back()));
    const auto in_name = number_in(files.back());
    numbered = numbered && in_name && (number.empty() || *in_name > number.back());
    number.push_back(in_name.value_or(0));
  }
  if (!numbered) std::iota(number.begin(), number.end(), 0U);
  return files;
}

/// Whether a file is in a folder or below it, links followed.
bool lies_in(const fs::path& file, const fs::path& folder) {
  std::error_code failed;
  const fs::path inside = fs::canonical(file, failed), around = fs::canonical(folder, failed);
  if (failed) return false;
  return std::mismatch(around.begin(), around.end(), inside.begin(), inside.end()).first ==
         around.end();
}

void read_scene(const std::string& folder, Recording& recording) {
  pb::RecordingInfo& info = recording.info;
  const bool named = !info.scene().empty();
  const std::string file = named ? info.scene() : "scene_believed.txt";
  const fs::path own = folder,
                 of_case = (fs::absolute(own) / "").lexically_normal().parent_path().parent_path();
  std::string path;
  bool outside = false;
  for (const fs::path& place : {own, of_case}) {
    const std::string candidate = (place / file).lexically_normal().string();
    if (!path.empty() || !fs::exists(candidate)) continue;
    if (const Result<void> regular = require_regular_file(candidate); !regular)
      throw_error("{}", regular.error());
    // What a recording embeds is carried on: nothing but files of the case, however they are named.
    if (lies_in(candidate, own) || lies_in(candidate, of_case))
      path = candidate;
    else
      outside = true;
  }
  const auto refuse = [&](const std::string& why) {
    const std::string said = (own / "recording.txtpb").string();
    throw_error("{}scene: {} {}", named ? place_of_field(said, info, "scene") : said + ": ",
                shown(file), why);
  };
  if (outside) refuse("lies outside of the folder of the case");
  if (path.empty() && named)
    refuse("is neither in the folder of the recording nor in that of the case");
  if (path.empty()) return;
  if (!has_ending(path, ".txtpb") && !has_ending(path, ".txt"))
    refuse("is no scene (.txtpb) and no scene_believed.txt");
  recording.scene_path = path;
  if (path.ends_with(".txtpb")) {
    pb::Scene scene;  // what is no scene is not embedded as one
    read_text_proto(path, scene);
  }
  (path.ends_with(".txtpb") ? *info.mutable_scene_text() : *info.mutable_scene_believed_text()) =
      read_whole_file(path);
  info.clear_scene();
}

}  // namespace

void transform_series(const Eigen::Isometry3d& X_WF, Series& series) {
  if (X_WF.matrix().isIdentity(0)) return;
  const std::size_t width = series.columns.size();
  const Eigen::Quaterniond turn(X_WF.linear());
  for (std::size_t k = 0; k < width; ++k) {
    const std::string& name = series.columns[k];
    const bool position = name.ends_with("_x_m"), quaternion = name.ends_with("_qw");
    const bool wrench = name == "fx_N" || name == "tx_Nm";
    for (std::size_t row = 0; row < series.rows(); ++row) {
      double* at = series.values.data() + row * width + k;
      if (position || wrench) {
        Eigen::Map<Eigen::Vector3d> v(at);
        v = position ? Eigen::Vector3d(X_WF * v) : Eigen::Vector3d(X_WF.linear() * v);
      } else if (quaternion) {
        const Eigen::Quaterniond q = turn * Eigen::Quaterniond(at[0], at[1], at[2], at[3]);
        at[0] = q.w();
        at[1] = q.x();
        at[2] = q.y();
        at[3] = q.z();
      }
    }
  }
}

Cloud read_cloud_file(const std::string& path, std::vector<std::string>* warnings) {
  const std::string bytes = read_whole_file(path);
  if (warnings != nullptr && has_ending(path, ".pcd") && has_viewpoint(bytes))
    warnings->push_back(
        fmt::format("{}: VIEWPOINT states a pose of the sensor, which is not applied: points are "
                    "taken to be in the frame of the file",
                    path));
  Result<Cloud> cloud = has_ending(path, ".pcd") ? parse_pcd(path, bytes) : parse_ply(path, bytes);
  if (!cloud) throw_error("{}", cloud.error());
  return std::move(cloud).value();
}

std::function<std::string(std::size_t)> image_files(std::vector<std::string> paths, bool depth) {
  return [paths = std::move(paths), depth](std::size_t k) {
    std::string png = read_whole_file(paths[k]);
    const Result<PngSize> size = parse_png_size(paths[k], png);
    if (!size) throw_error("{}", size.error());
    if (depth && !(size.value().bits == 16 && size.value().channels == 1))
      throw_error("{}: {} channels of {} bits, needed one of 16 for depth", paths[k],
                  size.value().channels, size.value().bits);
    return png;
  };
}

Recording read_recording_folder(const std::string& folder) {
  if (!fs::is_directory(folder)) throw_error("{}: no folder", folder);
  Recording recording;
  pb::RecordingInfo& info = recording.info;
  info = read_recording_info(folder);
  read_scene(folder, recording);
  for (const std::string_view file : kTableFiles) {
    if (fs::exists(folder + "/" + std::string(file))) read_table_file(folder, file, recording);
  }
  Frames<Cloud>& clouds = recording.clouds;
  const auto cloud_files = read_index(folder, "clouds.csv", rate_of(info, "clouds.csv"),
                                      clouds.time_ns, clouds.number, recording.warnings);
  const Eigen::Isometry3f X_WF = transform_to_world(info, "clouds.csv").cast<float>();
  const bool moved = !X_WF.matrix().isIdentity(0);
  if (!cloud_files.empty() && has_ending(cloud_files.front(), ".pcd"))
    read_cloud_file(cloud_files.front(), &recording.warnings);
  clouds.fetch = [cloud_files, X_WF, moved](std::size_t k) {
    Cloud cloud = read_cloud_file(cloud_files[k]);
    for (std::size_t i = 0; moved && i < cloud.size(); ++i) cloud[i] = X_WF * cloud[i];
    return cloud;
  };
  const auto read_images = [&](const char* file, Frames<std::string>& images, bool depth) {
    const auto files = read_index(folder, file, rate_of(info, file), images.time_ns, images.number,
                                  recording.warnings);
    images.fetch = image_files(files, depth);
    if (depth && !files.empty() && !has_intrinsics(info.camera()))
      throw_error(
          "{}/{}: depth without intrinsics, needed camera {{ fx fy cx cy width height }} "
          "or vertical_fov_rad in recording.txtpb",
          folder, file);
  };
  read_images("depth.csv", recording.depth, true);
  read_images("color.csv", recording.color, false);
  if (recording.series.empty() && clouds.size() == 0 && recording.depth.size() == 0) {
    for (const std::string_view file : kTableFiles) {
      if (fs::exists(folder + "/" + std::string(file)))
        throw_error("{}/{}: has a header and no row", folder, file);
    }
    throw_error(
        "{}: nothing of a recording, needed tool.csv, coupon.csv, joints.csv, markers.csv, "
        "clouds.csv or others of docs/formats.md 3",
        folder);
  }
  info.clear_transform();
  info.clear_frame();
  info.set_frame("W");
  return recording;
}

namespace {

/// Rows of several topics, joined by time.
void write_table(const OutputFolder& out, const Recording& recording, std::string_view file) {
  struct Column {
    const Series* series = nullptr;
    std::size_t index = 0;
    int rank = 0;
  };
  std::vector<Column> columns;
  std::vector<const Series*> all;
  std::vector<std::int64_t> times;
  for (const std::string& topic : topics_of(file)) {
    const Series* series = recording.find(topic);
    if (series == nullptr) continue;
    all.push_back(series);
    times.insert(times.end(), series->time_ns.begin(), series->time_ns.end());
    for (std::size_t k = 0; k < series->columns.size(); ++k)
      columns.push_back({series, k, place_of_column(file, series->columns[k])->rank});
  }
  if (columns.empty()) return;
  std::sort(times.begin(), times.end());
  times.erase(std::unique(times.begin(), times.end()), times.end());
  std::stable_sort(columns.begin(), columns.end(),
                   [](const Column& a, const Column& b) { return a.rank < b.rank; });
  OutputFile table(out.path() / std::string(file));
  std::string line = "t_s";
  for (const Column& column : columns) line += "," + column.series->columns[column.index];
  table.add(line + '\n');
  std::map<const Series*, std::size_t> next;
  for (const std::int64_t time : times) {
    line = print_seconds(time);
    for (const Column& column : columns) {
      const Series& series = *column.series;
      const std::size_t row = next[&series];
      line += ',';
      if (row >= series.rows() || series.time_ns[row] != time) continue;
      const double value = series.at(row, column.index);
      if (!std::isnan(value)) fmt::format_to(std::back_inserter(line), "{}", value);
    }
    for (const Series* series : all) {
      std::size_t& row = next[series];
      if (row < series->rows() && series->time_ns[row] == time) ++row;
    }
    table.add(line + '\n');
  }
  table.close();
}

template <typename T, typename Encode>
void write_frames(const OutputFolder& out, const Frames<T>& frames, const std::string& kind,
                  const std::string& extension, Encode encode) {
  if (frames.size() == 0) return;
  fs::create_directory(out.path() / kind);
  std::string index = "t_s,file\n";
  for (std::size_t k = 0; k < frames.size(); ++k) {
    const std::string name = fmt::format("{}/{:06}{}", kind, frames.number[k], extension);
    out.write(name, encode(frames.fetch(k)));
    index += fmt::format("{},{}\n", print_seconds(frames.time_ns[k]), name);
  }
  out.write(kind + ".csv", index);
}

}  // namespace

void write_recording_files(const Recording& recording, const OutputFolder& out) {
  for (const std::string_view file : kTableFiles) write_table(out, recording, file);
  const auto as_it_is = [](const std::string& png) { return png; };
  write_frames(out, recording.clouds, "clouds", ".ply", encode_ply);
  write_frames(out, recording.depth, "depth", ".png", as_it_is);
  write_frames(out, recording.color, "color", ".png", as_it_is);
  pb::RecordingInfo info = recording.info;
  if (info.has_scene_text()) {
    out.write("scene.txtpb", info.scene_text());
    info.set_scene("scene.txtpb");
    info.clear_scene_text();
  }
  if (info.has_scene_believed_text()) {
    out.write("scene_believed.txt", info.scene_believed_text());
    if (info.has_scene()) throw_error("{}: two believed scenes", out.path().string());
    info.clear_scene_believed_text();
  }
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(info, &text));
  out.write("recording.txtpb", text);
}

void write_recording_folder(const Recording& recording, const std::string& folder) {
  OutputFolder out(folder);
  out.begin();
  write_recording_files(recording, out);
  out.finish();
}

}  // namespace omentum

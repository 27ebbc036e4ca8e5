#include "mismatch/recording_folder.h"

#include <fmt/format.h>
#include <google/protobuf/text_format.h>

#include <filesystem>
#include <iterator>

#include "core/check.h"
#include "core/ply.h"

namespace omentum {
namespace {

/// Fifteen digits: 10 us on a clock that began in 1970.
std::string time_stamp(double t) { return fmt::format("{:.15g}", t); }

/// Nine digits: 1 nm over a metre, so that a file read back is the same to far below any floor.
void add_vector(std::string& line, const Eigen::Vector3d& v) {
  fmt::format_to(std::back_inserter(line), ",{:.9g},{:.9g},{:.9g}", v.x(), v.y(), v.z());
}

std::string tool_table(const ToolTrack& commands, const SimulatedRecording& recording) {
  const bool jaw = !commands.jaw_rad.empty();
  std::string text =
      "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,tip_measured_x_m,"
      "tip_measured_y_m,tip_measured_z_m";
  text += jaw ? ",jaw_commanded_rad\n" : "\n";
  for (std::size_t i = 0; i < recording.time.size(); ++i) {
    text += time_stamp(recording.time[i]);
    add_vector(text, commands.tip_at(recording.time[i]));
    add_vector(text, recording.measured_tip[i]);
    if (jaw) text += fmt::format(",{:.9g}", commands.jaw_at(recording.time[i]));
    text += '\n';
  }
  return text;
}

std::string joint_table(const SimulatedRecording& recording) {
  std::string text = "t_s";
  for (int j = 1; j <= 6; ++j) {
    const char* unit = j == 3 ? "m" : "rad";
    text += fmt::format(",q{0}_commanded_{1},q{0}_measured_{1},effort{0}_{2}", j, unit,
                        j == 3 ? "N" : "Nm");
  }
  text += '\n';
  for (std::size_t i = 0; i < recording.arm.size(); ++i) {
    text += time_stamp(recording.time[i] + recording.clocks.joints_s());
    const ArmReport& r = recording.arm[i];
    for (std::size_t j = 0; j < 6; ++j)
      text += fmt::format(",{:.9g},{:.9g},{:.9g}", r.commanded[j], r.measured[j], r.effort[j]);
    text += '\n';
  }
  return text;
}

std::string force_table(const SimulatedRecording& recording) {
  std::string text = "t_s,fx_N,fy_N,fz_N\n";
  for (std::size_t i = 0; i < recording.time.size(); ++i) {
    text += time_stamp(recording.time[i] + recording.clocks.force_s());
    add_vector(text, recording.force[i]);
    text += '\n';
  }
  return text;
}

/// Row by row: this is the one large file.
void write_markers(const OutputFolder& folder, const SimulatedRecording& recording) {
  OutputFile file(folder.path() / "markers.csv");
  std::string row = "t_s";
  for (std::size_t k = 0; k < recording.points.front().size(); ++k)
    row += fmt::format(",marker{0}_x_m,marker{0}_y_m,marker{0}_z_m", k);
  file.add(row + '\n');
  for (std::size_t i = 0; i < recording.time.size(); ++i) {
    row = time_stamp(recording.time[i] + recording.clocks.markers_s());
    for (const Eigen::Vector3d& p : recording.points[i]) add_vector(row, p);
    file.add(row + '\n');
  }
  file.close();
}

}  // namespace

void write_recording(OutputFolder& folder, const pb::RecordingInfo& info, const ToolTrack& commands,
                     const SimulatedRecording& recording, const CloudOf& cloud,
                     std::size_t cloud_stride) {
  folder.write("tool.csv", tool_table(commands, recording));
  if (!recording.arm.empty()) folder.write("joints.csv", joint_table(recording));
  folder.write("force.csv", force_table(recording));
  write_markers(folder, recording);
  if (cloud_stride > 0) {
    std::filesystem::create_directory(folder.path() / "clouds");
    std::string index = "t_s,file\n";
    for (std::size_t i = 0; i < recording.time.size(); i += cloud_stride) {
      const std::string name = fmt::format("clouds/{:06}.ply", i);
      folder.write(name, encode_ply(cloud(i)));
      index += fmt::format("{},{}\n", time_stamp(recording.time[i]), name);
    }
    folder.write("clouds.csv", index);
  }
  std::string text;
  OMENTUM_CHECK(google::protobuf::TextFormat::PrintToString(info, &text));
  folder.write("recording.txtpb", text);
  folder.finish();
}

}  // namespace omentum

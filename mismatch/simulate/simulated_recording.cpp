#include "mismatch/simulate/simulated_recording.h"

#include <fmt/format.h>

#include <cmath>

#include "mismatch/recording/table_columns.h"

namespace omentum {
namespace {

/// To 1 nm, so that a table is no longer than it needs to be.
double rounded(double value) { return std::round(value * 1e9) / 1e9; }

void add(std::vector<double>& values, const Eigen::Vector3d& v) {
  for (const double x : v) values.push_back(rounded(x));
}

std::vector<std::int64_t> times_of(const SimulatedRecording& simulated, double clock_s) {
  std::vector<std::int64_t> times;
  for (const double t : simulated.time) times.push_back(std::llround((t + clock_s) * 1e9));
  return times;
}

std::vector<std::string> tip_columns(const char* source) {
  std::vector<std::string> columns;
  for (const char axis : {'x', 'y', 'z'})
    columns.push_back(fmt::format("tip_{}_{}_m", source, axis));
  return columns;
}

/// Commanded or measured side of the joints.
Series joints_of(const SimulatedRecording& simulated, JointColumn::Source source) {
  const bool measured = source == JointColumn::kMeasured;
  Series series;
  series.time_ns = times_of(simulated, simulated.clocks.joints_s());
  for (int j = 1; j <= 6; ++j) {
    const std::string joint = fmt::format("{}", j);
    series.columns.push_back(
        name_of({joint, JointColumn::kPosition, source, is_usually_linear(joint)}));
    if (measured)
      series.columns.push_back(
          name_of({joint, JointColumn::kEffort, source, is_usually_linear(joint)}));
  }
  for (const ArmReport& arm : simulated.arm) {
    for (std::size_t j = 0; j < 6; ++j) {
      series.values.push_back(rounded(measured ? arm.measured[j] : arm.commanded[j]));
      if (measured) series.values.push_back(rounded(arm.effort[j]));
    }
  }
  return series;
}

}  // namespace

Recording make_recording(const pb::RecordingInfo& info, const ToolTrack& commands,
                         const SimulatedRecording& simulated, const CloudOf& cloud,
                         std::size_t cloud_stride) {
  Recording made;
  made.info = info;
  const std::vector<std::int64_t> times = times_of(simulated, 0);
  Series& commanded = made.series["tool_commanded"];
  commanded.columns = tip_columns("commanded");
  commanded.time_ns = times;
  for (const double t : simulated.time) add(commanded.values, commands.tip_at(t));
  Series& tool = made.series["tool"];
  tool.columns = tip_columns("measured");
  tool.time_ns = times;
  for (const Eigen::Vector3d& tip : simulated.measured_tip) add(tool.values, tip);
  if (!commands.jaw_rad.empty()) {
    Series& jaw = made.series["jaw"];
    jaw.columns = {"jaw_commanded_rad"};
    jaw.time_ns = times;
    for (const double t : simulated.time) jaw.values.push_back(rounded(commands.jaw_at(t)));
  }
  if (!simulated.arm.empty()) {
    made.series["joints_commanded"] = joints_of(simulated, JointColumn::kCommanded);
    made.series["joints"] = joints_of(simulated, JointColumn::kMeasured);
  }
  Series& force = made.series["force"];
  force.columns = {"fx_N", "fy_N", "fz_N"};
  force.time_ns = times_of(simulated, simulated.clocks.force_s());
  for (const Eigen::Vector3d& f : simulated.force) add(force.values, f);
  Series& markers = made.series["markers"];
  markers.time_ns = times_of(simulated, simulated.clocks.markers_s());
  for (std::size_t k = 0; k < simulated.points.front().size(); ++k) {
    for (const char axis : {'x', 'y', 'z'})
      markers.columns.push_back(fmt::format("marker{}_{}_m", k, axis));
  }
  for (const std::vector<Eigen::Vector3d>& points : simulated.points) {
    for (const Eigen::Vector3d& p : points) add(markers.values, p);
  }
  for (std::size_t step = 0; cloud_stride > 0 && step < times.size(); step += cloud_stride) {
    made.clouds.time_ns.push_back(times[step]);
    made.clouds.number.push_back(static_cast<std::uint32_t>(step));
  }
  made.clouds.fetch = [cloud, cloud_stride](std::size_t k) { return cloud(k * cloud_stride); };
  return made;
}

}  // namespace omentum

#include "mismatch/intake/contact_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "core/check.h"
#include "mismatch/intake/canvas.h"
#include "mismatch/recording/depth_image.h"

namespace omentum {
namespace {

constexpr Colour kPaper = {255, 255, 255}, kInk = {40, 40, 40}, kGrey = {200, 200, 200},
                 kPanel = {244, 244, 246}, kNight = {24, 26, 32};
constexpr std::array<Colour, 9> kCurves = {{{31, 119, 180},
                                            {214, 39, 40},
                                            {44, 160, 44},
                                            {255, 127, 14},
                                            {148, 103, 189},
                                            {23, 190, 207},
                                            {140, 86, 75},
                                            {227, 119, 194},
                                            {127, 127, 127}}};
constexpr int kWidth = 1200, kMargin = 12, kLine = 16;
constexpr int kPictures = 6, kPictureHeight = 150, kCurveHeight = 90;
constexpr int kPitch = (kWidth - 2 * kMargin) / kPictures, kPictureWidth = kPitch - 8;
constexpr std::size_t kSparse = 20'000;   // points of a cloud that are drawn larger
constexpr std::size_t kManyColumns = 9;   // more are drawn from where each began
constexpr std::size_t kMostColumns = 60;  // of markers some tell enough

double seconds(std::int64_t time_ns) { return 1e-9 * static_cast<double>(time_ns); }

/// Up to six, evenly chosen.
std::vector<std::size_t> shown_of(std::size_t count) {
  std::vector<std::size_t> list;
  const std::size_t wanted = std::min<std::size_t>(count, kPictures);
  for (std::size_t k = 0; k < wanted; ++k)
    list.push_back(wanted > 1 ? k * (count - 1) / (wanted - 1) : 0);
  return list;
}

/// Value below which a share of them lies.
double percentile(std::vector<double> values, double share) {
  if (values.empty()) return 0;
  const auto at =
      values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// Columns of one unit of a channel.
struct Curves {
  std::string topic, unit;
  const Series* series = nullptr;
  std::vector<std::size_t> columns;
};

std::vector<Curves> curves_of(const Recording& recording) {
  std::vector<Curves> all;
  for (const auto& [topic, series] : recording.series) {
    std::map<std::string, std::vector<std::size_t>> by_unit;
    const std::size_t stride = std::max<std::size_t>(1, series.columns.size() / kMostColumns);
    for (std::size_t k = 0; k < series.columns.size(); k += stride) {
      const std::string& name = series.columns[k];
      std::string unit = name.substr(name.rfind('_') + 1);
      if (name.ends_with("_per_s")) unit = name.find("_m_per") != name.npos ? "m/s" : "rad/s";
      if (unit.size() == 2 && unit.front() == 'q') unit = "quaternion";
      by_unit[unit].push_back(k);
    }
    for (const auto& [unit, columns] : by_unit) all.push_back({topic, unit, &series, columns});
  }
  return all;
}

class Sheet {
 public:
  explicit Sheet(const Recording& recording)
      : recording_(recording), curves_(curves_of(recording)), canvas_(kWidth, height(), kPaper) {}

  std::string draw() {
    find_times();
    const pb::RecordingInfo& info = recording_.info;
    canvas_.text(kMargin, y_,
                 fmt::format("{}   {:.4g} ... {:.4g} s{}", info.name(), begin_, end_,
                             info.held_out() ? "   held out" : ""),
                 kInk);
    y_ += 2 * kLine;
    clouds();
    depth();
    color();
    for (const Curves& curves : curves_) draw(curves);
    return canvas_.png();
  }

 private:
  int height() const {
    const int rows = (recording_.clouds.size() > 0 ? 1 : 0) +
                     (recording_.depth.size() > 0 ? 1 : 0) + (recording_.color.size() > 0 ? 1 : 0);
    return kMargin + 3 * kLine + rows * (kPictureHeight + 2 * kLine) +
           static_cast<int>(curves_.size()) * (kCurveHeight + 2 * kLine);
  }

  void find_times() {
    begin_ = std::numeric_limits<double>::infinity();
    end_ = -begin_;
    const auto extend = [&](const std::vector<std::int64_t>& times) {
      if (times.empty()) return;
      begin_ = std::min(begin_, seconds(times.front()));
      end_ = std::max(end_, seconds(times.back()));
    };
    for (const auto& [topic, series] : recording_.series) extend(series.time_ns);
    extend(recording_.clouds.time_ns);
    extend(recording_.depth.time_ns);
    extend(recording_.color.time_ns);
    if (!(end_ > begin_)) end_ = begin_ + 1;
  }

  /// One row of pictures; `draw(k, x, y)` fills the box of frame k.
  template <typename Draw>
  void row(const char* what, const std::vector<std::int64_t>& times, Draw draw_frame) {
    canvas_.text(kMargin, y_, fmt::format("{}: {} frames", what, times.size()), kInk);
    y_ += kLine;
    int x = kMargin;
    for (const std::size_t k : shown_of(times.size())) {
      canvas_.box(x, y_, kPictureWidth, kPictureHeight, kNight);
      draw_frame(k, x, y_);
      const std::string label = fmt::format("{:.3f} s", seconds(times[k]));
      canvas_.box(x, y_, 8 * static_cast<int>(label.size()) + 8, kLine, kNight);
      canvas_.text(x + 4, y_ + 3, label, kPaper);
      marks_.push_back(seconds(times[k]));
      x += kPitch;
    }
    y_ += kPictureHeight + kLine;
  }

  void clouds() {
    const Frames<Cloud>& frames = recording_.clouds;
    if (frames.size() == 0) return;
    std::map<std::size_t, Cloud> shown;
    std::array<std::vector<double>, 3> values;
    for (const std::size_t k : shown_of(frames.size())) {
      for (const Eigen::Vector3f& p : shown[k] = frames.fetch(k)) {
        for (Eigen::Index axis = 0; axis < 3; ++axis)
          values[static_cast<std::size_t>(axis)].push_back(double{p[axis]});
      }
    }
    std::array<double, 3> low = {}, high = {};
    for (std::size_t axis = 0; axis < 3; ++axis) {
      low[axis] = percentile(values[axis], 0.02);
      high[axis] = percentile(values[axis], 0.98);
    }
    const double width = 1.1 * std::max(high[0] - low[0], 1e-6);
    const double depth = 1.1 * std::max(high[1] - low[1], 1e-6);
    const double scale = std::min(kPictureWidth / width, kPictureHeight / depth);
    const std::string what = fmt::format(
        "clouds from above, {:.0f} x {:.0f} mm, heights {:.1f} ... {:.1f} mm",
        1e3 * kPictureWidth / scale, 1e3 * kPictureHeight / scale, 1e3 * low[2], 1e3 * high[2]);
    row(what.c_str(), frames.time_ns, [&](std::size_t k, int x, int y) {
      for (const Eigen::Vector3f& p : shown[k]) {
        const double u = 0.5 * kPictureWidth + scale * (double{p.x()} - 0.5 * (low[0] + high[0]));
        const double v = 0.5 * kPictureHeight - scale * (double{p.y()} - 0.5 * (low[1] + high[1]));
        if (!(u >= 0 && v >= 0 && u < kPictureWidth && v < kPictureHeight)) continue;
        const double share = (double{p.z()} - low[2]) / std::max(high[2] - low[2], 1e-9);
        const int dot = shown[k].size() < kSparse ? 2 : 1;
        canvas_.box(x + static_cast<int>(u), y + static_cast<int>(v), dot, dot,
                    height_colour(share));
      }
    });
  }

  void depth() {
    const Frames<std::string>& frames = recording_.depth;
    if (frames.size() == 0) return;
    std::map<std::size_t, DepthImage> shown;
    std::vector<double> values;
    for (const std::size_t k : shown_of(frames.size())) {
      Result<DepthImage> image = parse_depth_png(fmt::format("/depth {}", k), frames.fetch(k));
      if (!image) throw_error("{}", image.error());
      constexpr std::size_t kStride = 7;  // enough for two percentiles
      for (std::size_t i = 0; i < image.value().depth.size(); i += kStride) {
        if (image.value().depth[i] > 0) values.push_back(image.value().depth[i]);
      }
      shown[k] = std::move(image).value();
    }
    const double low = percentile(values, 0.02), high = percentile(values, 0.98);
    const double unit = 1e3 * recording_.info.depth_unit_m();
    row(fmt::format("depth {:.0f} ... {:.0f} mm, near is bright", unit * low, unit * high).c_str(),
        frames.time_ns, [&](std::size_t k, int x, int y) {
          const DepthImage& image = shown[k];
          Picture picture{image.width, image.height, {}};
          for (const std::uint16_t z : image.depth) {
            const Colour colour =
                z == 0 ? kNight : height_colour((high - z) / std::max(high - low, 1.0));
            picture.rgb.insert(picture.rgb.end(), colour.begin(), colour.end());
          }
          canvas_.picture(x, y, kPictureWidth, kPictureHeight, picture);
        });
  }

  void color() {
    const Frames<std::string>& frames = recording_.color;
    if (frames.size() == 0) return;
    row("colour", frames.time_ns, [&](std::size_t k, int x, int y) {
      const Result<Picture> picture = parse_picture(fmt::format("/color {}", k), frames.fetch(k));
      if (!picture) throw_error("{}", picture.error());
      canvas_.picture(x, y, kPictureWidth, kPictureHeight, picture.value());
    });
  }

  void draw(const Curves& curves) {
    const Series& series = *curves.series;
    const bool moved = curves.columns.size() > kManyColumns;
    std::vector<double> begin(series.columns.size(), 0);
    for (std::size_t c = 0; moved && c < curves.columns.size(); ++c) {
      const std::size_t k = curves.columns[c];
      std::size_t at = 0;
      while (at + 1 < series.rows() && std::isnan(series.at(at, k))) ++at;
      begin[k] = series.at(at, k);
    }
    double low = std::numeric_limits<double>::infinity(), high = -low;
    for (std::size_t at = 0; at < series.rows(); ++at) {
      for (const std::size_t k : curves.columns) {
        low = std::fmin(low, series.at(at, k) - begin[k]);
        high = std::fmax(high, series.at(at, k) - begin[k]);
      }
    }
    if (!(high >= low)) return;
    canvas_.text(kMargin, y_,
                 fmt::format("/{} ({}{}): {} rows, {:.4g} ... {:.4g}", curves.topic, curves.unit,
                             moved ? ", from the first" : "", series.rows(), low, high),
                 kInk);
    int x = kWidth / 2;
    for (std::size_t k = 0; k < curves.columns.size() && x < kWidth - 100; ++k) {
      const std::string& name = series.columns[curves.columns[k]];
      canvas_.text(x, y_, name, kCurves[k % kCurves.size()]);
      x += 8 * static_cast<int>(name.size() + 2);
    }
    y_ += kLine;
    const int width = kWidth - 2 * kMargin;
    canvas_.box(kMargin, y_, width, kCurveHeight, kPanel);
    const auto x_at = [&](double t) {
      return kMargin + (t - begin_) / (end_ - begin_) * (width - 1);
    };
    for (const double t : marks_) canvas_.line(x_at(t), y_, x_at(t), y_ + kCurveHeight - 1, kGrey);
    constexpr int kEdge = 4;
    const double range = std::max(high - low, 1e-300);
    const auto y_at = [&](double value) {
      return y_ + kCurveHeight - 1 - kEdge - (value - low) / range * (kCurveHeight - 1 - 2 * kEdge);
    };
    for (std::size_t c = 0; c < curves.columns.size(); ++c) {
      double x0 = 0, y0 = std::numeric_limits<double>::quiet_NaN();
      for (std::size_t at = 0; at < series.rows(); ++at) {
        const double value = series.at(at, curves.columns[c]) - begin[curves.columns[c]];
        if (std::isnan(value)) continue;
        const double x1 = x_at(seconds(series.time_ns[at])), y1 = y_at(value);
        if (!std::isnan(y0)) canvas_.line(x0, y0, x1, y1, kCurves[c % kCurves.size()]);
        x0 = x1;
        y0 = y1;
      }
    }
    y_ += kCurveHeight + kLine;
  }

  const Recording& recording_;
  std::vector<Curves> curves_;
  Canvas canvas_;
  int y_ = kMargin;
  double begin_ = 0, end_ = 1;
  std::vector<double> marks_;  ///< times of the pictures
};

}  // namespace

std::string make_contact_sheet(const Recording& recording) { return Sheet(recording).draw(); }

}  // namespace omentum

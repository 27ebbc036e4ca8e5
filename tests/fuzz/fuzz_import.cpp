#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>

#include "core/check.h"
#include "core/config.h"
#include "mismatch/import/file_pattern.h"
#include "mismatch/import/import_map.h"
#include "mismatch/import/npy.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/pcd.h"
#include "mismatch/recording/png_image.h"
#include "mismatch/recording/recording_mcap.h"
#include "mismatch/recording/text_table.h"

// Any bytes, given to every parser of files that recordings come in: a table, a cloud, an array, an
// archive, a picture, a message, a mapping file. Each gives a whole result or one line.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

void require(bool good) {
  if (!good) __builtin_trap();
}

template <typename T>
void require_one_line(const omentum::Result<T>& result) {
  if (result) return;
  require(!result.error().empty() && result.error().find('\n') == std::string::npos);
}

void read_table(const std::string& bytes, const omentum::TextFormat& format) {
  try {
    const omentum::TextTable table("fuzz", bytes, format);
    for (std::size_t row = 0; row < table.rows(); ++row) {
      for (std::size_t k = 0; k < table.names().size(); ++k) {
        try {
          require(!std::isinf(table.number(row, k)));
        } catch (const omentum::Error& error) {
          require(std::string(error.what()).starts_with("fuzz:"));
        }
      }
    }
  } catch (const omentum::Error& error) {
    const std::string said = error.what();
    require(said.starts_with("fuzz:") && said.find('\n') == std::string::npos);
  }
}

void read_array(const std::string& bytes) {
  const omentum::Result<omentum::NpyArray> array = omentum::NpyArray::parse("fuzz", bytes);
  require_one_line(array);
  if (!array) return;
  std::vector<std::size_t> last = array.value().shape();
  for (std::size_t& index : last) {
    if (index == 0) return;
    --index;
  }
  array.value().at(last);
  array.value().at(std::vector<std::size_t>(last.size(), 0));
}

void read_map(const std::string& bytes) {
  omentum::pb::ImportMap map;
  try {
    omentum::parse_text_proto("fuzz", bytes, map);
    for (const omentum::pb::SourceMap& source : map.source()) {
      const auto pattern = omentum::FilePattern::parse(source.files());
      require_one_line(pattern);
      if (pattern) pattern.value().match("a_b1/c_22.csv");
    }
    omentum::pb::RecordingInfo info;
    for (const std::string& set : map.set()) {
      require_one_line(omentum::fill_in(set, {{"a", "1"}}));
      omentum::set_info_field(info, set, "set");
    }
  } catch (const omentum::Error& error) {
    require(std::string(error.what()).find('\n') == std::string::npos);
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string bytes;
  for (std::size_t k = 0; k < size; ++k) bytes.push_back(static_cast<char>(data[k]));
  read_table(bytes, {});
  omentum::TextFormat odd;
  odd.delimiter.assign(1, ' ');
  odd.comment.assign(1, '#');
  odd.decimal_comma = true;
  odd.header = false;
  odd.unknown = {"-"};
  read_table(bytes, odd);
  read_array(bytes);
  read_map(bytes);
  const auto points = omentum::parse_pcd("fuzz", bytes);
  require_one_line(points);
  if (points) {
    for (const Eigen::Vector3f& p : points.value()) require(p.allFinite());
  }
  require_one_line(omentum::parse_npz_entry("fuzz", bytes, "a"));
  const auto image = omentum::parse_depth_png("fuzz", bytes);
  require_one_line(image);
  if (image)
    require(image.value().depth.size() == std::size_t{image.value().width} * image.value().height);
  const auto picture = omentum::parse_picture("fuzz", bytes);
  require_one_line(picture);
  if (picture)
    require(picture.value().rgb.size() ==
            3 * std::size_t{picture.value().width} * picture.value().height);
  require_one_line(omentum::decode_cloud(bytes));
  return 0;
}

#include "mismatch/import/npy.h"

#include <fmt/format.h>
#include <zip.h>

#include <algorithm>
#include <cstring>
#include <memory>
#include <optional>

#include "core/csv.h"
#include "core/table.h"
#include "mismatch/import/read_number.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

constexpr std::size_t kMostItems = 500'000'000;
constexpr std::uint64_t kMostBytes = 1'000'000'000;

/// Text behind 'key': in the header, which is a dictionary of Python.
std::optional<std::string_view> member(std::string_view header, std::string_view key) {
  const std::size_t at = header.find(fmt::format("'{}':", key));
  if (at == std::string_view::npos) return std::nullopt;
  std::string_view rest = header.substr(at + key.size() + 3);
  rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
  return rest;
}

}  // namespace

Result<NpyArray> NpyArray::parse(const std::string& name, std::string bytes) {
  const auto wrong = [&name](const std::string& what) {
    return Failure{fmt::format("{}: {}", name, what)};
  };
  constexpr std::string_view kMagic = "\x93NUMPY";
  if (!bytes.starts_with(kMagic) || bytes.size() < 12) return wrong("no NPY");
  const int version = bytes[6];
  if (version < 1 || version > 3) return wrong("an NPY of a version that is not known");
  std::uint32_t length = 0;
  std::memcpy(&length, bytes.data() + 8, version == 1 ? 2 : 4);
  const std::size_t begin = version == 1 ? 10 : 12;
  if (length > bytes.size() - begin) return wrong("the file ends in the header");
  const std::string header = bytes.substr(begin, length);
  NpyArray array;
  array.body_ = begin + length;
  const auto type = member(header, "descr"), order = member(header, "fortran_order"),
             shape = member(header, "shape");
  if (!type || !order || !shape || shape->find(')') == std::string_view::npos)
    return wrong("a header without descr, fortran_order or shape");
  if (type->size() < 5 || (*type)[0] != '\'' || (*type)[4] != '\'')
    return wrong(
        fmt::format("values of type {}, needed one number each", shown(type->substr(0, 8))));
  const char endian = (*type)[1];
  array.kind_ = (*type)[2];
  array.item_ = static_cast<std::size_t>((*type)[3] - '0');
  array.swapped_ = endian == '>';
  const bool whole = (array.kind_ == 'i' || array.kind_ == 'u') &&
                     (array.item_ == 1 || array.item_ == 2 || array.item_ == 4 || array.item_ == 8);
  const bool real = array.kind_ == 'f' && (array.item_ == 4 || array.item_ == 8);
  if (!(whole || real || (array.kind_ == 'b' && array.item_ == 1)) ||
      std::string_view("<>|=").find(endian) == std::string_view::npos)
    return wrong(fmt::format("values of type {}, needed whole numbers or floats of 32 or 64 bits",
                             shown(type->substr(0, 5))));
  std::string inside(shape->substr(1, shape->find(')') - 1));
  std::replace(inside.begin(), inside.end(), ',', ' ');
  std::size_t items = 1;
  std::string_view rest = inside;
  while (true) {
    rest.remove_prefix(std::min(rest.find_first_not_of(' '), rest.size()));
    if (rest.empty()) break;
    const std::string_view word = rest.substr(0, rest.find(' '));
    rest.remove_prefix(word.size());
    const auto size = parse_number(word);
    if (!size || !(*size >= 0) || *size > static_cast<double>(kMostItems) ||
        array.shape_.size() > 8)
      return wrong("a shape that cannot be read");
    array.shape_.push_back(static_cast<std::size_t>(*size));
    if (array.shape_.back() > 0 && items > kMostItems / array.shape_.back())
      return wrong(fmt::format("more than {} values", kMostItems));
    items *= array.shape_.back();
  }
  if ((bytes.size() - array.body_) / array.item_ < items)
    return wrong(fmt::format("the file ends in value {} of {}",
                             (bytes.size() - array.body_) / array.item_, items));
  array.stride_.resize(array.shape_.size());
  std::size_t stride = 1;
  const bool fortran = order->starts_with("True");
  for (std::size_t k = 0; k < array.shape_.size(); ++k) {
    const std::size_t axis = fortran ? k : array.shape_.size() - 1 - k;
    array.stride_[axis] = stride;
    stride *= array.shape_[axis];
  }
  array.bytes_ = std::move(bytes);
  return array;
}

double NpyArray::at(const std::vector<std::size_t>& index) const {
  std::size_t item = 0;
  for (std::size_t k = 0; k < index.size(); ++k) item += index[k] * stride_[k];
  const char* bytes = bytes_.data() + body_ + item * item_;
  switch (kind_ == 'f' ? 'f' : kind_ == 'i' ? 'i' : 'u') {
    case 'f':
      return item_ == 4 ? read_as<float>(bytes, swapped_) : read_as<double>(bytes, swapped_);
    case 'i':
      return item_ == 1   ? read_as<std::int8_t>(bytes, swapped_)
             : item_ == 2 ? read_as<std::int16_t>(bytes, swapped_)
             : item_ == 4 ? read_as<std::int32_t>(bytes, swapped_)
                          : read_as<std::int64_t>(bytes, swapped_);
    default:
      return item_ == 1   ? read_as<std::uint8_t>(bytes, swapped_)
             : item_ == 2 ? read_as<std::uint16_t>(bytes, swapped_)
             : item_ == 4 ? read_as<std::uint32_t>(bytes, swapped_)
                          : read_as<std::uint64_t>(bytes, swapped_);
  }
}

Result<std::string> parse_npz_entry(const std::string& name, std::string_view bytes,
                                    const std::string& array) {
  const auto wrong = [&name](const std::string& what) {
    return Failure{fmt::format("{}: {}", name, what)};
  };
  zip_error_t error;
  zip_error_init(&error);
  zip_source_t* source = zip_source_buffer_create(bytes.data(), bytes.size(), 0, &error);
  zip_t* opened = source == nullptr ? nullptr : zip_open_from_source(source, ZIP_RDONLY, &error);
  const std::string reason = zip_error_strerror(&error);
  zip_error_fini(&error);
  if (opened == nullptr) {
    if (source != nullptr) zip_source_free(source);
    return wrong(fmt::format("no NPZ: {}", reason));
  }
  const std::unique_ptr<zip_t, decltype(&zip_discard)> archive(opened, zip_discard);
  const zip_int64_t index = zip_name_locate(opened, (array + ".npy").c_str(), 0);
  if (index < 0) {
    std::string known;
    for (zip_int64_t k = 0; k < std::min<zip_int64_t>(zip_get_num_entries(opened, 0), 20); ++k) {
      const char* entry = zip_get_name(opened, static_cast<zip_uint64_t>(k), 0);
      known += fmt::format(" {}", entry == nullptr ? "?" : shown(entry));
    }
    return wrong(fmt::format("no array {}.npy, there are{}", shown(array), known));
  }
  zip_stat_t stat;
  if (zip_stat_index(opened, static_cast<zip_uint64_t>(index), 0, &stat) != 0 ||
      (stat.valid & ZIP_STAT_SIZE) == 0)
    return wrong("an array without size");
  // Deflate packs at most to a thousandth: more is a lie.
  if (stat.size > kMostBytes || stat.size / 1100 > bytes.size())
    return wrong(fmt::format("an array of {} bytes, too many", stat.size));
  std::unique_ptr<zip_file_t, decltype(&zip_fclose)> file(
      zip_fopen_index(opened, static_cast<zip_uint64_t>(index), 0), zip_fclose);
  std::string content(static_cast<std::size_t>(stat.size), '\0');
  if (!file || zip_fread(file.get(), content.data(), content.size()) !=
                   static_cast<zip_int64_t>(content.size()))
    return wrong(fmt::format("array {} is damaged", shown(array)));
  return content;
}

Result<std::string> read_npz_entry(const std::string& path, const std::string& array) {
  return parse_npz_entry(path, read_whole_file(path), array);
}

}  // namespace omentum

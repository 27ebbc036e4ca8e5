#include "mismatch/import/import_map.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <numeric>
#include <set>

#include "core/check.h"
#include "core/config.h"
#include "core/file_name.h"
#include "core/table.h"
#include "mismatch/import/array.h"
#include "mismatch/import/rigid.h"
#include "mismatch/import/source.h"
#include "mismatch/import/units.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/recording/plain_folder.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

/// A file of a source.
struct Match {
  std::string path;
  Values parts;
};

/// The files of every source of one recording, before its rows are split.
struct Group {
  Values parts;
  std::vector<std::vector<Match>> files;  ///< of each source; several of frames alone
};

template <typename T>
T required(Result<T> result, const std::string& where) {
  if (!result) throw_error("{}: {}", where, result.error());
  return std::move(result).value();
}

bool is_array(const std::string& path) {
  return has_ending(path, ".npy") || has_ending(path, ".npz");
}

/// Whether what both name is the same text.
bool agree(const Values& a, const Values& b) {
  return std::all_of(a.begin(), a.end(), [&b](const auto& part) {
    const auto other = b.find(part.first);
    return other == b.end() || other->second == part.second;
  });
}

std::vector<Match> matches_of(const pb::SourceMap& source, const std::vector<std::string>& paths) {
  const FilePattern pattern = required(FilePattern::parse(source.files()), "source.files");
  std::vector<Match> matches;
  for (const std::string& path : paths) {
    if (auto parts = pattern.match(path)) matches.push_back({path, std::move(*parts)});
  }
  return matches;
}

/// Parts of the names of files that are frames which tell frames of one recording apart.
void drop_time_part(const pb::SourceMap& source, Values& parts) {
  if (!source.has_frames()) return;
  std::erase_if(parts, [&](const auto& part) {
    return source.time().value().find("{" + part.first + "}") != std::string::npos;
  });
}

/// The first source says which recordings there are.
std::vector<Group> make_groups(const pb::ImportMap& map, const std::string& folder) {
  if (map.source().empty()) throw_error("source: none, needed one");
  const std::vector<std::string> paths = files_below(folder);
  std::vector<Group> groups;
  for (int k = 0; k < map.source_size(); ++k) {
    const pb::SourceMap& source = map.source(k);
    const std::vector<Match> matches = matches_of(source, paths);
    if (matches.empty() && !source.optional_files())
      throw_error("{}: no file fits source.files \"{}\"", folder, source.files());
    for (const Match& match : matches) {
      Values parts = match.parts;
      drop_time_part(source, parts);
      if (k == 0) {
        const auto known = std::find_if(groups.begin(), groups.end(),
                                        [&](const Group& group) { return group.parts == parts; });
        const bool joins = source.has_frames() && known != groups.end();
        if (!joins) groups.push_back({parts, {}});
        Group& group = joins ? *known : groups.back();
        group.files.resize(static_cast<std::size_t>(map.source_size()));
        group.files[0].push_back(match);
        continue;
      }
      for (Group& group : groups) {
        if (agree(parts, group.parts)) group.files[static_cast<std::size_t>(k)].push_back(match);
      }
    }
    for (Group& group : groups) {
      const auto& files = group.files[static_cast<std::size_t>(k)];
      if (files.empty() && !source.optional_files())
        throw_error("{}: source.files \"{}\": no file for the recording of {}", folder,
                    source.files(), group.files[0].front().path);
      if (files.size() > 1 && !source.has_frames())
        throw_error("{}: source.files \"{}\": {} and {} for the recording of {}, needed one",
                    folder, source.files(), files[0].path, files[1].path,
                    group.files[0].front().path);
      for (const Match& match : files) {
        Values parts = match.parts;
        drop_time_part(source, parts);
        group.parts.insert(parts.begin(), parts.end());
      }
    }
  }
  return groups;
}

/// Files that are one frame each.
void add_frame_files(const pb::SourceMap& source, const std::string& folder,
                     const std::vector<Match>& files, const Values& values,
                     const Eigen::Isometry3d& X_WF, Recording& recording) {
  std::vector<std::pair<std::int64_t, std::string>> frames;
  for (std::size_t k = 0; k < files.size(); ++k) {
    Values own = values;
    for (const auto& [name, text] : files[k].parts) own[name] = text;
    std::vector<std::size_t> rows(source.time().has_value() ? 1 : files.size());
    const auto times = row_times(source, nullptr, rows, own, {});
    frames.emplace_back(times[source.time().has_value() ? 0 : k], folder + "/" + files[k].path);
  }
  std::stable_sort(frames.begin(), frames.end(),
                   [](const auto& a, const auto& b) { return a.first < b.first; });
  std::vector<std::string> paths;
  std::vector<std::int64_t> times;
  for (const auto& [time, path] : frames) {
    if (!times.empty() && time == times.back())
      throw_error("{}: the time of {} as well", path, paths.back());
    times.push_back(time);
    paths.push_back(path);
  }
  const auto fill = [&](auto& to) {
    if (to.size() > 0) throw_error("source.frames: two sources of {}", source.frames());
    to.time_ns = times;
    to.number.resize(times.size());
    std::iota(to.number.begin(), to.number.end(), 0U);
  };
  if (source.frames() == "clouds") {
    fill(recording.clouds);
    const bool moved = !X_WF.matrix().isIdentity(0);
    if (!paths.empty() && has_ending(paths.front(), ".pcd"))
      read_cloud_file(paths.front(), &recording.warnings);
    recording.clouds.fetch = [paths, X = Eigen::Isometry3f(X_WF.cast<float>()),
                              moved](std::size_t k) {
      Cloud cloud = read_cloud_file(paths[k]);
      for (std::size_t i = 0; moved && i < cloud.size(); ++i) cloud[i] = X * cloud[i];
      return cloud;
    };
    return;
  }
  const bool depth = source.frames() == "depth";
  if (!depth && source.frames() != "color")
    throw_error("source.frames: \"{}\", allowed clouds, depth, color", shown(source.frames()));
  Frames<std::string>& images = depth ? recording.depth : recording.color;
  fill(images);
  images.fetch = image_files(paths, depth);
}

/// One recording: block `b` of the first source.
class Builder {
 public:
  Builder(const pb::ImportMap& map, const std::string& folder, const Group& group)
      : map_(map), folder_(folder), group_(group) {
    // Tables are read once, not once a block.
    for (int k = 0; k < map.source_size(); ++k) {
      const auto& files = group.files[static_cast<std::size_t>(k)];
      tables_.emplace_back();
      blocks_.emplace_back();
      if (files.empty() || map.source(k).has_frames() || is_array(files.front().path)) continue;
      tables_.back() = read_source_table(map.source(k), folder + "/" + files.front().path);
      blocks_.back() = split_rows(map.source(k), *tables_.back());
    }
  }

  std::size_t count() const { return tables_[0] ? blocks_[0].size() : 1; }

  void make(std::size_t block, const TakeRecording& take) const {
    Recording recording;
    Values values = group_.parts;
    values["file"] = fs::path(group_.files[0].front().path).stem().string();
    if (tables_[0]) {
      for (const auto& [name, text] : blocks_[0][block].values) values[name] = text;
    }
    std::map<std::string, std::vector<std::int64_t>> times;
    for (int k = 0; k < map_.source_size(); ++k) add_source(k, values, times, recording);
    const std::string name = required(fill_in(map_.name(), values), "name");
    recording.info = mapped_info(map_, values, name);
    if (recording.depth.size() > 0 && !has_intrinsics(recording.info.camera()))
      throw_error("{}: depth without intrinsics, needed info.camera of the mapping file", name);
    if (recording.series.empty() && recording.clouds.size() == 0 && recording.depth.size() == 0)
      throw_error("{}: nothing of a recording in it", name);
    take(name, recording);
  }

 private:
  void add_source(int k, Values& values, std::map<std::string, std::vector<std::int64_t>>& times,
                  Recording& recording) const {
    const pb::SourceMap& source = map_.source(k);
    const auto at = static_cast<std::size_t>(k);
    if (group_.files[at].empty()) return;
    const std::string path = folder_ + "/" + group_.files[at].front().path;
    const TextTable* table = tables_[at] ? &*tables_[at] : nullptr;
    add_values(source, folder_, table, values);
    const Eigen::Isometry3d X_WF =
        make_transform(source.transform(), folder_, values, recording.warnings);
    std::vector<std::int64_t> rows_at;
    if (source.has_frames()) {
      add_frame_files(source, folder_, group_.files[at], values, X_WF, recording);
    } else if (table == nullptr) {
      const ArrayShape shape = array_shape(source, path);
      rows_at = row_times(source, nullptr, std::vector<std::size_t>(shape.times), values, times);
      add_array(source, path, rows_at, X_WF, recording);
    } else {
      const std::vector<std::string>& passed = table->warnings();
      recording.warnings.insert(recording.warnings.end(), passed.begin(), passed.end());
      std::vector<std::size_t> rows = rows_of(at, values).rows;
      rows_at = row_times(source, table, rows, values, times);
      if (source.has_name()) times[source.name()] = rows_at;
      const std::string& timed = source.time().column();
      keep_increasing(*table, table->find(timed).value_or(0), rows, rows_at, recording.warnings);
      std::map<std::string, Series> found;
      add_columns(source, *table, rows, rows_at, values, found);
      add_series(path, X_WF, std::move(found), recording);
    }
    if (source.has_name()) times.try_emplace(source.name(), rows_at);
  }

  /// The block of a source that agrees with the values of the recording.
  const RowBlock& rows_of(std::size_t source, const Values& values) const {
    for (const RowBlock& block : blocks_[source]) {
      const bool whole = !map_.source(static_cast<int>(source)).has_split();
      if (whole || agree(block.values, values)) return block;
    }
    throw_error("{}: no rows for the recording of {}", tables_[source]->path(), values.at("file"));
  }

  const pb::ImportMap& map_;
  const std::string& folder_;
  const Group& group_;
  std::vector<std::optional<TextTable>> tables_;
  std::vector<std::vector<RowBlock>> blocks_;
};

}  // namespace

std::vector<std::string> files_below(const std::string& folder) {
  constexpr std::size_t kMost = 1'000'000;
  std::vector<std::string> paths;
  for (auto entries = fs::recursive_directory_iterator(folder); entries != fs::end(entries);
       ++entries) {
    const fs::directory_entry& entry = *entries;
    // "._a.csv" of a Mac, ".git": nobody's recordings.
    const bool hidden = is_hidden(entry.path().string());
    if (hidden && entry.is_directory()) entries.disable_recursion_pending();
    if (hidden || !entry.is_regular_file()) continue;
    paths.push_back(fs::relative(entry.path(), folder).generic_string());
    if (paths.size() > kMost) throw_error("{}: more than {} files", folder, kMost);
  }
  std::sort(paths.begin(), paths.end());
  return paths;
}

namespace {

/// {values} in the texts of a message, but for whole scenes, which have braces of their own.
void fill_in_texts(google::protobuf::Message& message, const Values& values) {
  const google::protobuf::Reflection& fields = *message.GetReflection();
  std::vector<const google::protobuf::FieldDescriptor*> set;
  fields.ListFields(message, &set);
  for (const auto* field : set) {
    if (field->name() == "scene_text" || field->name() == "scene_believed_text") continue;
    using Field = google::protobuf::FieldDescriptor;
    const std::string where = "info." + field->name();
    const bool text = field->cpp_type() == Field::CPPTYPE_STRING;
    const bool part = field->cpp_type() == Field::CPPTYPE_MESSAGE;
    if (text && !field->is_repeated())
      fields.SetString(&message, field,
                       required(fill_in(fields.GetString(message, field), values), where));
    for (int k = 0; field->is_repeated() && k < fields.FieldSize(message, field); ++k) {
      if (text)
        fields.SetRepeatedString(
            &message, field, k,
            required(fill_in(fields.GetRepeatedString(message, field, k), values), where));
      if (part) fill_in_texts(*fields.MutableRepeatedMessage(&message, field, k), values);
    }
    if (part && !field->is_repeated())
      fill_in_texts(*fields.MutableMessage(&message, field), values);
  }
}

}  // namespace

pb::RecordingInfo mapped_info(const pb::ImportMap& map, const Values& values,
                              const std::string& name) {
  pb::RecordingInfo info = map.info();
  fill_in_texts(info, values);
  const auto apply = [&](const std::string& assignment) {
    set_info_field(info, required(fill_in(assignment, values), "set"), "set");
  };
  for (const std::string& assignment : map.set()) apply(assignment);
  for (const pb::CaseMap& one : map.when()) {
    const std::string value = required(fill_in(one.value(), values), "when.value");
    if (std::find(one.equals().begin(), one.equals().end(), value) == one.equals().end()) continue;
    for (const std::string& assignment : one.set()) apply(assignment);
  }
  info.set_name(name);
  if (!info.has_frame()) info.set_frame("W");
  check_ranges(info, "set");
  return info;
}

void check_recording_name(const std::string& name, std::set<std::string>& names) {
  if (name.empty() || name.find_first_of("/\\") != std::string::npos || name.front() == '.')
    throw_error("name: \"{}\" is no name of a file", shown(name));
  if (!names.insert(name).second)
    throw_error("name: \"{}\" twice: {{values}} are missing in it", shown(name));
}

pb::ImportMap read_import_map(const std::string& path) {
  pb::ImportMap map;
  read_text_proto(path, map);
  return map;
}

void set_info_field(pb::RecordingInfo& info, const std::string& assignment,
                    const std::string& where) {
  const std::size_t equals = assignment.find('=');
  if (equals == std::string::npos)
    throw_error("{}: \"{}\", needed field=value", where, shown(assignment));
  const std::string path = assignment.substr(0, equals);
  std::string value = assignment.substr(equals + 1), before, after;
  const google::protobuf::Descriptor* type = pb::RecordingInfo::descriptor();
  std::size_t begin = 0;
  while (true) {
    const std::size_t end = std::min(path.find('.', begin), path.size());
    const std::string name = path.substr(begin, end - begin);
    const auto* field = type == nullptr ? nullptr : type->FindFieldByName(name);
    if (field == nullptr) throw_error("{}: \"{}\": no field {}", where, shown(path), shown(name));
    type = field->message_type();
    before += name;
    if (end == path.size()) {
      if (type != nullptr) throw_error("{}: \"{}\" is no single field", where, shown(path));
      if (field->cpp_type() == google::protobuf::FieldDescriptor::CPPTYPE_STRING) {
        std::string quoted = "\"";
        for (const char c : value)
          quoted += c == '"' || c == '\\' ? fmt::format("\\{}", c) : std::string(1, c);
        value = quoted + "\"";
      }
      break;
    }
    if (type == nullptr || field->is_repeated())
      throw_error("{}: \"{}\" is no single field", where, shown(path));
    before += " { ";
    after += " }";
    begin = end + 1;
  }
  if (value.find_first_of("{}\n") != std::string::npos && value.front() != '"')
    throw_error("{}: {}=\"{}\"", where, shown(path), shown(value));
  parse_text_proto(where + " " + shown(path), before + ": " + value + after, info);
}

void import_mapped(const pb::ImportMap& map, const std::string& folder, const TakeRecording& take) {
  if (!fs::is_directory(folder)) throw_error("{}: no folder", folder);
  std::set<std::string> names;
  for (const Group& group : make_groups(map, folder)) {
    const Builder builder(map, folder, group);
    for (std::size_t block = 0; block < builder.count(); ++block) {
      builder.make(block, [&](const std::string& name, const Recording& recording) {
        check_recording_name(name, names);
        take(name, recording);
      });
    }
  }
}

}  // namespace omentum

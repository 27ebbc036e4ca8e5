#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "proto/config.pb.h"

namespace omentum {

/// Folder with presets/ and scenes/: $OMENTUM_DEPLOY_DIR, else deploy/ of the nearest folder above
/// the executable that has deploy/presets. Throws Error where there is none.
std::string deploy_dir();

/// Names of the presets in deploy_dir().
std::vector<std::string> preset_names();

/// common.txtpb of deploy_dir(), if there is one -> preset -> scene file -> overrides "a.b=c" in
/// order; every knob checked. All defaults and the hashes of mesh files are filled in explicitly,
/// so the result is the resolved configuration. Throws Error: one line with file:line:column or the
/// knob, its value and the allowed range.
pb::Config load_config(const std::string& preset, std::span<const std::string> overrides);

/// As above from a resolved configuration text (a checkpoint, a manifest); `name` stands for the
/// file in errors, and the hashes of mesh files stay as the text has them.
pb::Config parse_config(const std::string& name, const std::string& text);

/// A scene file by itself, with overrides "scene.a.b=c". Knobs are checked and defaults filled in
/// as in load_config, the hashes of mesh files are not. Throws Error as load_config does.
pb::Scene load_scene(const std::string& path, std::span<const std::string> overrides);
/// The same of a scene in memory.
pb::Scene override_scene(const pb::Scene& scene, std::span<const std::string> overrides);

/// Where an error that begins with the path of a knob ("scene.tissue.anchor_max_y_m: ...") has its
/// cause in a scene file: "file:line:column: " of the innermost part of the path that the file
/// gives, empty where it gives none or is not there.
std::string place_in_scene(const std::string& path, const std::string& error);

/// "file:line:column: " of a field such as "transform[1].p_m" in a text file of messages like
/// `kind`: of the innermost part of its path that the file gives, empty where it gives none or is
/// not there.
std::string place_of_field(const std::string& file, const google::protobuf::Message& kind,
                           const std::string& field);

/// As above of a text that is called `name`.
std::string place_in_text(const std::string& name, const std::string& text,
                          const google::protobuf::Message& kind, const std::string& field);

/// The file that `scene_file` names; empty without one.
std::string scene_path(const pb::Config& config);

/// Where relative paths of meshes start: beside the scene file, without one in deploy_dir()/scenes.
std::string scene_directory(const pb::Config& config);

/// Reads a protobuf text file over what `message` holds. Throws Error with file:line:column.
void read_text_proto(const std::string& path, google::protobuf::Message& message);

/// As above from a text that is called `name` in errors.
void parse_text_proto(const std::string& name, const std::string& text,
                      google::protobuf::Message& message);

/// Throws Error for a number outside its knob's range or NaN, naming it behind `prefix`.
void check_ranges(const google::protobuf::Message& message, const std::string& prefix);

/// Deterministic text form, the inverse of parse_config().
std::string print_config(const pb::Config& config);

/// FNV-1a of the printed configuration without its `run` part and without `preset`, `scene_file`
/// and scene names: equal hashes mean equal weights.
std::uint64_t config_hash(const pb::Config& config);

/// One line per knob: name, unit, default, range, source, help. Used by --help of every program.
std::string knob_help();

}  // namespace omentum

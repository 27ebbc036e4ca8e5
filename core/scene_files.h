#pragma once

#include <functional>
#include <string>

#include "proto/scene.pb.h"

namespace omentum {

/// A path that a scene names; relative ones start at `directory`, empty: at the present folder.
std::string scene_file_path(const std::string& path, const std::string& directory);

/// Calls fn(knob, mesh) for every mesh file of a scene; `knob`: where it stands
/// ("scene.tissue...").
void for_each_mesh(pb::Scene& scene,
                   const std::function<void(const std::string& knob, pb::MeshFile& mesh)>& fn);

/// Fills in the SHA-256 of every mesh file of the scene, so that the resolved configuration, and
/// with it everything that carries its hash, stands for the contents too. Who loads the mesh later
/// compares. Throws Error that names the knob when a file cannot be read.
void fill_mesh_contents(pb::Scene& scene, const std::string& directory);

}  // namespace omentum

#include "core/scene_files.h"

#include <google/protobuf/message.h>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/hash.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;

void fill(protobuf::Message& message, const std::string& knob, const std::string& directory) {
  if (auto* mesh = dynamic_cast<pb::MeshFile*>(&message)) {
    if (mesh->path().empty()) return;  // told by who loads it
    const Result<Bytes> content = read_whole(scene_file_path(mesh->path(), directory));
    if (!content) throw_error("{}.path: {}", knob, content.error());
    mesh->set_sha256(hex(sha256(content.value())));
    return;
  }
  const protobuf::Reflection& reflection = *message.GetReflection();
  std::vector<const protobuf::FieldDescriptor*> fields;
  reflection.ListFields(message, &fields);
  for (const protobuf::FieldDescriptor* field : fields) {
    if (field->cpp_type() != protobuf::FieldDescriptor::CPPTYPE_MESSAGE) continue;
    const std::string name = knob + "." + field->name();
    if (!field->is_repeated()) {
      fill(*reflection.MutableMessage(&message, field), name, directory);
      continue;
    }
    for (int i = 0; i < reflection.FieldSize(message, field); ++i) {
      fill(*reflection.MutableRepeatedMessage(&message, field, i), fmt::format("{}[{}]", name, i),
           directory);
    }
  }
}

}  // namespace

std::string scene_file_path(const std::string& path, const std::string& directory) {
  return path.starts_with('/') || directory.empty() ? path : directory + "/" + path;
}

void fill_mesh_contents(pb::Scene& scene, const std::string& directory) {
  fill(scene, "scene", directory);
}

}  // namespace omentum

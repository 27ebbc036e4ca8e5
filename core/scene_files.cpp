#include "core/scene_files.h"

#include <google/protobuf/message.h>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/hash.h"

namespace omentum {
namespace {

namespace protobuf = google::protobuf;

using MeshFn = std::function<void(const std::string&, pb::MeshFile&)>;

void visit(protobuf::Message& message, const std::string& knob, const MeshFn& fn) {
  if (auto* mesh = dynamic_cast<pb::MeshFile*>(&message)) return fn(knob, *mesh);
  const protobuf::Reflection& reflection = *message.GetReflection();
  std::vector<const protobuf::FieldDescriptor*> fields;
  reflection.ListFields(message, &fields);
  for (const protobuf::FieldDescriptor* field : fields) {
    if (field->cpp_type() != protobuf::FieldDescriptor::CPPTYPE_MESSAGE) continue;
    const std::string name = knob + "." + field->name();
    if (!field->is_repeated()) {
      visit(*reflection.MutableMessage(&message, field), name, fn);
      continue;
    }
    for (int i = 0; i < reflection.FieldSize(message, field); ++i) {
      visit(*reflection.MutableRepeatedMessage(&message, field, i), fmt::format("{}[{}]", name, i),
            fn);
    }
  }
}

}  // namespace

std::string scene_file_path(const std::string& path, const std::string& directory) {
  return path.starts_with('/') || directory.empty() ? path : directory + "/" + path;
}

void for_each_mesh(pb::Scene& scene, const MeshFn& fn) { visit(scene, "scene", fn); }

void fill_mesh_contents(pb::Scene& scene, const std::string& directory) {
  for_each_mesh(scene, [&directory](const std::string& knob, pb::MeshFile& mesh) {
    if (mesh.path().empty()) return;  // told by who loads it
    const Result<Bytes> content = read_whole(scene_file_path(mesh.path(), directory));
    if (!content) throw_error("{}.path: {}", knob, content.error());
    mesh.set_sha256(hex(sha256(content.value())));
  });
}

}  // namespace omentum

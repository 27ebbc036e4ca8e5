#include "learner/onnx_export.h"

#include <fmt/format.h>
#include <onnx/onnx_pb.h>

#include <initializer_list>
#include <span>

#include "core/check.h"
#include "core/durable_file.h"
#include "core/hash.h"

namespace omentum {

namespace {

constexpr std::int64_t kOpset = 13;
constexpr std::int64_t kIrVersion = 7;  // the one that belongs to opset 13

/// Adds nodes and constants to a graph; names are those of the tensors they make.
class GraphMaker {
 public:
  explicit GraphMaker(onnx::GraphProto& graph) : graph_(graph) {}

  void constant(const std::string& name, std::span<const float> values,
                std::initializer_list<std::int64_t> shape) {
    onnx::TensorProto& tensor = *graph_.add_initializer();
    tensor.set_name(name);
    tensor.set_data_type(onnx::TensorProto_DataType_FLOAT);
    for (const std::int64_t size : shape) tensor.add_dims(size);
    tensor.set_raw_data(values.data(), values.size_bytes());  // little-endian, as ONNX wants
  }

  void constant(const std::string& name, std::span<const std::int64_t> values) {
    onnx::TensorProto& tensor = *graph_.add_initializer();
    tensor.set_name(name);
    tensor.set_data_type(onnx::TensorProto_DataType_INT64);
    tensor.add_dims(static_cast<std::int64_t>(values.size()));
    tensor.set_raw_data(values.data(), values.size_bytes());
  }

  onnx::NodeProto& node(const char* type, const std::vector<std::string>& inputs,
                        const std::vector<std::string>& outputs) {
    onnx::NodeProto& made = *graph_.add_node();
    made.set_op_type(type);
    made.set_name(outputs.front() + "_" + type);
    for (const std::string& input : inputs) made.add_input(input);
    for (const std::string& output : outputs) made.add_output(output);
    return made;
  }

  static void attribute(onnx::NodeProto& node, const char* name, std::int64_t value) {
    onnx::AttributeProto& made = *node.add_attribute();
    made.set_name(name);
    made.set_type(onnx::AttributeProto_AttributeType_INT);
    made.set_i(value);
  }

  static void attribute(onnx::NodeProto& node, const char* name,
                        std::initializer_list<std::int64_t> values) {
    onnx::AttributeProto& made = *node.add_attribute();
    made.set_name(name);
    made.set_type(onnx::AttributeProto_AttributeType_INTS);
    for (const std::int64_t value : values) made.add_ints(value);
  }

  static void describe(onnx::ValueInfoProto& info, const char* name, std::int64_t columns,
                       int type) {
    info.set_name(name);
    auto& tensor = *info.mutable_type()->mutable_tensor_type();
    tensor.set_elem_type(type);
    tensor.mutable_shape()->add_dim()->set_dim_param("N");
    tensor.mutable_shape()->add_dim()->set_dim_value(columns);
  }

 private:
  onnx::GraphProto& graph_;
};

void add_activation(GraphMaker& maker, const PolicyShape& shape, const std::string& input,
                    const std::string& output) {
  if (shape.activation == pb::ACTIVATION_TANH) {
    maker.node("Tanh", {input}, {output});
    return;
  }
  maker.node("Sigmoid", {input}, {output + "_gate"});
  maker.node("Mul", {input, output + "_gate"}, {output});
}

/// "numbers" [N, numbers] and "planes" [N, planes, size, size] of the normalised observation.
void add_picture(GraphMaker& maker, const PolicyShape& shape) {
  const PictureShape& picture = shape.picture;
  const std::int64_t parts[] = {shape.numbers(), picture.values()};
  const std::int64_t sides[] = {-1, picture.size, picture.size, picture.channels};
  maker.constant("observation_parts", parts);
  maker.constant("picture_sides", sides);
  GraphMaker::attribute(
      maker.node("Split", {"normalised", "observation_parts"}, {"numbers", "pixels"}), "axis", 1);
  maker.node("Reshape", {"pixels", "picture_sides"}, {"rows_of_pixels"});
  const bool ids = picture.channels == 1;
  const std::string channels_first = ids ? "object_ids" : "planes";
  GraphMaker::attribute(maker.node("Transpose", {"rows_of_pixels"}, {channels_first}), "perm",
                        {0, 3, 1, 2});
  const float scale = feature_scale(picture);
  maker.constant("feature_scale", std::span(&scale, 1), {});
  if (!ids) return;
  const float highest = kObjectIds, half = 0.5F;
  std::vector<float> every_id;
  for (int id = 1; id <= kObjectIds; ++id) every_id.push_back(static_cast<float>(id));
  maker.constant("highest_id", std::span(&highest, 1), {});
  maker.constant("every_id", every_id, {1, kObjectIds, 1, 1});
  maker.constant("half", std::span(&half, 1), {});
  maker.node("Mul", {"object_ids", "highest_id"}, {"whole_ids"});
  maker.node("Sub", {"whole_ids", "every_id"}, {"from_id"});
  maker.node("Abs", {"from_id"}, {"distance_from_id"});
  maker.node("Less", {"distance_from_id", "half"}, {"shows_id"});
  GraphMaker::attribute(maker.node("Cast", {"shows_id"}, {"planes"}), "to",
                        onnx::TensorProto_DataType_FLOAT);
}

/// One convolution and its activation. Ours are [dy][dx][plane][filter], those of ONNX [filter,
/// plane, dy, dx].
void add_convolution(GraphMaker& maker, const PolicyShape& shape, const Convolution& c,
                     std::span<const float> filters, std::span<const float> bias,
                     const std::string& input, const std::string& output) {
  std::vector<float> weights;
  for (int filter = 0; filter < c.filters; ++filter) {
    for (int plane = 0; plane < c.planes; ++plane) {
      for (int place = 0; place < c.kernel * c.kernel; ++place)
        weights.push_back(
            filters[static_cast<std::size_t>((place * c.planes + plane) * c.filters + filter)]);
    }
  }
  maker.constant(output + "_filters", weights, {c.filters, c.planes, c.kernel, c.kernel});
  maker.constant(output + "_bias", bias, {c.filters});
  onnx::NodeProto& node =
      maker.node("Conv", {input, output + "_filters", output + "_bias"}, {output + "_sum"});
  GraphMaker::attribute(node, "kernel_shape", {c.kernel, c.kernel});
  GraphMaker::attribute(node, "strides", {c.stride, c.stride});
  add_activation(maker, shape, output + "_sum", output);
}

/// "<name>_inputs" [N, inputs]: the numbers and the features of the picture.
void add_convolutions(GraphMaker& maker, const PolicyShape& shape, const NetworkLayout& net,
                      std::span<const float> p, const std::string& name) {
  const auto part = [p](std::size_t from, std::size_t to) { return p.subspan(from, to - from); };
  add_convolution(maker, shape, first_convolution(shape.picture),
                  part(net.filters1, net.filters1_bias), part(net.filters1_bias, net.filters2),
                  "planes", name + "_picture1");
  add_convolution(maker, shape, second_convolution(shape.picture),
                  part(net.filters2, net.filters2_bias), part(net.filters2_bias, net.weights1),
                  name + "_picture1", name + "_picture2");
  GraphMaker::attribute(maker.node("Transpose", {name + "_picture2"}, {name + "_rows_of_features"}),
                        "perm", {0, 2, 3, 1});
  const std::int64_t sides[] = {-1, shape.features()};
  maker.constant(name + "_feature_sides", sides);
  maker.node("Reshape", {name + "_rows_of_features", name + "_feature_sides"},
             {name + "_every_feature"});
  maker.node("Mul", {name + "_every_feature", "feature_scale"}, {name + "_features"});
  GraphMaker::attribute(maker.node("Concat", {"numbers", name + "_features"}, {name + "_inputs"}),
                        "axis", 1);
}

void add_network(GraphMaker& maker, const PolicyShape& shape, const NetworkLayout& net,
                 const std::vector<float>& p, const std::string& name, const std::string& output) {
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  const auto outputs = static_cast<std::size_t>(net.outputs);
  const std::span<const float> all(p);
  const std::int64_t h = shape.hidden, i = shape.inputs(), l = net.outputs;
  if (shape.convolution) add_convolutions(maker, shape, net, all, name);
  const std::string inputs = shape.convolution ? name + "_inputs" : "normalised";
  maker.constant(name + "_weights1",
                 all.subspan(net.weights1, static_cast<std::size_t>(i) * hidden), {i, h});
  maker.constant(name + "_bias1", all.subspan(net.bias1, hidden), {h});
  maker.constant(name + "_weights2", all.subspan(net.weights2, hidden * hidden), {h, h});
  maker.constant(name + "_bias2", all.subspan(net.bias2, hidden), {h});
  maker.constant(name + "_head", all.subspan(net.head, outputs * hidden), {l, h});
  maker.node("Gemm", {inputs, name + "_weights1", name + "_bias1"}, {name + "_sum1"});
  add_activation(maker, shape, name + "_sum1", name + "_hidden1");
  maker.node("Gemm", {name + "_hidden1", name + "_weights2", name + "_bias2"}, {name + "_sum2"});
  add_activation(maker, shape, name + "_sum2", name + "_hidden2");
  std::vector<std::string> of_head = {name + "_hidden2", name + "_head"};
  if (net.has_head_bias) {
    maker.constant(name + "_head_bias", all.subspan(net.head_bias, outputs), {l});
    of_head.push_back(name + "_head_bias");
  }
  GraphMaker::attribute(maker.node("Gemm", of_head, {output}), "transB", 1);
}

void add_normaliser(GraphMaker& maker, const PolicyShape& shape, const PolicyWeights& weights) {
  if (weights.obs_mean.empty()) {
    maker.node("Identity", {"observation"}, {"normalised"});
    return;
  }
  const auto size = static_cast<std::int64_t>(shape.observations);
  // Pixels, within 0 ... 1, pass as they are.
  std::vector<float> mean = weights.obs_mean, inverse_deviation = weights.obs_inv_std;
  mean.resize(static_cast<std::size_t>(size), 0.0F);
  inverse_deviation.resize(static_cast<std::size_t>(size), 1.0F);
  const float low = -kObservationClip, high = kObservationClip;
  maker.constant("observation_mean", mean, {size});
  maker.constant("observation_inverse_deviation", inverse_deviation, {size});
  maker.constant("clip_low", std::span(&low, 1), {});
  maker.constant("clip_high", std::span(&high, 1), {});
  maker.node("Sub", {"observation", "observation_mean"}, {"centred"});
  maker.node("Mul", {"centred", "observation_inverse_deviation"}, {"scaled"});
  maker.node("Clip", {"scaled", "clip_low", "clip_high"}, {"normalised"});
}

void add_action(GraphMaker& maker, const PolicyShape& shape) {
  if (shape.continuous) {
    maker.node("Identity", {"logits"}, {"action"});
    return;
  }
  std::vector<std::string> parts, choices;
  std::vector<std::int64_t> sizes;
  for (const int size : shape.branches) {
    parts.push_back(fmt::format("branch{}", parts.size()));
    sizes.push_back(size);
  }
  maker.constant("branch_sizes", sizes);
  GraphMaker::attribute(maker.node("Split", {"logits", "branch_sizes"}, parts), "axis", 1);
  for (const std::string& part : parts) {
    choices.push_back(part + "_choice");
    onnx::NodeProto& node = maker.node("ArgMax", {part}, {choices.back()});
    GraphMaker::attribute(node, "axis", 1);
    GraphMaker::attribute(node, "keepdims", 1);
  }
  // Unused branches are always 0.
  while (choices.size() < shape.columns()) {
    const std::string name = fmt::format("unused{}", choices.size());
    maker.node("Sub", {choices.front(), choices.front()}, {name});
    choices.push_back(name);
  }
  GraphMaker::attribute(maker.node("Concat", choices, {"action"}), "axis", 1);
}

}  // namespace

OnnxMetadata onnx_metadata(const pb::Task& task, const std::string& git_revision) {
  return {observed_entries(task), action_names(task), action_meanings(task), git_revision};
}

std::string onnx_model(const PolicyShape& shape, const PolicyWeights& weights,
                       const OnnxMetadata& metadata) {
  const ParameterLayout layout = parameter_layout(shape);
  OMENTUM_CHECK(weights.parameters.size() == layout.count);
  int observed = 0;
  for (const ObservedEntry& entry : metadata.observation) observed += entry.size;
  OMENTUM_CHECK(observed == shape.observations);
  onnx::ModelProto model;
  model.set_ir_version(kIrVersion);
  model.set_producer_name("omentum");
  model.set_producer_version(metadata.git_revision);
  model.set_model_version(static_cast<std::int64_t>(weights.policy_version));
  onnx::OperatorSetIdProto& opset = *model.add_opset_import();
  opset.set_domain("");
  opset.set_version(kOpset);

  onnx::GraphProto& graph = *model.mutable_graph();
  graph.set_name("omentum_policy");
  GraphMaker maker(graph);
  add_normaliser(maker, shape, weights);
  if (shape.convolution) add_picture(maker, shape);
  add_network(maker, shape, layout.actor, weights.parameters, "actor", "logits");
  add_network(maker, shape, layout.critic, weights.parameters, "critic", "value");
  add_action(maker, shape);
  GraphMaker::describe(*graph.add_input(), "observation", shape.observations,
                       onnx::TensorProto_DataType_FLOAT);
  GraphMaker::describe(*graph.add_output(), "logits", shape.logits(),
                       onnx::TensorProto_DataType_FLOAT);
  GraphMaker::describe(*graph.add_output(), "value", 1, onnx::TensorProto_DataType_FLOAT);
  GraphMaker::describe(
      *graph.add_output(), "action", static_cast<int>(shape.columns()),
      shape.continuous ? onnx::TensorProto_DataType_FLOAT : onnx::TensorProto_DataType_INT64);

  std::vector<std::string> names, units;
  for (const ObservedEntry& entry : metadata.observation) {
    names.push_back(entry.name);
    units.push_back(entry.unit);
  }
  const auto joined = [](const auto& list) { return fmt::format("{}", fmt::join(list, ",")); };
  const std::pair<const char*, std::string> entries[] = {
      {"policy_version", std::to_string(weights.policy_version)},
      {"weights_hash", hex(weights.weights_hash)},
      {"config_hash", fmt::format("{:016x}", weights.config_hash)},
      {"layout_hash", fmt::format("{:016x}", shape.layout_hash())},
      {"git_revision", metadata.git_revision},
      {"observation_names", joined(names)},
      {"observation_units", joined(units)},
      {"action_names", joined(metadata.action_names)},
      {"action_meanings", joined(metadata.action_meanings)},
      {"branches", joined(shape.branches)},
  };
  for (const auto& [key, value] : entries) {
    onnx::StringStringEntryProto& entry = *model.add_metadata_props();
    entry.set_key(key);
    entry.set_value(value);
  }
  return model.SerializeAsString();
}

Result<void> export_onnx(const std::string& path, const PolicyShape& shape,
                         const PolicyWeights& weights, const OnnxMetadata& metadata) {
  return write_durably(path, onnx_model(shape, weights, metadata));
}

}  // namespace omentum

#include "learner/onnx_export.h"

#include <gtest/gtest.h>
#include <onnx/onnx_pb.h>
#include <sys/wait.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "core/config.h"
#include "core/rng.h"
#include "core/task.h"
#include "learner/initialise.h"
#include "support/temp_dir.h"
#include "tests/support/plain_convolution.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

float noise(std::uint32_t i, std::uint32_t stream) {
  return 2 * uniform_24(philox({i, stream, 0, 0}, {3, 9})[0]) - 1;
}

struct Case {
  const char* name;
  PolicyShape shape;
  bool normalised;
};

class OnnxExport : public testing::TestWithParam<Case> {};

/// Logits of the policy for one observation, read through the log-probabilities of all actions:
/// only differences within a branch matter there, so compute them plainly instead.
std::vector<double> plain_logits(const PolicyShape& shape, const PolicyWeights& weights,
                                 const float* observation) {
  const NetworkLayout net = parameter_layout(shape).actor;
  const std::vector<float>& p = weights.parameters;
  const auto hidden = static_cast<std::size_t>(shape.hidden);
  std::vector<double> x;
  for (std::size_t i = 0; i < static_cast<std::size_t>(shape.observations); ++i) {
    double value = static_cast<double>(observation[i]);
    if (i < weights.obs_mean.size()) {
      value = (value - static_cast<double>(weights.obs_mean[i])) *
              static_cast<double>(weights.obs_inv_std[i]);
      value = std::clamp(value, -10.0, 10.0);
    }
    x.push_back(value);
  }
  const auto activation = [&](double sum) {
    return shape.activation == pb::ACTIVATION_TANH ? std::tanh(sum) : sum / (1 + std::exp(-sum));
  };
  x = test::plain_inputs(
      shape, net, std::vector<double>(p.begin(), p.end()), x,
      [](double a, double b, double sum) { return a * b + sum; }, activation);
  for (const auto& [w, b] :
       {std::pair{net.weights1, net.bias1}, std::pair{net.weights2, net.bias2}}) {
    std::vector<double> y(hidden);
    for (std::size_t j = 0; j < hidden; ++j) {
      double sum = static_cast<double>(p[b + j]);
      for (std::size_t k = 0; k < x.size(); ++k)
        sum += x[k] * static_cast<double>(p[w + k * hidden + j]);
      y[j] = activation(sum);
    }
    x = y;
  }
  std::vector<double> logits;
  for (std::size_t o = 0; o < static_cast<std::size_t>(net.outputs); ++o) {
    double sum = net.has_head_bias ? static_cast<double>(p[net.head_bias + o]) : 0;
    for (std::size_t k = 0; k < hidden; ++k)
      sum += x[k] * static_cast<double>(p[net.head + o * hidden + k]);
    logits.push_back(sum);
  }
  return logits;
}

TEST_P(OnnxExport, IndependentReaderAgrees) {
  const Case& c = GetParam();
  const std::size_t rows = 50;
  const auto width = static_cast<std::size_t>(c.shape.observations);
  PolicyWeights weights;
  weights.policy_version = 12;
  weights.parameters = initial_parameters(c.shape, pb::Ppo(), 4);
  for (std::size_t i = 0; i < weights.parameters.size(); ++i) {
    weights.parameters[i] += 0.1F * noise(static_cast<std::uint32_t>(i), 1);
  }
  if (c.normalised) {
    for (int i = 0; i < c.shape.numbers(); ++i)
      weights.obs_mean.push_back(noise(static_cast<std::uint32_t>(i), 2));
    weights.obs_inv_std.assign(weights.obs_mean.size(), 8);  // large: some are clipped
  }
  Policy policy(c.shape, weights);
  std::vector<float> observations(rows * width);
  for (std::size_t i = 0; i < observations.size(); ++i)
    observations[i] = 2 * noise(static_cast<std::uint32_t>(i), 3);
  const std::vector<ActionCounter> counters(rows);
  std::vector<Decision> decisions(rows);
  policy.act(observations, counters, true, decisions);

  const test::TempDir folder;
  std::vector<ObservedEntry> entries(static_cast<std::size_t>(c.shape.numbers()), {"a", "m"});
  const PictureShape& picture = c.shape.picture;
  if (picture.size > 0) {
    entries.push_back(
        {fmt::format("image[{}][{}][{}]", picture.size, picture.size, picture.channels), "1",
         picture.values()});
  }
  const Result<void> written =
      export_onnx(folder / "policy.onnx", c.shape, weights, {entries, {"x"}, {"x_W 0=0 m"}, "rev"});
  ASSERT_TRUE(written.has_value()) << written.error();
  {
    std::ofstream expected(folder / "expected.txt");
    expected.precision(9);
    expected << rows << ' ' << width << ' ' << c.shape.logits() << '\n';
    for (std::size_t i = 0; i < rows; ++i) {
      for (std::size_t k = 0; k < width; ++k) expected << observations[i * width + k] << ' ';
      for (const double logit : plain_logits(c.shape, weights, observations.data() + i * width))
        expected << logit << ' ';
      expected << decisions[i].value;
      for (std::size_t b = 0; b < c.shape.columns(); ++b) {
        expected << ' '
                 << (c.shape.continuous ? decisions[i].continuous[b]
                                        : static_cast<float>(decisions[i].branch[b]));
      }
      expected << '\n';
    }
  }
  // Debian's python3-onnx belongs to /usr/bin/python3, whatever else is first on the path.
  const std::string python = fs::exists("/usr/bin/python3") ? "/usr/bin/python3" : "python3";
  const std::string command = python + " " + OMENTUM_TESTS_DIR + "/learner/onnx_check.py " +
                              (folder / "policy.onnx") + " " + (folder / "expected.txt");
  const int status = std::system(command.c_str());
  ASSERT_TRUE(WIFEXITED(status));
  if (WEXITSTATUS(status) == 77 || WEXITSTATUS(status) == 127)
    GTEST_SKIP() << "python3-onnx is not installed";
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

std::vector<Case> cases() {
  PolicyShape shape;
  shape.observations = 14;
  shape.branches = {3, 3, 3, 2};
  PolicyShape paper = shape;
  paper.activation = pb::ACTIVATION_SWISH;
  paper.head_bias = false;
  PolicyShape derived = shape;
  derived.branches = {3, 3, 3};
  PolicyShape oriented = shape;
  oriented.branches = {3, 3, 3, 2, 3, 3, 3};
  PolicyShape gaussian = shape;
  gaussian.branches.clear();
  gaussian.continuous = true;
  const auto sees = [](PolicyShape base, int size, int channels) {
    base.picture = {size, channels};
    base.observations += base.picture.values();
    base.convolution = true;
    return base;
  };
  PolicyShape pixels = sees(shape, 12, 1);
  pixels.convolution = false;
  return {{"ObjectIds", sees(shape, 20, 1), true},
          {"Shaded", sees(paper, 16, 3), false},
          {"PixelsOfADenseNetwork", pixels, true},
          {"Omentum", shape, true},
          {"Paper", paper, false},
          {"Derived", derived, true},
          {"Oriented", oriented, true},
          {"Gaussian", gaussian, true}};
}

/// A comma-separated entry of the file's metadata.
std::vector<std::string> metadata_list(const onnx::ModelProto& model, const std::string& key) {
  std::vector<std::string> words;
  for (const auto& entry : model.metadata_props()) {
    if (entry.key() != key) continue;
    std::istringstream text(entry.value());
    for (std::string word; std::getline(text, word, ',');) words.push_back(word);
  }
  return words;
}

onnx::ModelProto exported(const pb::Config& config) {
  const PolicyShape shape = policy_shape(config);
  PolicyWeights weights;
  weights.parameters = initial_parameters(shape, config.ppo(), 4);
  onnx::ModelProto model;
  EXPECT_TRUE(
      model.ParseFromString(onnx_model(shape, weights, onnx_metadata(config.task(), "revision"))));
  return model;
}

/// Units of one observation, by name.
using Units = std::map<std::string, std::string>;

Units units_in(const onnx::ModelProto& model) {
  const auto names = metadata_list(model, "observation_names");
  const auto units = metadata_list(model, "observation_units");
  EXPECT_EQ(names.size(), units.size());
  Units by_name;
  for (std::size_t i = 0; i < std::min(names.size(), units.size()); ++i)
    by_name[names[i]] = units[i];
  EXPECT_EQ(by_name.size(), names.size()) << "every name once";
  return by_name;
}

TEST(OnnxMetadata, SaysWhatEveryPresetObserves) {
  const Units workspace = {{"p_y", "-1 ... 1 over the workspace along y of W"},
                           {"distance_p_q", "diagonal of the workspace"}};
  const Units fine = {{"p_y", "-1 ... 1 over the workspace along y of W"},
                      {"near_goal_z", "5 mm along z of W; within -1 ... 1"}};
  const std::map<std::string, std::pair<std::size_t, Units>> expected = {
      {"paper", {12, workspace}},
      {"paper_literal", {12, workspace}},
      {"paper_swapped", {12, workspace}},
      {"derived", {12, {{"p_y", "100 mm along z of W"}, {"distance_p_q", "100 mm"}}}},
      {"derived_head", {8, {{"goal_z", "100 mm along y of W"}, {"distance_p_goal", "100 mm"}}}},
      {"omentum", {20, fine}},
      {"omentum_elastic", {20, fine}},
      {"omentum_robust", {20, fine}},
      {"omentum_oriented", {29, fine}},
      {"omentum_image", {21, {{"image[32][32]", "object id / 6"}}}},
      {"omentum_soft", {20, fine}},
      {"omentum_wide", {20, fine}}};
  for (const auto& file : fs::directory_iterator(deploy_dir() + "/presets")) {
    const std::string preset = file.path().stem();
    ASSERT_TRUE(expected.contains(preset)) << preset << " is not in the table of this test";
    const pb::Config config = load_config(preset, {});
    const onnx::ModelProto model = exported(config);
    const Units units = units_in(model);
    const auto& [size, some] = expected.at(preset);
    EXPECT_EQ(units.size(), size) << preset;
    EXPECT_EQ(model.graph().input(0).type().tensor_type().shape().dim(1).dim_value(),
              observation_size(config.task()));
    for (const auto& [name, unit] : some) EXPECT_EQ(units.at(name), unit) << preset << " " << name;
    EXPECT_EQ(metadata_list(model, "action_names"), action_names(config.task()));
  }
}

// Index 0, 1, 2 of a branch are other steps in other tasks.
TEST(OnnxMetadata, SaysWhatEveryIndexOfTheActionDoes) {
  const std::map<std::string, std::string> expected = {
      {"omentum", "x_W 0=-0.001 m 1=0 m 2=0.001 m"},
      {"paper_literal", "x_W 0=-0.0005 m 1=0 m 2=0.0005 m"},
      {"derived", "x_W 0=0 m 1=0.0025 m 2=-0.0025 m"},
      {"derived_head", "z_W 0=-0.0025 m 1=0 m 2=0.0025 m"}};
  for (const auto& [preset, first] : expected) {
    const pb::Config config = load_config(preset, {});
    const auto meanings = metadata_list(exported(config), "action_meanings");
    ASSERT_EQ(meanings.size(), action_names(config.task()).size()) << preset;
    EXPECT_EQ(meanings[0], first) << preset;
    if (meanings.size() == 4) {
      EXPECT_EQ(meanings[3], "jaw 0=open 1=closed");
    }
    // As Task::decode() has them.
    const Task task(config, TaskPlaces{});
    for (std::uint8_t index = 0; index < 3; ++index) {
      Action action;
      action.branch = {index, 0, 0, 0};
      const double step =
          task.decode(action)
              .increment[static_cast<Eigen::Index>(std::string("xyz").find(first[0]))];
      EXPECT_THAT(first, testing::HasSubstr(fmt::format(" {}={:.6g} m", index,
                                                        step * config.task().action_repeat())));
    }
  }
}

TEST(OnnxMetadata, SaysWhatAnImageShows) {
  const auto units = [](const std::string& image) {
    return units_in(exported(load_config(
        "omentum", std::vector<std::string>{"task.observation=OBSERVATION_IMAGE",
                                            "task.image_size=16", "task.image=" + image})));
  };
  EXPECT_EQ(units("IMAGE_OBJECT_IDS").at("image[16][16]"), "object id / 6");
  EXPECT_EQ(units("IMAGE_SHADED").at("image[16][16][3]"), "intensity 0 ... 1");
  EXPECT_EQ(units("IMAGE_SHADED").size(), 21U);
}

INSTANTIATE_TEST_SUITE_P(Shapes, OnnxExport, testing::ValuesIn(cases()),
                         [](const testing::TestParamInfo<Case>& i) { return i.param.name; });

}  // namespace
}  // namespace omentum

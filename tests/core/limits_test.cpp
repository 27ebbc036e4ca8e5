// What bus and policy cannot take is refused before a run, in one line with knob, value and what is
// allowed; the value that is named as allowed is taken.
#include "core/limits.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "core/check.h"
#include "core/config.h"
#include "core/segment_fields.h"
#include "core/task.h"

namespace omentum {
namespace {

using Strings = std::vector<std::string>;
using testing::AllOf;
using testing::HasSubstr;

/// Why a configuration is refused; empty if it is not.
std::string refusal(const Strings& sets, const std::string& preset = "omentum_image") {
  const pb::Config config = load_config(preset, sets);
  try {
    check_limits(config);
  } catch (const Error& error) {
    return error.what();
  }
  return {};
}

TEST(Limits, EveryPresetKeepsThem) {
  for (const std::string& preset : preset_names()) EXPECT_EQ(refusal({}, preset), "") << preset;
}

TEST(Limits, PicturesOfBothKindsFrom16To64PixelsKeepThem) {
  for (const std::string kind : {"IMAGE_OBJECT_IDS", "IMAGE_SHADED"}) {
    for (const std::string size : {"16", "32", "48", "64"}) {
      for (const std::string network : {"NETWORK_AUTOMATIC", "NETWORK_DENSE"})
        EXPECT_EQ(
            refusal({"task.image=" + kind, "task.image_size=" + size, "ppo.network=" + network}),
            "");
    }
  }
}

TEST(Limits, ConvolutionsNeedAPictureTheyCanTake) {
  EXPECT_THAT(refusal({"ppo.network=NETWORK_CONVOLUTION"}, "omentum"),
              AllOf(HasSubstr("ppo.network: NETWORK_CONVOLUTION"), HasSubstr("OBSERVATION_OMENTUM"),
                    HasSubstr("NETWORK_DENSE")));
  EXPECT_EQ(refusal({"ppo.network=NETWORK_DENSE"}, "omentum"), "");
  for (const std::string size : {"8", "30"}) {
    EXPECT_THAT(refusal({"task.image_size=" + size}),
                AllOf(HasSubstr("task.image_size: " + size), HasSubstr("multiples of 4 from 12")));
    EXPECT_EQ(refusal({"task.image_size=" + size, "ppo.network=NETWORK_DENSE"}), "");
  }
  EXPECT_EQ(refusal({"task.image_size=12"}), "");
}

TEST(Limits, WeightsFitOnTheWire) {
  const Strings large = {"task.image_size=128", "task.image=IMAGE_SHADED",
                         "ppo.network=NETWORK_DENSE", "evaluation.enabled=false"};
  EXPECT_THAT(refusal(large), AllOf(HasSubstr("ppo.hidden: 128"), HasSubstr("49172 inputs"),
                                    HasSubstr("allowed up to 42 (4194304")));
  const auto with_hidden = [&large](const std::string& hidden) {
    Strings sets = large;
    sets.push_back("ppo.hidden=" + hidden);
    return refusal(sets);
  };
  EXPECT_EQ(with_hidden("42"), "");
  EXPECT_NE(with_hidden("43"), "");
}

TEST(Limits, ASegmentFitsOnTheWire) {
  EXPECT_THAT(refusal({"rollout.steps_per_segment=20000"}),
              AllOf(HasSubstr("rollout.steps_per_segment: 20000"), HasSubstr("1044 observed"),
                    HasSubstr("allowed up to 16070")));
  EXPECT_EQ(refusal({"rollout.steps_per_segment=16070"}), "");
  EXPECT_NE(refusal({"rollout.steps_per_segment=16071"}), "");
  EXPECT_EQ(refusal({"rollout.steps_per_segment=20000"}, "omentum"), "");
}

TEST(Limits, AnEvaluationFitsOnTheWire) {
  const Strings shaded = {"task.image_size=64", "task.image=IMAGE_SHADED"};
  const auto with = [&shaded](const std::string& set) {
    Strings sets = shaded;
    sets.push_back(set);
    return sets;
  };
  EXPECT_THAT(refusal(with("task.episode_steps=2000")),
              AllOf(HasSubstr("task.episode_steps: 2000"), HasSubstr("evaluations of 2108"),
                    HasSubstr("allowed up to 1363")));
  EXPECT_EQ(refusal(with("task.episode_steps=1255")), "");
  EXPECT_NE(refusal(with("task.episode_steps=1256")), "");
  EXPECT_THAT(refusal({"task.episode_steps=50000", "task.action_repeat=1"}, "omentum"),
              AllOf(HasSubstr("task.episode_steps: 50000"), HasSubstr("allowed up to 20000")));
  EXPECT_EQ(refusal({"task.episode_steps=50000", "evaluation.enabled=false"}, "omentum"), "");
  EXPECT_THAT(refusal(with("task.increment_m=0.0001")),
              AllOf(HasSubstr("task.increment_m: 0.0001"), HasSubstr("lattice")));
  EXPECT_THAT(refusal({"task.hold_s=60", "task.control_period_s=0.001"}, "omentum"),
              HasSubstr("task.hold_s: 60"));
}

TEST(Limits, StatesAndRecordedFramesFitOnTheWire) {
  const auto why = [](Strings sets, std::size_t state_bytes, std::size_t numbers) {
    sets.emplace_back("task.action_repeat=1");
    try {
      check_scene_limits(load_config("omentum", sets), state_bytes, numbers);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string();
  };
  EXPECT_EQ(why({}, kMaxStateBytes, 3 * 961), "");
  EXPECT_THAT(why({}, kMaxStateBytes + 1, 3 * 961),
              AllOf(HasSubstr("scene.tissue: its state takes 1048577 bytes"),
                    HasSubstr("allowed up to 1048576")));
  // 708 steps and the end; 400 frames of 41,943 numbers are full.
  EXPECT_EQ(why({}, 100, 41943), "");
  EXPECT_THAT(why({"evaluation.frame_stride=1"}, 100, 41943),
              AllOf(HasSubstr("evaluation.frame_stride: 1"), HasSubstr("allowed from 2 on")));
  EXPECT_EQ(why({"evaluation.frame_stride=2"}, 100, 41943), "");
  EXPECT_EQ(why({"evaluation.frame_stride=1", "evaluation.enabled=false"}, 100, 41943), "");
}

}  // namespace
}  // namespace omentum

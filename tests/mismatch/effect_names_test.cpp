// The table of names of effects against the schema of a scene, both ways.
#include "mismatch/catalogue/effect_names.h"

#include <gmock/gmock.h>
#include <google/protobuf/util/message_differencer.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <set>

#include "core/check.h"
#include "core/config.h"
#include "sim_worker/playback/parameters.h"
#include "sim_worker/tissue/effect_catalogue.h"

namespace omentum {
namespace {

using google::protobuf::util::MessageDifferencer;
using testing::HasSubstr;

pb::Scene base_scene() {
  pb::Scene scene;
  scene.mutable_tissue()->mutable_grid();
  scene.mutable_tissue()->mutable_material()->set_poisson_ratio(0.4);
  scene.mutable_tissue()->set_static_friction(0.25);
  return scene;
}

/// Every number of the catalogue, of its own value inside of its range.
pb::Scene scene_with_everything() {
  pb::Scene scene = base_scene();
  double share = 0.02;
  for (const EffectRow& row : effect_catalogue()) {
    const pb::Knob& knob = knob_of(row);
    share = share > 0.08 ? 0.02 : share + 0.0007;
    const double low = std::max(knob.min(), 0.0);
    set_effect(*scene.mutable_tissue()->mutable_effects(), row.path,
               low + share * (knob.max() - low));
  }
  return scene;
}

bool same_numbers(const pb::Scene& a, const pb::Scene& b) {
  MessageDifferencer differencer;
  differencer.set_message_field_comparison(MessageDifferencer::EQUIVALENT);
  google::protobuf::util::DefaultFieldComparator comparator;
  comparator.set_float_comparison(google::protobuf::util::DefaultFieldComparator::APPROXIMATE);
  comparator.SetDefaultFractionAndMargin(1e-12, 1e-15);
  differencer.set_field_comparator(&comparator);
  return differencer.Compare(a, b);
}

const NamedEffect* find(const std::vector<NamedEffect>& effects, const std::string& name) {
  const auto found = std::ranges::find(effects, name, &NamedEffect::name);
  return found == effects.end() ? nullptr : &*found;
}

TEST(EffectNames, SceneToNamesAndBackIsTheScene) {
  const pb::Scene scene = scene_with_everything();
  pb::Scene again = without_effects(scene);
  EXPECT_TRUE(effects_of_scene(again).empty());
  apply_effects(effects_of_scene(scene), again);
  EXPECT_TRUE(same_numbers(scene, again)) << again.ShortDebugString();
}

TEST(EffectNames, NamesToSceneAndBackAreTheNames) {
  const std::vector<NamedEffect> effects = effects_of_scene(scene_with_everything());
  pb::Scene scene = base_scene();
  apply_effects(effects, scene);
  const std::vector<NamedEffect> again = effects_of_scene(scene);
  ASSERT_EQ(again.size(), effects.size());
  for (std::size_t k = 0; k < effects.size(); ++k) {
    EXPECT_EQ(again[k].name, effects[k].name);
    for (const NamedValue& value : effects[k].parameters) {
      const NamedValue* same = again[k].find(value.name);
      ASSERT_NE(same, nullptr) << effects[k].name << "." << value.name;
      EXPECT_NEAR(same->value, value.value, 1e-12 * std::fabs(value.value) + 1e-15);
      EXPECT_EQ(same->unit, value.unit);
    }
  }
}

TEST(EffectNames, EveryNumberOfTheCatalogueHasOne) {
  // A scene with one number off its neutral value has an effect on the list, or a number that is
  // not that of a scene without.
  const std::set<std::string> known = {"added_mass.mass_kg", "added_mass.x_m", "added_mass.y_m",
                                       "added_mass.radius_m"};  // known, not a mismatch
  for (const EffectRow& row : effect_catalogue()) {
    if (known.count(row.path) != 0) continue;
    pb::Scene scene = base_scene();
    pb::TissueEffects& effects = *scene.mutable_tissue()->mutable_effects();
    const pb::Knob& knob = knob_of(row);
    if (row.of != nullptr) set_effect(effects, row.of, 0.01);
    set_effect(effects, row.path, knob.min() + 0.7 * (knob.max() - knob.min()));
    const std::vector<NamedEffect> named = effects_of_scene(scene);
    if (std::string(row.path) == "anchor.break_m") continue;  // on with the compliance only
    ASSERT_EQ(named.size(), 1U) << row.path;
    const std::string path = row.path;  // a later entry that is on alone becomes the first
    if (path.find("[1]") != std::string::npos || path.find("[2]") != std::string::npos) continue;
    pb::Scene again = base_scene();
    apply_effects(named, again);
    EXPECT_TRUE(same_numbers(scene, again)) << row.path << ": " << again.ShortDebugString();
  }
}

TEST(EffectNames, AreThoseOfTheColumns) {
  // A column's parameter changes the scene as its number here does.
  const pb::Scene scene = base_scene();
  const std::set<std::string> settings = {"bending_stiffness.factor"};
  int checked = 0;
  for (const Parameter& parameter : parse_parameters("all", scene)) {
    const std::size_t dot = parameter.name.find('.');
    const bool of_scene =
        parameter.kind == Parameter::Kind::kScene || parameter.kind == Parameter::Kind::kArm;
    if (dot == std::string::npos || !of_scene) continue;
    const std::string effect = parameter.name.substr(0, dot);
    const std::string name = parameter.name.substr(dot + 1);
    // Not a number of an effect: the law, a common factor, what is known.
    if (effect == "law" || effect == "added_mass" || parameter.name == "board_friction.factor" ||
        parameter.name == "servo_droop.tau")
      continue;
    const auto names = parameter_names();
    const auto found = std::ranges::find_if(
        names, [&](const ParameterName& n) { return n.effect == effect && n.parameter == name; });
    ASSERT_NE(found, names.end()) << parameter.name;
    EXPECT_EQ(found->unit, parameter.unit) << parameter.name;
    const pb::Scene changed = override_scene(scene, parameter.overrides);
    const NamedEffect* now = nullptr;
    const std::vector<NamedEffect> effects = effects_of_scene(changed);
    if (effect == "poisson") continue;  // the base's own number changes
    now = find(effects, effect);
    const double before = found->parameter == "factor" ? 1 : 0;
    // One that another number switches off does nothing yet.
    if (now == nullptr) continue;
    EXPECT_NEAR(now->find(name)->value, before + parameter.step, 1e-9 * parameter.step + 1e-15)
        << parameter.name;
    ++checked;
  }
  EXPECT_GT(checked, 30);
}

TEST(EffectNames, MeanWhatTheySay) {
  pb::Scene scene = base_scene();
  NamedEffect soft{"soft_spot", {{"k", "1", 0.4}, {"r", "m", 0.012}}, {{"centre_x", "m", 0.01}}};
  NamedEffect hard{"inclusion", {{"k", "1", 4}, {"r", "m", 0.01}}, {{"centre_y", "m", 0.02}}};
  NamedEffect glue{"adhesion", {{"k", "N/m3", 1e5}, {"delta_c", "m", 0.001 / std::sqrt(2.0)}}, {}};
  NamedEffect rubs{"board_friction", {{"mu", "1", 0.5}}, {}};
  NamedEffect clamp{"anchor_compliance", {{"K_per_length", "N/m2", 2000}}, {}};
  NamedEffect lag{"bandwidth", {{"tau", "s", 0.04}}, {}};
  apply_effects({soft, hard, glue, rubs, clamp, lag}, scene);
  const pb::TissueEffects& effects = scene.tissue().effects();
  ASSERT_EQ(effects.inclusion_size(), 2);
  EXPECT_NEAR(effects.inclusion(0).stiffness_change(), -0.6, 1e-15);
  EXPECT_EQ(effects.inclusion(0).x_m(), 0.01);
  EXPECT_EQ(effects.inclusion(1).stiffness_change(), 3);
  EXPECT_NEAR(effects.adhesion().break_m(), 0.001, 1e-15);
  EXPECT_NEAR(effects.friction_change(), 1, 1e-15);
  EXPECT_EQ(effects.anchor().compliance_m2_per_n(), 1.0 / 2000);
  EXPECT_EQ(scene.arm().bandwidth_s(), 0.02);
  const std::vector<NamedEffect> named = effects_of_scene(scene);
  ASSERT_NE(find(named, "soft_spot"), nullptr);
  EXPECT_NEAR(derived_values(*find(named, "soft_spot"))[0].value, 0.4 * 0.012 * 0.012, 1e-15);
  // Work of separation: the triangle under k d up to half of break_m and down to 0.
  EXPECT_NEAR(derived_values(*find(named, "adhesion"))[0].value, 1e5 * 0.001 * 0.001 / 4, 1e-12);
  NamedEffect bent{"rest_shape", {{"kappa_x", "1/m", -2}, {"twist", "1/m", 1}}, {}};
  EXPECT_NEAR(derived_values(bent)[0].value, -1 - std::sqrt(2.0), 1e-12);
}

TEST(EffectNames, BadInputIsOneLine) {
  const auto message = [](const NamedEffect& effect) -> std::string {
    pb::Scene scene = base_scene();
    try {
      apply_effects({effect}, scene);
    } catch (const Error& error) {
      EXPECT_EQ(std::string(error.what()).find('\n'), std::string::npos);
      return error.what();
    }
    return "";
  };
  EXPECT_THAT(message({"wobble", {}, {}}), HasSubstr("wobble: no effect of that name"));
  EXPECT_THAT(message({"adhesion", {{"q", "1", 1}}, {}}),
              HasSubstr("adhesion.q: no parameter of that name"));
  for (const double bad : {std::nan(""), 1e30, -1.0, std::numeric_limits<double>::infinity()}) {
    EXPECT_THAT(message({"adhesion", {{"k", "N/m3", bad}}, {}}),
                HasSubstr("makes scene.tissue.effects.adhesion.stiffness_pa_per_m"));
  }
  EXPECT_THAT(message({"anchor_compliance", {{"K_per_length", "N/m2", 0}}, {}}),
              HasSubstr("compliance_m2_per_n"));
}

}  // namespace
}  // namespace omentum

// The catalogue of effects against the schema, the values and the tests' own list.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <set>

#include "core/check.h"
#include "support/effect_scene.h"

namespace omentum {
namespace {

constexpr EffectModel kModels[] = {kClusterModel, kShellModel, kSolidModel, kSoftBodyModel,
                                   kReferenceModel};

std::span<const EffectRow> value_rows() {
  const auto rows = effect_catalogue();
  return rows.first(sizeof(EffectValues) / sizeof(double));
}

/// Every double of the schema, repeated messages three times.
void list_paths(const google::protobuf::Descriptor& message, const std::string& prefix,
                std::set<std::string>& paths) {
  for (int k = 0; k < message.field_count(); ++k) {
    const auto& field = *message.field(k);
    const std::string name = prefix + field.name();
    if (field.message_type() == nullptr) {
      paths.insert(name);
    } else if (field.is_repeated()) {
      for (const char* index : {"[0]", "[1]", "[2]"})
        list_paths(*field.message_type(), name + index + ".", paths);
    } else {
      list_paths(*field.message_type(), name + ".", paths);
    }
  }
}

TEST(EffectCatalogue, HasARowForEveryValueOfTheSchema) {
  std::set<std::string> schema;
  list_paths(*pb::TissueEffects::descriptor(), "", schema);
  std::set<std::string> rows;
  for (const EffectRow& row : effect_catalogue()) rows.insert(row.path);
  EXPECT_EQ(rows, schema);
  EXPECT_EQ(rows.size(), effect_catalogue().size());
}

TEST(EffectCatalogue, ValuesAreEveryDoubleOfEffectValuesOnce) {
  EffectValues values;
  std::set<const double*> members;
  for (const EffectRow& row : value_rows()) members.insert(&row.member(values));
  EXPECT_EQ(members.size(), sizeof values / sizeof(double));
  EXPECT_EQ(*members.rbegin() - *members.begin() + 1, sizeof values / sizeof(double));
}

TEST(EffectCatalogue, NeutralValuesAreTheDefaultsOfTheSchema) {
  EXPECT_EQ(make_effects({}, 0.3, {}), EffectValues{});
}

TEST(EffectCatalogue, AValueIsTheKnobsTimesItsFactor) {
  for (const EffectRow& row : value_rows()) {
    const pb::Knob& knob = knob_of(row);
    pb::TissueEffects effects;
    const double value = knob.min() + 0.6 * (knob.max() - knob.min());
    if (row.of != nullptr) set_effect(effects, row.of, 0.01);
    if (std::string(row.path) == "anchor.break_m")
      set_effect(effects, "anchor.compliance_m2_per_n", 0.01);
    if (std::string(row.path) == "anchor.free_from_m") set_effect(effects, "anchor.free_to_m", 1);
    set_effect(effects, row.path, value);
    if (std::string(row.path) == "poisson_change") {
      EXPECT_THROW(make_effects(effects, 0.49, {}), Error);
      continue;
    }
    EXPECT_DOUBLE_EQ(row.get(make_effects(effects, 0.3, {})), row.factor * value) << row.path;
  }
}

TEST(EffectCatalogue, AScaleOfAnEffectThatIsOffDoesNotCount) {
  for (const EffectRow& row : value_rows()) {
    if (row.of == nullptr) continue;
    pb::TissueEffects effects;
    set_effect(effects, row.path, knob_of(row).max());
    EXPECT_EQ(make_effects(effects, 0.3, {}), EffectValues{}) << row.path;
  }
}

TEST(EffectCatalogue, ValuesOutsideTheirKnobAreNotUsable) {
  for (const EffectRow& row : value_rows()) {
    const pb::Knob& knob = knob_of(row);
    for (const double bad : {knob.max() * 1.01 + 1, knob.min() - 1 - knob.max(), std::nan("")}) {
      EffectValues values;
      row.member(values) = row.factor * bad;
      EXPECT_FALSE(usable(values, 0.3, {})) << row.path << " " << bad;
    }
  }
  EXPECT_TRUE(usable(EffectValues{}, 0.3, {}));
}

TEST(EffectCatalogue, AModelRefusesWhatItLacksAndTakesTheRest) {
  for (const EffectModel model : kModels) {
    for (const EffectRow& row : effect_catalogue()) {
      if (row.of != nullptr) continue;
      pb::TissueEffects effects;
      set_effect(effects, row.path, 0.01);
      const bool has = (row.models & model) != 0;
      EXPECT_EQ(has_effects(effects, model), has) << row.path;
      if (has) {
        EXPECT_NO_THROW(refuse_effects(effects, model, "this model")) << row.path;
      } else {
        const std::string name =
            std::string(row.path).substr(0, std::string(row.path).find_first_of(".["));
        try {
          refuse_effects(effects, model, "this model");
          ADD_FAILURE() << row.path;
        } catch (const Error& error) {
          EXPECT_THAT(error.what(),
                      testing::HasSubstr("effects." + name +
                                         ": not possible with this model, allowed there: "));
        }
      }
      if (row.member == nullptr) continue;
      EffectValues values;
      row.member(values) = 0.25;
      EXPECT_EQ(effects_of_model(values, model), has ? values : EffectValues{}) << row.path;
    }
  }
}

TEST(EffectCatalogue, OnlyRowsOfAPartAndBakedRowsTellScenesApart) {
  for (const EffectRow& row : value_rows()) {
    EffectValues values;
    row.member(values) += 0.25;
    EXPECT_EQ(values.same_structure({}), row.part != EffectPart::kStructure) << row.path;
    for (const EffectModel model : kModels)
      EXPECT_EQ(baked_fit({}, values, model), (row.baked & model) == 0) << row.path;
  }
}

TEST(EffectCatalogue, EveryEffectIsOnTheTestsList) {
  std::set<std::string> on;
  for (const test::NamedEffect& effect : test::all_effects()) {
    pb::TissueEffects effects;
    effect.set(effects, 1);
    const EffectValues values = make_effects(effects, 0.4, {});
    for (const EffectRow& row : value_rows()) {
      if (row.of == nullptr && row.get(values) != 0) on.insert(row.path);
    }
  }
  // More of the same effect, with tests of their own.
  const std::set<std::string> variants = {
      "viscoelastic[1].share",         "viscoelastic[2].share", "inclusion[1].stiffness_change",
      "inclusion[2].stiffness_change", "anchor.break_m",        "grasp_offset.radius_m"};
  for (const EffectRow& row : value_rows()) {
    if (row.of != nullptr || variants.count(row.path) != 0) continue;
    EXPECT_EQ(on.count(row.path), 1U) << row.path;
  }
}

}  // namespace
}  // namespace omentum

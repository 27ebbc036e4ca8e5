#include "core/config.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <set>

#include "core/check.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using google::protobuf::Descriptor;
using google::protobuf::FieldDescriptor;
using testing::AllOf;
using testing::EndsWith;
using testing::HasSubstr;
using testing::Not;

pb::Config with(const std::string& set) { return load_config("omentum", std::vector{set}); }

std::string knob_refusal(const std::string& set) {
  try {
    with(set);
  } catch (const Error& error) {
    return error.what();
  }
  return "accepted";
}

TEST(Set, GivesOneKnobItsValueAndNothingBesideIt) {
  for (const char* more : {" } ppo { hidden: 64", "\n} ppo { hidden: 64", " ppo.hidden: 64",
                           " } } ppo { hidden: 64 # "}) {
    const std::string said = knob_refusal(std::string("task.increment_m=0.001") + more);
    EXPECT_THAT(said, AllOf(HasSubstr("--set task.increment_m=0.001"), HasSubstr("more than one")));
    EXPECT_THAT(said, Not(HasSubstr("\n")));
  }
  EXPECT_THAT(knob_refusal("scene.target_m={ x: 0.01 } tool { roll_deg: 3 }"),
              HasSubstr("more than"));
  EXPECT_EQ(with("report.task=a\" } ppo { hidden: 64\n").report().task(),
            "a\" } ppo { hidden: 64\n");
  EXPECT_EQ(with("scene.target_m={ x: 0.01 }").scene().target_m().x(), 0.01);
}

TEST(Set, TakesWholeNumbersAs1e6) {
  EXPECT_EQ(with("rollout.max_steps=1e6").rollout().max_steps(), 1000000);
  EXPECT_EQ(with("rollout.max_steps=1.5E3").rollout().max_steps(), 1500);
  EXPECT_THAT(knob_refusal("rollout.max_steps=1.5"), HasSubstr("Expected integer, got: 1.5"));
  EXPECT_THAT(knob_refusal("rollout.max_steps=1e30"), HasSubstr("Expected integer"));
  EXPECT_THAT(knob_refusal("ppo.hidden=-1"), HasSubstr("Expected integer"));
}

TEST(ConfigText, TakesWholeNumbersAs1e6AndKeepsItsLines) {
  const pb::Config config =
      parse_config("mine", "ppo { gamma: 1e0 hidden: 1e2 }\nrollout { max_steps: 2e6 }\n");
  EXPECT_EQ(config.ppo().hidden(), 100);
  EXPECT_EQ(config.rollout().max_steps(), 2000000);
  EXPECT_THROW(
      {
        try {
          parse_config("mine", "rollout { max_steps: 1e6 }\nrollout { slots: x }");
        } catch (const Error& error) {
          EXPECT_THAT(error.what(), HasSubstr("mine:2:18: Expected integer, got: x"));
          throw;
        }
      },
      Error);
}

TEST(EnumErrors, ListWhatIsAllowedThere) {
  const char* const rewards = "REWARD_PAPER, REWARD_DERIVED, REWARD_DERIVED_HEAD, REWARD_OMENTUM";
  EXPECT_THAT(knob_refusal("task.reward=REWARD_FREE"),
              AllOf(HasSubstr("task.reward=REWARD_FREE"), EndsWith(rewards)));
  EXPECT_THAT(knob_refusal("task.reward=1.5"), EndsWith(rewards));
  EXPECT_THAT(knob_refusal("scene.tissue.model=SOFT"),
              EndsWith("TISSUE_CLUSTER, TISSUE_ELASTIC, TISSUE_REFERENCE"));
  try {
    parse_config("mine", "task {\n  reward: NONE\n}");
    FAIL();
  } catch (const Error& error) {
    EXPECT_THAT(error.what(), AllOf(testing::StartsWith("mine:3:1: "), EndsWith(rewards)));
  }
}

/// Calls see(field, path) for every field, once per place.
template <typename See>
void for_each_field(const Descriptor& message, const std::string& prefix, See&& see) {
  for (int i = 0; i < message.field_count(); ++i) {
    const FieldDescriptor& field = *message.field(i);
    const std::string path = prefix + field.name();
    see(field, path);
    if (field.message_type() != nullptr && field.message_type() != pb::Vec3::descriptor())
      for_each_field(*field.message_type(), path + (field.is_repeated() ? "[]." : "."), see);
  }
}

// What the errors of enums in files rest on.
TEST(EnumErrors, NoTwoFieldsOfOneNameDifferInType) {
  std::map<std::string, std::set<const void*>> types;
  for_each_field(*pb::Config::descriptor(), "", [&](const FieldDescriptor& field, const auto&) {
    if (field.enum_type() != nullptr) types[field.name()].insert(field.enum_type());
  });
  for (const auto& [name, kinds] : types) EXPECT_EQ(kinds.size(), 1U) << name;
}

TEST(Help, NamesEveryKnobVectorsAndPosesTooWithUnitAndDefault) {
  std::map<std::string, std::string> lines;
  std::istringstream help(knob_help());
  for (std::string line; std::getline(help, line);) {
    const std::size_t equals = line.find(" = ");
    if (line.starts_with("  ") && equals != std::string::npos)
      lines[line.substr(2, equals - 2)] = line.substr(equals + 3);
  }
  const std::pair<const char*, const char*> units[] = {
      {"_m", " m"}, {"_deg", " deg"}, {"_px", " px"}, {"_n", " N"}, {"_hz", " Hz"}, {"_pa", " Pa"}};
  for_each_field(
      *pb::Config::descriptor(), "", [&](const FieldDescriptor& field, const auto& path) {
        if (field.message_type() != nullptr && field.message_type() != pb::Vec3::descriptor())
          return;
        ASSERT_TRUE(lines.contains(path)) << path;
        EXPECT_FALSE(lines[path].empty()) << path;
        const bool rate = path.find("_per_") != std::string::npos;
        for (const auto& [ending, unit] : units) {
          if (!path.ends_with(ending)) continue;
          EXPECT_THAT(lines[path], HasSubstr(rate ? "/" : unit)) << path;
        }
      });
  EXPECT_THAT(lines["scene.target_m"], HasSubstr("{ x: 0 y: 0 z: 0 } m"));
  EXPECT_THAT(lines["scene.tool.base.translation_m"], HasSubstr(" m"));
  EXPECT_THAT(lines["task.increment_m"], testing::StartsWith("0.0005 m  [1e-05 ... 0.01]"));
}

TEST(FormatVersion, UnknownIsRefusedInEveryFileThatHasOne) {
  EXPECT_THAT(knob_refusal("format_version=2"), HasSubstr("format_version: 2, allowed 1"));
  EXPECT_THAT(knob_refusal("scene.format_version=2"),
              HasSubstr("scene.format_version: 2, allowed 1"));
  const test::TempDir folder;
  for (const char* version : {"0", "99"}) {
    const std::string text = std::string("\n  format_version: ") + version;
    EXPECT_THROW(parse_config("mine", text), Error);
    std::ofstream(folder / "scene.txtpb") << text;
    EXPECT_THROW(load_scene(folder / "scene.txtpb", {}), Error);
  }
}

TEST(ByteOrderMark, IsNoPartOfATextFile) {
  const test::TempDir folder;
  std::ofstream(folder / "scene.txtpb") << "\xef\xbb\xbfname: \"mine\"\n";
  EXPECT_EQ(load_scene(folder / "scene.txtpb", {}).name(), "mine");
}

}  // namespace
}  // namespace omentum

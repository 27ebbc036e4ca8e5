// Messages of ROS are read by the definition in the file, whatever its fields and their order.
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "core/check.h"
#include "mismatch/recording/depth_image.h"
#include "mismatch/ros/frame_tree.h"
#include "mismatch/ros/images.h"
#include "mismatch/ros/message.h"
#include "support/ros_bag.h"

namespace omentum {
namespace {

using test::RosBytes;
using testing::HasSubstr;

RosSchema schema_of(const std::string& text, RosVersion version = RosVersion::kTwo) {
  Result<RosSchema> made = parse_ros_schema("a/A", text, version);
  EXPECT_TRUE(made.has_value()) << made.error();
  return std::move(made).value();
}

std::string refused(const std::string& text, RosVersion version = RosVersion::kTwo) {
  const Result<RosSchema> made = parse_ros_schema("a/A", text, version);
  return made ? "nothing refused" : made.error();
}

RosVersion version_of(RosBytes::Form form) {
  return form == RosBytes::kPacked ? RosVersion::kOne : RosVersion::kTwo;
}
RosEncoding encoding_of(RosBytes::Form form) {
  return form == RosBytes::kPacked ? RosEncoding::kRos1 : RosEncoding::kCdr;
}

TEST(RosSchemas, ConstantsCommentsDefaultsAndBoundsTakeNoPart) {
  const RosSchema schema = schema_of(
      "# a comment\n"
      "uint8 FLOAT32=7  # a constant\n"
      "string WORD = with # and = in it\n"
      "\n"
      "float64 x 1.5    # a default\n"
      "string<=10 name \"a=b\"\n"
      "int32[<=5] some [1, 2]\n"
      "\tuint16[3]   three#behind\r\n"
      "b/msg/B other\n"
      "================================\n"
      "MSG: b/B\n"
      "C[] many\n"
      "===\n"
      "MSG: b/C\n"
      "bool yes\n");
  const RosType& a = schema.types.front();
  std::vector<std::string> names;
  for (const RosField& field : a.fields) names.push_back(field.name);
  EXPECT_THAT(names, testing::ElementsAre("x", "name", "some", "three", "other"));
  EXPECT_EQ(a.fields[2].shape, RosField::kOpen);
  EXPECT_EQ(a.fields[3].shape, RosField::kFixed);
  EXPECT_EQ(a.fields[3].count, 3);
  EXPECT_EQ(schema.types[a.fields[4].type].name, "b/B") << "with and without msg is one name";
  EXPECT_EQ(schema.types[schema.types[a.fields[4].type].fields[0].type].name, "b/C")
      << "a name without package is of the same one";
}

TEST(RosSchemas, WhatIsWrongIsToldInOneLine) {
  EXPECT_THAT(refused("float64 x\nNothing y\n"), HasSubstr("line 2: type Nothing of y"));
  EXPECT_THAT(refused("A again\n"), HasSubstr("holds itself"));
  EXPECT_THAT(refused("B b\n===\nMSG: a/B\nA[] back\n"), HasSubstr("holds itself"));
  EXPECT_THAT(refused("wstring wide\n"), HasSubstr("wide strings"));
  EXPECT_THAT(refused("float64\n"), HasSubstr("needed type and name"));
  EXPECT_THAT(refused("float64[0] none\n"), HasSubstr("count"));
  EXPECT_THAT(refused("float64 x\n===\nfloat64 y\n"), HasSubstr("needed MSG:"));
  EXPECT_THAT(refused("float64 x 3\n", RosVersion::kOne), HasSubstr("behind the name"));
  EXPECT_THAT(refused("E[] e\n===\nMSG: a/E\n", RosVersion::kOne),
              HasSubstr("messages without fields"));
  std::string deep = "T1 x\n";
  for (int k = 1; k < 40; ++k) deep += fmt::format("===\nMSG: a/T{}\nT{} x\n", k, k + 1);
  EXPECT_THAT(refused(deep + "===\nMSG: a/T40\nbool b\n"), HasSubstr("levels"));
}

/// A joint state in one of several shapes: other order, fields that nobody knows.
struct Shape {
  const char* definition;
  std::function<void(RosBytes&)> write;
};
std::vector<Shape> shapes() {
  const std::vector<std::string> names = {"yaw", "pitch", "insertion"};
  const std::vector<double> position = {0.1, -0.2, 0.15}, velocity = {1, 2, 3};
  const std::vector<double> effort = {};
  return {
      {"string[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
       [=](RosBytes& b) { b.texts(names).open(position).open(velocity).open(effort); }},
      {"float64[] effort\nfloat64[] velocity\nstring[] name\nfloat64[] position\n",
       [=](RosBytes& b) { b.open(effort).open(velocity).texts(names).open(position); }},
      {"bool valid\nfloat32[3] gains\nExtra[] extras\nstring[] name\nuint8 odd\n"
       "float64[] position\nstring note\nfloat64[] velocity\nint16 x\nfloat64[] effort\n"
       "duration_like[2] d\nuint8 last\n===\nMSG: a/Extra\nuint8 k\nfloat64 v\nstring s\n"
       "===\nMSG: a/duration_like\nint64 ns\n",
       [=](RosBytes& b) {
         b.put(true).fixed<float>({1, 2, 3});
         b.put(std::uint32_t{2});
         for (const char* s : {"one", ""}) b.put(std::uint8_t{9}).put(2.5).text(s);
         b.texts(names).put(std::uint8_t{1}).open(position).text("abc").open(velocity);
         b.put(std::int16_t{-3}).open(effort).put(std::int64_t{5}).put(std::int64_t{6});
         b.put(std::uint8_t{1});
       }},
      {"int8[] bytes\nfloat64[] position\nstring[] name\nfloat64[<=9] velocity\n"
       "float64[] effort\n",
       [=](RosBytes& b) {
         b.open<std::int8_t>({1, 2, 3}).open(position).texts(names).open(velocity).open(effort);
       }},
  };
}

TEST(RosMessages, OrderFurtherFieldsAndByteOrderDoNotChangeWhatIsRead) {
  for (const auto form : {RosBytes::kPacked, RosBytes::kLittle, RosBytes::kBig}) {
    for (const Shape& shape : shapes()) {
      std::string text = shape.definition;
      const std::size_t bound = text.find("<=9");  // ROS 1 has none
      if (form == RosBytes::kPacked && bound < text.size()) text.erase(bound, 3);
      const RosSchema schema = schema_of(text, version_of(form));
      RosBytes bytes(form);
      shape.write(bytes);
      const auto made = decode_ros_message(schema, encoding_of(form), bytes.bytes());
      ASSERT_TRUE(made.has_value()) << made.error() << " " << text;
      const RosValue& state = made.value();
      ASSERT_EQ(state.get("name").items.size(), 3) << text;
      EXPECT_EQ(state.get("name").items[2].bytes, "insertion");
      EXPECT_EQ(state.numbers_at("position").size(), 3);
      EXPECT_EQ(state.numbers_at("position").at(1), -0.2);
      EXPECT_EQ(state.numbers_at("velocity").at(2), 3);
      EXPECT_EQ(state.numbers_at("effort").size(), 0);
    }
  }
}

/// A random definition with the bytes of a message of it, and what must be read.
class RandomMessage {
 public:
  RandomMessage(std::uint64_t seed, RosBytes::Form form) : random_(seed), bytes_(form) {
    const int count = 1 + pick(12);
    for (int k = 0; k < count; ++k) add(fmt::format("f{}", k));
    definition_ += "===\nMSG: a/Inner\nuint8 small\nfloat64 x\nstring s\n";
  }
  const std::string& definition() const { return definition_; }
  const std::string& bytes() const { return bytes_.bytes(); }
  void check(const RosValue& value) const {
    for (const auto& [path, number] : numbers_) EXPECT_EQ(value.number_at(path), number) << path;
    for (const auto& [path, list] : lists_) {
      const RosValue& found = value.numbers_at(path);
      ASSERT_EQ(found.size(), list.size()) << path;
      for (std::size_t k = 0; k < list.size(); ++k) EXPECT_EQ(found.at(k), list[k]);
    }
    for (const auto& [path, text] : texts_) EXPECT_EQ(value.text_at(path), text) << path;
  }

 private:
  int pick(int count) { return std::uniform_int_distribution<int>(0, count - 1)(random_); }

  template <typename T>
  void add_number(const std::string& type, const std::string& name) {
    const int shape = pick(3);
    std::vector<T> values;
    const int count = shape == 0 ? 1 : shape == 1 ? 3 : pick(4);
    for (int k = 0; k < count; ++k) values.push_back(static_cast<T>(pick(120)));
    const std::string brackets = shape == 0 ? "" : shape == 1 ? "[3]" : "[]";
    definition_ += type + brackets + " " + name + "\n";
    if (shape == 2) bytes_.put(static_cast<std::uint32_t>(count));
    bytes_.fixed(values);
    if (shape == 0) {
      numbers_[name] = static_cast<double>(values[0]);
    } else {
      lists_[name].assign(values.begin(), values.end());
    }
  }

  void add(const std::string& name) {
    switch (pick(8)) {
      case 0:
        return add_number<std::uint8_t>("uint8", name);
      case 1:
        return add_number<std::int16_t>("int16", name);
      case 2:
        return add_number<std::uint32_t>("uint32", name);
      case 3:
        return add_number<std::int64_t>("int64", name);
      case 4:
        return add_number<float>("float32", name);
      case 5:
        return add_number<double>("float64", name);
      case 6: {
        texts_[name] = std::string(static_cast<std::size_t>(pick(9)), 'q');
        definition_ += "string " + name + "\n";
        bytes_.text(texts_[name]);
        return;
      }
      default: {
        definition_ += "Inner " + name + "\n";
        numbers_[name + ".small"] = pick(200);
        numbers_[name + ".x"] = pick(200);
        texts_[name + ".s"] = "in";
        bytes_.put(static_cast<std::uint8_t>(numbers_[name + ".small"]));
        bytes_.put(numbers_[name + ".x"]).text("in");
      }
    }
  }

  std::mt19937_64 random_;
  RosBytes bytes_;
  std::string definition_;
  std::map<std::string, double> numbers_;
  std::map<std::string, std::vector<double>> lists_;
  std::map<std::string, std::string> texts_;
};

TEST(RosMessages, RandomDefinitionsAreReadBackAndTheirPrefixesRefused) {
  for (const auto form : {RosBytes::kPacked, RosBytes::kLittle, RosBytes::kBig}) {
    for (std::uint64_t seed = 0; seed < 300; ++seed) {
      const RandomMessage message(seed, form);
      const RosSchema schema = schema_of(message.definition(), version_of(form));
      const std::string& bytes = message.bytes();
      const auto made = decode_ros_message(schema, encoding_of(form), bytes);
      ASSERT_TRUE(made.has_value()) << made.error() << "\n" << message.definition();
      message.check(made.value());
      for (std::size_t size = 0; size < bytes.size(); ++size)
        EXPECT_FALSE(decode_ros_message(schema, encoding_of(form), bytes.substr(0, size)))
            << size << "\n"
            << message.definition();
      EXPECT_FALSE(decode_ros_message(schema, encoding_of(form), bytes + "12345678"));
    }
  }
}

TEST(RosMessages, LengthsThatLieAreRefusedAtOnce) {
  const RosSchema schema = schema_of("P[] points\n===\nMSG: a/P\nfloat64 x\n");
  RosBytes bytes(RosBytes::kLittle);
  bytes.put(std::uint32_t{0xffffffff}).put(1.0);
  EXPECT_THAT(decode_ros_message(schema, RosEncoding::kCdr, bytes.bytes()).error(),
              HasSubstr("ends inside points"));
  EXPECT_THAT(
      decode_ros_message(schema, RosEncoding::kCdr, std::string("\0\3\0\0\0\0\0\0", 8)).error(),
      HasSubstr("cdr of kind 3"));
}

TEST(RosMessages, EmptyMessagesOfRos2HoldAByte) {
  const std::string text = "E e\nuint32 x\n===\nMSG: a/E\n# nothing\n";
  RosBytes two(RosBytes::kLittle), one;
  two.put(std::uint8_t{0}).put(std::uint32_t{5});
  one.put(std::uint32_t{5});
  EXPECT_EQ(
      decode_ros_message(schema_of(text), RosEncoding::kCdr, two.bytes()).value().number_at("x"),
      5);
  const RosSchema first = schema_of(text, RosVersion::kOne);
  EXPECT_EQ(decode_ros_message(first, RosEncoding::kRos1, one.bytes()).value().number_at("x"), 5);
}

constexpr const char* kImage =
    "uint32 height\nuint32 width\nstring encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n";

/// A picture of 3 x 2 pixels with `fill` bytes behind each row.
RosValue image_value(const RosSchema& schema, std::string& bytes, const std::string& encoding,
                     const std::string& pixels, std::size_t row, bool big, std::size_t fill = 0) {
  std::string data;
  for (std::size_t at = 0; at < pixels.size(); at += row)
    data += pixels.substr(at, row) + std::string(fill, 'x');
  RosBytes made(RosBytes::kLittle);
  made.put(std::uint32_t{2}).put(std::uint32_t{3}).text(encoding);
  made.put(static_cast<std::uint8_t>(big)).put(static_cast<std::uint32_t>(row + fill)).blob(data);
  bytes = made.bytes();
  return decode_ros_message(schema, RosEncoding::kCdr, bytes).value();
}

std::string plain(RosBytes bytes) { return bytes.bytes(); }

TEST(RosImages, DepthIsTheSameInEveryEncodingAndByteOrder) {
  const RosSchema schema = schema_of(kImage);
  const std::vector<std::uint16_t> mm = {0, 1, 256, 1000, 2000, 65535};
  std::string bytes;
  for (const bool big : {false, true}) {
    for (const std::size_t fill : {0, 5}) {
      std::string pixels, metres;
      for (const std::uint16_t z : mm) {
        std::string two = {static_cast<char>(z & 0xff), static_cast<char>(z >> 8)};
        if (big) std::swap(two[0], two[1]);
        pixels += two;
        const float m = 1e-3F * static_cast<float>(z);
        std::string four(4, ' ');
        std::memcpy(four.data(), &m, 4);
        if (big) std::reverse(four.begin(), four.end());
        metres += four;
      }
      const auto read = [&](const char* encoding, const std::string& data, std::size_t row) {
        const RosValue value = image_value(schema, bytes, encoding, data, row, big, fill);
        return parse_depth_png("test", depth_png(ros_image(value), 1e-3)).value();
      };
      for (const DepthImage& image :
           {read("16UC1", pixels, 6), read("mono16", pixels, 6), read("32FC1", metres, 12)}) {
        EXPECT_EQ(image.width, 3);
        EXPECT_EQ(image.height, 2);
        EXPECT_EQ(image.depth, mm);
      }
    }
  }
  float none[6] = {NAN, -1, INFINITY, 70, 0.0004F, 1};
  const RosValue value = image_value(
      schema, bytes, "32FC1", std::string(reinterpret_cast<const char*>(none), 24), 12, false);
  EXPECT_EQ(parse_depth_png("test", depth_png(ros_image(value), 1e-3)).value().depth,
            (std::vector<std::uint16_t>{0, 0, 0, 0, 0, 1000}));
}

TEST(RosImages, ColourKeepsItsOrderAndSizesThatLieAreRefused) {
  const RosSchema schema = schema_of(kImage);
  std::string bytes;
  const auto size = [&](const char* encoding, std::size_t row) {
    const RosValue value =
        image_value(schema, bytes, encoding, std::string(2 * row, 'a'), row, false);
    return parse_png_size("test", color_png(ros_image(value))).value();
  };
  EXPECT_EQ(size("rgb8", 9).channels, 3);
  EXPECT_EQ(size("bgra8", 12).channels, 3);
  EXPECT_EQ(size("mono8", 3).channels, 1);
  std::string rgb, bgr;
  for (int k = 0; k < 6; ++k) {
    rgb += {static_cast<char>(k), 'g', 'b'};
    bgr += {'b', 'g', static_cast<char>(k)};
  }
  std::string other;
  const RosValue a = image_value(schema, bytes, "rgb8", rgb, 9, false);
  const RosValue b = image_value(schema, other, "bgr8", bgr, 9, false);
  EXPECT_EQ(color_png(ros_image(a)), color_png(ros_image(b)));
  const RosValue few = image_value(schema, bytes, "16UC1", std::string(10, 'a'), 5, false);
  EXPECT_THROW(ros_image(few), Error);
}

TEST(RosClouds, OffsetsByteOrderAndWidthOfNumbersDoNotChangeThePoints) {
  const std::string text =
      "uint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\nuint32 point_step\n"
      "uint32 row_step\nuint8[] data\nbool is_dense\n===\nMSG: a/PointField\nstring name\n"
      "uint32 offset\nuint8 datatype\nuint32 count\n";
  const RosSchema schema = schema_of(text);
  const std::vector<Eigen::Vector3f> points = {{1, 2, 3}, {NAN, 0, 0}, {-4, 5.5F, 0.25F}};
  for (const bool big : {false, true}) {
    for (const bool wide : {false, true}) {
      const std::uint32_t each = wide ? 8 : 4;
      std::string data;
      for (const auto& p : points) {
        data += "rgb!";  // a field in front, z y x behind it
        for (const int k : {2, 1, 0}) {
          RosBytes number(big ? RosBytes::kBig : RosBytes::kLittle);
          if (wide) {
            number.put(double{p[k]});
          } else {
            number.put(p[k]);
          }
          data += number.bytes().substr(4);
        }
      }
      RosBytes bytes(RosBytes::kLittle);
      bytes.put(std::uint32_t{1}).put(std::uint32_t{3}).put(std::uint32_t{4});
      const auto field = [&](const char* name, std::uint32_t offset, bool number) {
        bytes.text(name).put(offset);
        bytes.put(static_cast<std::uint8_t>(number && wide ? 8 : 7)).put(std::uint32_t{1});
      };
      field("rgb", 0, false);
      field("x", 4 + 2 * each, true);
      field("y", 4 + each, true);
      field("z", 4, true);
      const std::uint32_t step = 4 + 3 * each;
      bytes.put(big).put(step).put(3 * step).blob(data).put(false);
      const auto value = decode_ros_message(schema, RosEncoding::kCdr, bytes.bytes());
      ASSERT_TRUE(value.has_value()) << value.error();
      Eigen::Isometry3d X = Eigen::Isometry3d::Identity();
      EXPECT_EQ(ros_cloud(value.value(), X), (Cloud{points[0], points[2]}));
      X.translation().z() = 1;
      EXPECT_EQ(ros_cloud(value.value(), X)[0], Eigen::Vector3f(1, 2, 4));
    }
  }
}

TEST(RosImages, CompressedDepthIsTheDepthItWasMadeOf) {
  const RosSchema schema = schema_of("string format\nuint8[] data\n");
  const auto value_of = [&](std::string& bytes, const std::string& format,
                            const std::string& data) {
    bytes = plain(RosBytes(RosBytes::kLittle).text(format).blob(data));
    return decode_ros_message(schema, RosEncoding::kCdr, bytes).value();
  };
  std::string bytes;
  const DepthImage image{3, 2, {0, 500, 1000, 2000, 4000, 9999}};
  const std::string png = encode_depth_png(image);
  const RosValue whole = value_of(bytes, "16UC1; compressedDepth png", std::string(12, 'h') + png);
  EXPECT_EQ(packed_image(whole), PackedImage::kDepthPng);
  EXPECT_EQ(unpacked_depth_png(whole, 1e-3), png);
  // Inverted depth: a / z + b, as image_transport has it.
  const float a = 100, b = 10;
  DepthImage inverted = image;
  for (std::uint16_t& z : inverted.depth)
    z = z == 0 ? z : static_cast<std::uint16_t>(std::lround(a * 1000 / z + b));
  std::string header(12, '\0');
  std::memcpy(header.data() + 4, &a, 4);
  std::memcpy(header.data() + 8, &b, 4);
  const RosValue metres =
      value_of(bytes, "32FC1; compressedDepth png", header + encode_depth_png(inverted));
  EXPECT_EQ(packed_image(metres), PackedImage::kDepthInvertedPng);
  const DepthImage back = parse_depth_png("test", unpacked_depth_png(metres, 1e-3)).value();
  for (std::size_t k = 0; k < image.depth.size(); ++k) {
    const double z = 1e-3 * image.depth[k];
    EXPECT_NEAR(1e-3 * back.depth[k], z, 6e-4 + 0.5 * z * z / double{a})
        << k;  // half a step of each
  }
  EXPECT_EQ(packed_image(value_of(bytes, "jpeg", "\xff\xd8\xff")), PackedImage::kJpeg);
  EXPECT_EQ(packed_image(value_of(bytes, "16UC1; compressedDepth rvl", "abc")),
            PackedImage::kOther);
}

TEST(RosFrames, ChainsOfFixedTransformsLeadToW) {
  FrameTree tree;
  Eigen::Isometry3d X = Eigen::Isometry3d::Identity(), Y = X;
  X.translation().x() = 1;
  Y.rotate(Eigen::AngleAxisd(1, Eigen::Vector3d::UnitZ()));
  tree.add("base", "arm", X);
  tree.add("/arm", "/camera", Y);
  EXPECT_THAT(tree.to_world("camera").error(), HasSubstr("no transform to W"));
  EXPECT_EQ(tree.root("camera"), "base");
  EXPECT_TRUE(tree.pose_in("base", "camera").value().isApprox(X * Y));
  tree.set_world("base");
  EXPECT_TRUE(tree.to_world("camera").value().isApprox(X * Y));
  tree.state("arm", Y);
  EXPECT_TRUE(tree.to_world("camera").value().isApprox(Y * Y)) << "what is stated goes first";
  tree.add("arm", "camera", Y);
  EXPECT_TRUE(tree.to_world("camera").has_value()) << "the same once more";
  tree.add("arm", "camera", X);
  EXPECT_THAT(tree.to_world("camera").error(), HasSubstr("moves"));
  tree.add("b", "a", X);
  tree.add("a", "b", X);
  EXPECT_FALSE(tree.to_world("a").has_value()) << "a ring ends";
}

}  // namespace
}  // namespace omentum

#include "core/dds_config.h"

#include <gtest/gtest.h>
#include <stdlib.h>

#include <fstream>
#include <map>
#include <regex>
#include <sstream>
#include <string>

#include "core/check.h"
#include "core/dds.h"
#include "core/dds_options.h"
#include "tests/support/domain.h"

namespace omentum {
namespace {

using test::PrivateDomain;

// Unsets a variable for one test.
class Without {
 public:
  explicit Without(const char* name) : name_(name) {
    const char* value = std::getenv(name);
    had_ = value != nullptr;
    if (had_) value_ = value;
    unsetenv(name);
  }
  ~Without() {
    if (had_) setenv(name_, value_.c_str(), 1);
  }
  Without(const Without&) = delete;
  Without& operator=(const Without&) = delete;

 private:
  const char* name_;
  bool had_ = false;
  std::string value_;
};

// What deploy/dds/ ships: addresses come from the environment, as Cyclone reads it.
std::map<std::string, DdsConfig> shipped() {
  DdsConfig small;
  small.large_buffers = false;
  DdsConfig mesh;
  mesh.discovery = Discovery::kMesh;
  mesh.interface = "${OMENTUM_DDS_INTERFACE:-eth0}";
  mesh.peers = {"${OMENTUM_DDS_PEER:-learner}"};
  DdsConfig hub = mesh;
  hub.discovery = Discovery::kHub;
  hub.peers = {"${OMENTUM_DDS_HUB:-learner:7410}"};
  DdsConfig hub_learner = hub;
  hub_learner.role = DdsRole::kHub;
  DdsConfig secure = hub;
  secure.security_dir = "${OMENTUM_SECURITY_DIR:-/run/secrets}";
  return {{"loopback", {}}, {"small-buffer", small},      {"mesh", mesh},
          {"hub", hub},     {"hub-learner", hub_learner}, {"hub-secure", secure}};
}

TEST(DdsConfig, ShippedFilesAreItsOutput) {
  for (const auto& [name, config] : shipped()) {
    const std::string path = std::string(OMENTUM_SOURCE_DIR) + "/deploy/dds/" + name + ".xml";
    std::stringstream text;
    text << std::ifstream(path).rdbuf();
    EXPECT_EQ(dds_config_xml(config), text.str()) << path;
  }
}

TEST(DdsConfig, APathIsWrittenAsXmlWantsIt) {
  DdsConfig config;
  config.security_dir = "/a&b/<c>\"";
  const std::string xml = dds_config_xml(config);
  EXPECT_NE(xml.find("file:/a&amp;b/&lt;c&gt;&quot;/key.pem<"), std::string::npos) << xml;
  EXPECT_EQ(xml.find("a&b"), std::string::npos);
}

TEST(DdsConfig, EveryCombinationIsAcceptedByTheMiddleware) {
  for (const Discovery discovery : {Discovery::kLoopback, Discovery::kMesh, Discovery::kHub}) {
    for (const DdsRole role : {DdsRole::kHub, DdsRole::kOther}) {
      for (const bool large : {false, true}) {
        const PrivateDomain domain;
        DdsConfig config;
        config.discovery = discovery;
        config.role = role;
        config.large_buffers = large;
        config.interface = "127.0.0.1";
        config.peers = {"127.0.0.1"};
        const dds::Participant participant(domain.id(), dds_config_xml(config), "test");
        EXPECT_GT(participant.handle(), 0);
      }
    }
  }
}

TEST(DdsConfig, TheThreeChoicesAreIndependent) {
  for (const Discovery discovery : {Discovery::kLoopback, Discovery::kMesh, Discovery::kHub}) {
    DdsConfig plain;
    plain.discovery = discovery;
    plain.interface = "eth7";
    DdsConfig small = plain, secure = plain;
    small.large_buffers = false;
    secure.security_dir = "/keys";
    EXPECT_NE(dds_config_xml(small).find("<WhcHigh>32kB"), std::string::npos);
    EXPECT_EQ(dds_config_xml(plain).find("Security"), std::string::npos);
    const std::string text = dds_config_xml(secure);
    EXPECT_NE(text.find("file:/keys/certificate.pem"), std::string::npos);
    // Cyclone 0.10.2 aborts with both.
    EXPECT_NE(text.find("<EnableTopicDiscoveryEndpoints>false"), std::string::npos);
    const bool loopback = discovery == Discovery::kLoopback;
    EXPECT_EQ(text.find(">65500B<") != std::string::npos, loopback);
    EXPECT_EQ(text.find("name=\"lo\"") != std::string::npos, loopback);
  }
}

TEST(DdsOptions, AHubIsFoundAtTheLearnersPortThroughTheInterfaceThatRoutesToIt) {
  const Without uri("CYCLONEDDS_URI");
  DdsOptions options;
  options.discovery = "hub";
  options.hub = "localhost";
  const Result<DdsProfile> worker = find_dds_profile(options, DdsRole::kOther, 3, 0);
  ASSERT_TRUE(worker) << worker.error();
  EXPECT_NE(worker.value().uri.find("<Peer Address=\"127.0.0.1:8160\"/>"), std::string::npos);
  EXPECT_NE(worker.value().uri.find("NetworkInterface address=\"127.0.0.1\""), std::string::npos);
  EXPECT_NE(worker.value().uri.find("<ParticipantIndex>none<"), std::string::npos);
  const Result<DdsProfile> learner = find_dds_profile(options, DdsRole::kHub, 3, 0);
  ASSERT_TRUE(learner) << learner.error();
  EXPECT_NE(learner.value().uri.find("<ParticipantIndex>0<"), std::string::npos);
}

TEST(DdsOptions, ANameThatDoesNotExistIsSaidAndNotLeftToTheMiddleware) {
  const Without uri("CYCLONEDDS_URI");
  DdsOptions options;
  options.discovery = "mesh";
  options.peers = {"127.0.0.1", "no-such-host.invalid"};
  const Result<DdsProfile> profile = find_dds_profile(options, DdsRole::kOther, 0, 0);
  ASSERT_FALSE(profile);
  EXPECT_NE(profile.error().find("host name no-such-host.invalid: "), std::string::npos);
  int asked = 0;
  EXPECT_FALSE(
      wait_for_dds_profile(options, DdsRole::kOther, 0, 0, 0, [&] { return ++asked > 2; }));
}

TEST(DdsOptions, OptionsThatDoNotFitTogetherAreRefusedByName) {
  const auto refusal = [](DdsOptions options) {
    try {
      (void)find_dds_profile(options, DdsRole::kOther, 0, 0);
    } catch (const Error& error) {
      return std::string(error.what());
    }
    return std::string("taken");
  };
  DdsOptions options;
  options.discovery = "multicast";
  EXPECT_EQ(refusal(options), "--discovery multicast: loopback, mesh or hub");
  options.discovery = "mesh";
  EXPECT_EQ(refusal(options), "--discovery mesh needs --peers HOST,HOST,...");
  options.discovery = "hub";
  EXPECT_EQ(refusal(options), "--discovery hub needs --hub HOST, the learner's");
  options.hub = "a";
  options.peers = {"b"};
  EXPECT_EQ(refusal(options), "--peers has a meaning with --discovery mesh only");
  options = {};
  options.hub = "a";
  EXPECT_EQ(refusal(options), "--hub has a meaning with --discovery hub only");
  options = {};
  options.interface = "eth0";
  EXPECT_EQ(refusal(options), "--interface has no meaning with --discovery loopback");
}

TEST(DdsOptions, TheEnvironmentWinsAndSmallBuffersAreNoticed) {
  const Without uri("CYCLONEDDS_URI");
  setenv("CYCLONEDDS_URI", "<CycloneDDS/>", 1);
  const auto profile = [](std::size_t needed_bytes) {
    return find_dds_profile({}, DdsRole::kOther, 0, needed_bytes).value();
  };
  EXPECT_EQ(profile(1).name, "environment");
  EXPECT_EQ(profile(1).uri, "<CycloneDDS/>");
  unsetenv("CYCLONEDDS_URI");
  EXPECT_EQ(profile(1).name, "loopback");
  EXPECT_EQ(profile(1).task_spacing_ns, 0);
  EXPECT_GT(profile(1).receive_buffer_bytes, 100'000u);
  if (profile(1).receive_buffer_bytes < kReceiveBufferBytes) {
    EXPECT_TRUE(profile(kReceiveBufferBytes).small_buffer);
    EXPECT_EQ(profile(kReceiveBufferBytes).task_spacing_ns, 200'000);
  }
}

TEST(DdsOptions, TheEnvironmentLineSurvivesAShell) {
  DdsProfile profile;
  profile.uri = "a'b\n<c d=\"e\"/>";
  EXPECT_EQ(dds_environment(profile), "export CYCLONEDDS_URI='a'\\''b<c d=\"e\"/>'\n");
}

}  // namespace
}  // namespace omentum

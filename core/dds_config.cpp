#include "core/dds_config.h"

#include <string_view>

#include "core/check.h"

namespace omentum {
namespace {

// docs/wire.md 5.3: two bursts of 16 segments fit; with small receive buffers no burst may.
constexpr std::string_view kLargeWatermarks =
    "<WhcHighInit>2MB</WhcHighInit><WhcHigh>8MB</WhcHigh>";
constexpr std::string_view kSmallWatermarks =
    "<WhcAdaptive>false</WhcAdaptive><WhcHighInit>32kB</WhcHighInit><WhcHigh>32kB</WhcHigh>";

/// A text as the value of an attribute or an element.
std::string escaped(const std::string& text) {
  std::string xml;
  for (const char c : text) {
    switch (c) {
      case '&':
        xml += "&amp;";
        break;
      case '<':
        xml += "&lt;";
        break;
      case '>':
        xml += "&gt;";
        break;
      case '"':
        xml += "&quot;";
        break;
      default:
        xml += c;
    }
  }
  return xml;
}

std::string discovery_xml(const DdsConfig& config) {
  std::string peers;
  for (const std::string& peer : config.peers)
    peers += fmt::format("<Peer Address=\"{}\"/>", escaped(peer));
  // Only one process of a hub has a port that others can know. Elsewhere the ports of a host are
  // tried one after the other; Cyclone's own limit of 9 stops the eleventh process.
  std::string index =
      "<ParticipantIndex>auto</ParticipantIndex>\n"
      "      <MaxAutoParticipantIndex>80</MaxAutoParticipantIndex>";
  if (config.discovery == Discovery::kHub) {
    index = fmt::format("<ParticipantIndex>{}</ParticipantIndex>",
                        config.role == DdsRole::kHub ? "0" : "none");
  }
  return fmt::format(R"(    <Discovery>
      {}
      <LeaseDuration>2s</LeaseDuration>
      <SPDPInterval>500ms</SPDPInterval>
      <EnableTopicDiscoveryEndpoints>{}</EnableTopicDiscoveryEndpoints>
      <Peers>{}</Peers>
    </Discovery>
)",
                     // With both it and security Cyclone 0.10.2 aborts in dds_create_topic.
                     index, config.security_dir.empty() ? "true" : "false", peers);
}

std::string security_xml(const std::string& dir) {
  if (dir.empty()) return "";
  return fmt::format(R"(    <Security>
      <Authentication>
        <Library initFunction="init_authentication" finalizeFunction="finalize_authentication" path="dds_security_auth"/>
        <IdentityCA>file:{0}/identity_ca.pem</IdentityCA>
        <IdentityCertificate>file:{0}/certificate.pem</IdentityCertificate>
        <PrivateKey>file:{0}/key.pem</PrivateKey>
        <CRL>file:{0}/crl.pem</CRL>
      </Authentication>
      <AccessControl>
        <Library initFunction="init_access_control" finalizeFunction="finalize_access_control" path="dds_security_ac"/>
        <PermissionsCA>file:{0}/permissions_ca.pem</PermissionsCA>
        <Governance>file:{0}/governance.p7s</Governance>
        <Permissions>file:{0}/permissions.p7s</Permissions>
      </AccessControl>
      <Cryptographic>
        <Library initFunction="init_crypto" finalizeFunction="finalize_crypto" path="dds_security_crypto"/>
      </Cryptographic>
    </Security>
)",
                     escaped(dir));
}

}  // namespace

std::string dds_config_xml(const DdsConfig& config) {
  DdsConfig own = config;
  if (config.discovery == Discovery::kLoopback) {
    own.interface = "lo";
    own.peers = {"127.0.0.1"};
  }
  OMENTUM_CHECK(!own.interface.empty());
  return fmt::format(
      R"(<CycloneDDS xmlns="https://cdds.io/config">
  <Domain Id="any">
    <General>
      <Interfaces><NetworkInterface {}="{}"/></Interfaces>
      <AllowMulticast>false</AllowMulticast>
      <MaxMessageSize>{}</MaxMessageSize>
    </General>
{}    <Internal>
      <SocketReceiveBufferSize min="default" max="4MiB"/>
      <HeartbeatInterval>20ms</HeartbeatInterval>
      <NackDelay>10ms</NackDelay>
      <Watermarks>{}</Watermarks>
    </Internal>
{}  </Domain>
</CycloneDDS>
)",
      // An address is no name of an interface to Cyclone.
      own.interface.find_first_not_of("0123456789.") == std::string::npos ? "address" : "name",
      escaped(own.interface),
      // Over Ethernet a large datagram is lost with any of its 45 frames.
      own.discovery == Discovery::kLoopback ? "65500B" : "14720B", discovery_xml(own),
      own.large_buffers ? kLargeWatermarks : kSmallWatermarks, security_xml(own.security_dir));
}

}  // namespace omentum

// Findings of `omentum doctor`, one by one.
#include "monitor/doctor.h"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "tests/monitor/run_fixture.h"
#include "tests/support/domain.h"
#include "tests/support/temp_dir.h"

namespace omentum {
namespace {

using test::arrived;
using test::some_learner;
using test::some_worker;
using testing::HasSubstr;

constexpr std::int64_t kDoctorNow = 100'000'000'000;

TEST(Doctor, SmallBuffersAreWrongAndFourMebibytesAreNot) {
  const Finding small = check_receive_buffer(212'992);
  EXPECT_FALSE(small.ok);
  EXPECT_THAT(small.remedy, HasSubstr("net.core.rmem_max=4194304"));
  EXPECT_TRUE(check_receive_buffer(4'194'304).ok);
}

TEST(Doctor, AnInterfaceThatIsNotThereIsWrong) {
  EXPECT_TRUE(check_interfaces("").ok);
  EXPECT_TRUE(check_interfaces("lo").ok);
  EXPECT_TRUE(check_interfaces("127.0.0.1").ok);
  const Finding none = check_interfaces("eth99");
  EXPECT_FALSE(none.ok);
  EXPECT_THAT(none.detail, HasSubstr("eth99 is not up"));
}

TEST(Domain, OfARunIsThatOfItsFolder) {
  const test::TempDir folder;
  std::filesystem::create_directories(folder / "mine");
  std::ofstream(folder / "mine/config.txtpb") << "run { domain: 33 } of_another_version: 1\n";
  ToolOptions options;
  options.run = "mine";
  options.runs_dir = folder.path();
  find_domain(options);
  EXPECT_EQ(options.domain, 33u);
  options.domain = 7;
  options.domain_named = true;
  find_domain(options);
  EXPECT_EQ(options.domain, 7u);
}

TEST(Domain, ThoseInUseAreReadFromTheirPorts) {
  const std::string table =
      "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when\n"
      "  1: 0100007F:1CF2 00000000:0000 07 00000000:00000000 00:00000000 00000000\n"   // 7410
      "  2: 0100007F:3F2D 00000000:0000 07 00000000:00000000 00:00000000 00000000\n"   // 16173
      "  3: 0100007F:0035 00000000:0000 07 00000000:00000000 00:00000000 00000000\n"   // 53
      "  4: 0100007F:9C40 00000000:0000 07 00000000:00000000 00:00000000 00000000\n";  // 40000
  EXPECT_EQ(domains_in_use(table), (std::vector<std::uint32_t>{0, 35}));
}

TEST(Doctor, ANameThatDoesNotExistIsWrong) {
  EXPECT_TRUE(check_name("127.0.0.1").ok);
  EXPECT_FALSE(check_name("no-such-host.invalid").ok);
}

TEST(Doctor, APortThatIsTakenIsCounted) {
  const test::PrivateDomain domain;
  EXPECT_THAT(check_ports(domain.id()).detail, HasSubstr("81 of 81"));
  const int fd = socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(discovery_port(domain.id()) + 4));
  ASSERT_EQ(bind(fd, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  EXPECT_THAT(check_ports(domain.id()).detail, HasSubstr("80 of 81"));
  close(fd);
}

TEST(Doctor, AFolderWithoutCertificatesIsWrong) {
  const Finding finding = check_certificates("/no/such/folder", 0);
  EXPECT_FALSE(finding.ok);
  EXPECT_THAT(finding.detail, HasSubstr("/no/such/folder"));
}

TEST(Doctor, AWorkerOfAnotherBuildIsWrong) {
  RunState state("fixture");
  state.apply(arrived(some_learner()), kDoctorNow);
  RunManifest manifest;
  manifest.learner_epoch = 7;
  manifest.build_id = 0xabc;
  state.apply(arrived(manifest), kDoctorNow);
  WorkerStatus same = some_worker(1), other = some_worker(2);
  same.build_id = 0xabc;
  other.build_id = 0xdef;
  state.apply(arrived(same), kDoctorNow);
  state.apply(arrived(other), kDoctorNow);
  const auto findings = check_run(state, {}, kDoctorNow);
  ASSERT_EQ(findings.size(), 3u);
  EXPECT_TRUE(findings[1].ok);
  EXPECT_FALSE(findings[2].ok);
  EXPECT_THAT(findings[2].detail, HasSubstr("2 on node2 pid 4002: build 0000000000000def"));
}

TEST(Doctor, WhatIsWrongSaysWhatToTypeOnItsOwnLine) {
  EXPECT_EQ(print_finding({true, "clock", "synchronised", ""}),
            "ok     clock            synchronised\n");
  EXPECT_EQ(print_finding({false, "clock", "wrong", "set it"}),
            "WRONG  clock            wrong\n                        -> set it\n");
}

}  // namespace
}  // namespace omentum

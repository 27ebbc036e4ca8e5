// What a program says of a folder of --security-dir that is not right, before it joins.
#include <gmock/gmock.h>
#include <sys/stat.h>

#include "core/certificate.h"
#include "core/clock.h"
#include "core/dds.h"
#include "core/wire.h"
#include "tests/security/certificates.h"

namespace omentum::test {
namespace {

using testing::HasSubstr;

const Strings kFiles = {"identity_ca.pem",    "certificate.pem", "key.pem",        "crl.pem",
                        "permissions_ca.pem", "governance.p7s",  "permissions.p7s"};

class SecurityDir : public testing::Test {
 protected:
  SecurityDir() { copy("worker"); }
  /// A copy of a role's folder that the test may spoil.
  void copy(const std::string& role) {
    std::filesystem::remove_all(dir_);
    std::filesystem::copy(certificates_.of(role), dir_);
  }
  std::string fault() const {
    const Result<Certificate> checked = check_security_dir(dir_);
    return checked ? "" : checked.error();
  }
  /// Remakes the worker's certificate with a validity of its own.
  void copy_renewed(const Strings& validity) {
    certificates_.make(Strings{"--role", "worker", "--renew"} + validity);
    copy("worker");
  }
  void write(const std::string& file, const std::string& text) const {
    std::ofstream(dir_ + "/" + file, std::ios::binary) << text;
  }
  std::string text(const std::string& role, const std::string& file) const {
    return read_text(certificates_.of(role) + "/" + file);
  }

  Programs programs_;
  Certificates certificates_{programs_};
  std::string dir_ = programs_.folder() / "dir";
};

TEST_F(SecurityDir, NamesRoleAndValidityOfAGoodOne) {
  const Result<Certificate> checked = check_security_dir(dir_);
  ASSERT_TRUE(checked) << checked.error();
  EXPECT_EQ(checked.value().name, "worker");
  const std::int64_t now_s = wall_now_ns() / 1'000'000'000;
  EXPECT_LT(checked.value().begin_s, now_s);
  EXPECT_GT(checked.value().end_s, now_s + 364 * 86400);
  EXPECT_EQ(certificate_end(dir_).value(), checked.value().end_s);
  EXPECT_EQ(certificate_name(dir_ + "/certificate.pem"), "worker");
}

TEST_F(SecurityDir, SaysWhichFileIsMissingEmptyOrGarbage) {
  for (const std::string& file : kFiles) {
    SCOPED_TRACE(file);
    const std::string path = dir_ + "/" + file;
    copy("worker");
    std::filesystem::remove(path);
    EXPECT_THAT(fault(), HasSubstr(path + ": No such file or directory: deploy/security/make.sh"));
    write(file, "");
    EXPECT_THAT(fault(), HasSubstr(path + " is empty"));
    write(file, std::string(3000, '\xff'));
    EXPECT_THAT(fault(), HasSubstr(path));
  }
}

TEST_F(SecurityDir, RefusesEveryPairOfSwappedFiles) {
  for (const std::string& a : kFiles) {
    for (const std::string& b : kFiles) {
      if (a == b) continue;
      copy("worker");
      write(a, text("worker", b));
      EXPECT_NE(fault(), "") << b << " in the place of " << a;
    }
  }
}

TEST_F(SecurityDir, RefusesFilesOfAnotherRoleOrAuthority) {
  Programs others;
  const Certificates elsewhere(others);
  for (const std::string& file : kFiles) {
    copy("worker");
    write(file, read_text(elsewhere.of("worker") + "/" + file));
    EXPECT_NE(fault(), "") << "another authority's " << file;
  }
  for (const std::string file : {"key.pem", "certificate.pem", "permissions.p7s"}) {
    copy("worker");
    write(file, text("learner", file));
    EXPECT_THAT(fault(), HasSubstr("copy the folder")) << "the learner's " << file;
  }
}

TEST_F(SecurityDir, RefusesPrefixesOfPermissionsAndFlippedBytes) {
  const std::string whole = text("worker", "permissions.p7s");
  for (std::size_t size = 0; size + 200 < whole.size(); size += 37) {
    write("permissions.p7s", whole.substr(0, size));
    EXPECT_NE(fault(), "") << size << " bytes";
  }
  // The signature holds every byte of the text.
  const std::size_t begin = whole.find("<dds>");
  const std::size_t end = whole.find("</dds>");
  for (std::size_t at = begin; at < end; at += 11) {
    std::string flipped = whole;
    flipped[at] = static_cast<char>(flipped[at] ^ 1);
    write("permissions.p7s", flipped);
    EXPECT_NE(fault(), "") << "byte " << at;
  }
}

TEST_F(SecurityDir, TellsAnEndedCertificateBothTimes) {
  copy_renewed({"--from", "2 hours ago", "--until", "1 hour ago"});
  EXPECT_THAT(fault(), HasSubstr("certificate.pem was valid until 20"));
  EXPECT_THAT(fault(), HasSubstr("the clock of this machine says 20"));
  EXPECT_THAT(fault(), HasSubstr("deploy/security/make.sh --renew --role worker"));
}

TEST_F(SecurityDir, TellsAClockThatIsAnHourBehind) {
  copy_renewed({"--from", "1 hour", "--until", "2 hours"});
  EXPECT_THAT(fault(), HasSubstr("certificate.pem is valid from 20"));
  EXPECT_THAT(fault(), HasSubstr("60 min before it: set the clock"));
}

TEST_F(SecurityDir, TellsPermissionsThatEndedAlone) {
  copy_renewed({"--from", "2 hours ago", "--until", "1 hour ago"});
  const std::string ended = text("worker", "permissions.p7s");
  copy_renewed({});
  write("permissions.p7s", ended);
  EXPECT_THAT(fault(), HasSubstr("permissions.p7s was valid until"));
}

TEST_F(SecurityDir, TellsARevokedCertificate) {
  certificates_.make({"--revoke", "worker"});
  copy("worker");
  EXPECT_THAT(fault(), HasSubstr("certificate.pem is revoked: deploy/security/make.sh --role"));
}

TEST_F(SecurityDir, ProgramsRefuseItWithOneLineAndCodeTwo) {
  std::filesystem::remove(dir_ + "/permissions.p7s");
  const std::string domain = std::to_string(programs_.domain());
  for (const Strings& program : {Strings{OMENTUM_SIM_WORKER, "--domain", domain},
                                 Strings{OMENTUM_LEARNER, "--print-dds-env"}}) {
    const Finished refused = programs_.finish(program + Strings{"--security-dir", dir_});
    EXPECT_EQ(refused.code, 2);
    EXPECT_EQ(lines_of(refused.err).size(), 1u) << refused.err;
    EXPECT_THAT(refused.err, HasSubstr("--security-dir"));
    EXPECT_THAT(refused.err, HasSubstr("permissions.p7s: No such file"));
  }
}

TEST_F(SecurityDir, AKeyThatOnlyAnotherMayReadIsToldWithTheUser) {
  if (geteuid() != 0) GTEST_SKIP() << "needs root, to be somebody else";
  const std::string copied =
      "/tmp/" + std::filesystem::path(programs_.folder().path()).filename().string() + ".keys";
  std::filesystem::copy(dir_, copied);
  ASSERT_EQ(chmod(copied.c_str(), 0755), 0);
  for (const std::string& file : kFiles) ASSERT_EQ(chmod((copied + "/" + file).c_str(), 0644), 0);
  ASSERT_EQ(chmod((copied + "/key.pem").c_str(), 0600), 0);
  const Finished refused =
      programs_.finish({"/usr/bin/setpriv", "--reuid=10001", "--regid=10001", "--clear-groups",
                        OMENTUM_SIM_WORKER, "--security-dir", copied});
  std::filesystem::remove_all(copied);
  EXPECT_EQ(refused.code, 2);
  EXPECT_THAT(refused.err, HasSubstr("key.pem cannot be read by user 10001, group 10001"));
  EXPECT_THAT(refused.err, HasSubstr("make.sh --group 10001"));
}

TEST_F(SecurityDir, WarnsFourteenDaysBeforeTheEndAndSeesTheRenewal) {
  DdsOptions options;
  options.security_dir = dir_;
  const auto profile = [&] {
    return find_dds_profile(options, DdsRole::kOther, programs_.domain(), 0).value();
  };
  EXPECT_EQ(certificate_warning(profile()), std::nullopt);
  copy_renewed({"--days", "13"});
  const DdsProfile soon = profile();
  EXPECT_EQ(soon.certificate_name, "worker");
  EXPECT_THAT(certificate_warning(soon).value_or(""), HasSubstr("make.sh --renew --role worker"));
  copy_renewed({"--days", "100"});
  EXPECT_THAT(certificate_warning(soon).value_or(""), HasSubstr("is taken then"));
}

TEST_F(SecurityDir, AWorkersCertificateMayNotWriteWeights) {
  DdsOptions options;
  options.security_dir = dir_;
  const DdsProfile profile =
      find_dds_profile(options, DdsRole::kOther, programs_.domain(), 0).value();
  const dds::Participant participant(programs_.domain(), profile.uri, "worker");
  const BusReader<PolicyWeights> reader(participant, run_partition("run"), "weights");
  try {
    const BusWriter<PolicyWeights> writer(participant, public_partitions("run"), "weights");
    ADD_FAILURE() << "it may";
  } catch (const Error& error) {
    EXPECT_STREQ(error.what(),
                 "the certificate of worker may not write omentum/policy/weights in partition "
                 "\"\", \"run\": Not Allowed By Security; give --security-dir the folder of this "
                 "program's role and run");
  }
}

TEST_F(SecurityDir, AGatewaysCertificateMayTellOfItsRobotAndNothingElse) {
  certificates_.make({"--role", "gateway"});
  copy("gateway");
  DdsOptions options;
  options.security_dir = dir_;
  const DdsProfile profile =
      find_dds_profile(options, DdsRole::kOther, programs_.domain(), 0).value();
  const dds::Participant participant(programs_.domain(), profile.uri, "gateway");
  const BusWriter<RobotStatus> state(participant, public_partitions("run"), "state");
  const BusWriter<RolloutSegment> segments(participant, public_partitions("run"), "segments", 16);
  const BusWriter<EpisodeSummary> summaries(participant, public_partitions("run"), "summaries");
  const BusReader<PolicyWeights> weights(participant, run_partition("run"), "weights");
  const BusReader<RunManifest> manifests(participant, run_partition("run"), "manifests");
  const BusReader<LearnerStatus> learner(participant, run_partition("run"), "learner");
  EXPECT_THROW((BusWriter<PolicyWeights>(participant, public_partitions("run"), "w")), Error);
  EXPECT_THROW((BusWriter<LearnerStatus>(participant, public_partitions("run"), "w")), Error);
  EXPECT_THROW((BusWriter<WorkerStatus>(participant, public_partitions("run"), "w")), Error);
  EXPECT_THROW((BusReader<RolloutTask>(participant, worker_partition("run", 1), "r")), Error);
}

/// Cyclone tells nobody, and crashes on a new writer (seen as SIGSEGV in dds_create_writer).
TEST_F(SecurityDir, AnExpiredParticipantSaysSoAndTheNextOneIsRenewed) {
  copy_renewed({"--until", "3 seconds"});
  DdsOptions options;
  options.security_dir = dir_;
  const auto uri = [&] {
    return find_dds_profile(options, DdsRole::kOther, programs_.domain(), 0).value().uri;
  };
  {
    const dds::Participant participant(programs_.domain(), uri(), "ends");
    BusWriter<WorkerStatus> writer(participant, public_partitions("run"), "status");
    BusReader<LearnerStatus> reader(participant, run_partition("run"), "status");
    EXPECT_FALSE(participant.expired());
    EXPECT_TRUE(writer.write(WorkerStatus{}));
    const std::int64_t end_s = certificate_end(dir_).value();
    ASSERT_TRUE(eventually([&] { return wall_now_ns() / 1'000'000'000 > end_s; }));
    EXPECT_TRUE(participant.expired());
    EXPECT_TRUE(writer.write(WorkerStatus{})) << "which is why expired() is there";
    EXPECT_TRUE(reader.take(1, [](auto&&) {}));
    EXPECT_THROW(BusWriter<WorkerStatus>(participant, public_partitions("run"), "late"), Error);
    EXPECT_THROW(uri(), Error);
  }
  copy_renewed({});
  const dds::Participant participant(programs_.domain(), uri(), "renewed");
  EXPECT_FALSE(participant.expired());
  BusWriter<WorkerStatus> writer(participant, public_partitions("run"), "status");
  EXPECT_TRUE(writer.write(WorkerStatus{}));
}

}  // namespace
}  // namespace omentum::test

// Trainings over a secured domain, with real processes (docs/cluster.md 5).
#include <gmock/gmock.h>

#include "tests/security/certificates.h"
#include "tests/support/stranger.h"

namespace omentum::test {
namespace {

using std::chrono::seconds;
using testing::HasSubstr;
using testing::Not;

const Strings kSixLanes = {"--lanes", "6"};

class SecuredRun : public testing::Test {
 protected:
  Process secured_learner(const std::string& run, const Strings& sets = tiny_task(),
                          const Strings& more = {}) {
    return programs_.learner(run, sets, certificates_.option("learner") + more);
  }
  Process secured_worker(const std::string& run) {
    return programs_.worker(run, kSixLanes + certificates_.option("worker"));
  }
  bool says(const std::string& run, const std::string& text) const {
    return read_text(programs_.err(run)).find(text) != std::string::npos;
  }

  Programs programs_;
  Certificates certificates_{programs_};
};

TEST_F(SecuredRun, EndsWithTheWeightsOfAnOpenOne) {
  const std::string open = programs_.train("open", tiny_task());
  Process worker = secured_worker("closed");
  Process learner = secured_learner("closed");
  ASSERT_EQ(learner.wait(kRunTime), 0) << read_text(programs_.err("closed"));
  EXPECT_EQ(worker.wait(seconds(20)), 0);
  EXPECT_EQ(programs_.hash("closed"), open);
}

TEST_F(SecuredRun, SimulationsOfRecordingsAreThoseOfAnOpenOne) {
  const std::string& folder = programs_.folder().path();
  std::ofstream(folder + "/sheet.txtpb")
      << "tissue { grid { count_x: 6 count_y: 9 pitch_m: 0.003 } thickness_m: 0.003\n"
         "anchor_max_y_m: -0.011 model: TISSUE_ELASTIC material { damping_per_s: 5 } }\n"
         "tool { base { translation_m { x: 0.1427 z: 0.1584 } } contact: false }\n";
  std::filesystem::create_directory(folder + "/lift");
  std::ofstream(folder + "/lift/tool.csv")
      << "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad\n"
         "0,0,0.011,0,0\n0.1,0,0.011,0.002,0\n";
  const auto simulate = [&](const std::string& out, const Strings& more) {
    const Finished done = programs_.finish(
        Strings{OMENTUM_MISMATCH, "simulate", "--scene", folder + "/sheet.txtpb", "--commands",
                folder + "/lift", "--cloud-rate", "0", "-o", folder + "/" + out} +
        more);
    EXPECT_EQ(done.code, 0) << done.err;
    EXPECT_THAT(done.err, Not(HasSubstr("simulated here instead")));
    return read_text(folder + "/" + out + "/markers.csv");
  };
  const std::string open = simulate("here", {});
  EXPECT_THAT(open, HasSubstr("marker53_z_m"));
  const Process worker = secured_worker("closed");
  EXPECT_EQ(
      simulate("there", Strings{"--run", "closed", "--domain", std::to_string(programs_.domain())} +
                            certificates_.option("mismatch")),
      open);
}

TEST_F(SecuredRun, AParticipantWithoutCertificateGetsNothing) {
  const Stranger stranger(programs_.domain(), "closed");
  Process worker = secured_worker("closed");
  Process learner = secured_learner("closed");
  ASSERT_EQ(learner.wait(kRunTime), 0) << read_text(programs_.err("closed"));
  EXPECT_EQ(worker.wait(seconds(20)), 0);
  EXPECT_EQ(stranger.sent(), 0) << "it answers all that it sees";
  EXPECT_THAT(read_text(programs_.err("closed")), HasSubstr("foreign=0"));
}

TEST_F(SecuredRun, AWorkerWithoutCertificateSeesNoLearner) {
  const std::string log = programs_.folder() / "uncertified";
  const Process uncertified(
      {OMENTUM_SIM_WORKER, "--run", "closed", "--domain", std::to_string(programs_.domain())}, log,
      log);
  ASSERT_TRUE(eventually([&] { return read_text(log).find("info run=") != std::string::npos; }));
  Process worker = secured_worker("closed");
  Process learner = secured_learner("closed");
  ASSERT_EQ(learner.wait(kRunTime), 0) << read_text(programs_.err("closed"));
  EXPECT_EQ(worker.wait(seconds(20)), 0);
  EXPECT_THAT(read_text(log), Not(HasSubstr("follow_learner")));
}

TEST_F(SecuredRun, AWorkersCertificateCannotWriteWeights) {
  Process worker = secured_worker("closed");
  Process learner = secured_learner("closed");
  Process impostor = programs_.learner("impostor", tiny_task(), certificates_.option("worker"));
  EXPECT_EQ(impostor.wait(kRunTime), 2);
  const Strings said = lines_of(read_text(programs_.err("impostor")));
  ASSERT_FALSE(said.empty());
  EXPECT_THAT(said.back(), HasSubstr("the certificate of worker may not"));
  EXPECT_THAT(said.back(), HasSubstr("omentum/"));
  EXPECT_THAT(said.back(), HasSubstr("Not Allowed By Security"));
  EXPECT_EQ(learner.wait(kRunTime), 0) << read_text(programs_.err("closed"));
  EXPECT_EQ(worker.wait(seconds(20)), 0);
}

TEST_F(SecuredRun, PermissionsOfAnotherRunAreRefused) {
  certificates_.make({"--role", "worker", "--renew", "--run", "mine"});
  const Finished other = programs_.finish(Strings{OMENTUM_SIM_WORKER, "--run", "other", "--domain",
                                                  std::to_string(programs_.domain())} +
                                          certificates_.option("worker"));
  EXPECT_EQ(other.code, 2);
  EXPECT_THAT(other.err, HasSubstr("may not"));
  EXPECT_THAT(other.err, HasSubstr("\"other\""));

  Process worker = secured_worker("mine");
  Process learner = secured_learner("mine");
  EXPECT_EQ(learner.wait(kRunTime), 0) << read_text(programs_.err("mine"));
  EXPECT_EQ(worker.wait(seconds(20)), 0);
}

TEST_F(SecuredRun, ARevokedWorkerIsRefusedThoughItKeepsItsOldList) {
  const std::string old_list = read_text(certificates_.of("worker") + "/crl.pem");
  certificates_.make({"--revoke", "worker"});
  std::ofstream(certificates_.of("worker") + "/crl.pem") << old_list;
  Process revoked = secured_worker("closed");
  Process learner = secured_learner("closed", tiny_task(), {"--max-wait", "5"});
  EXPECT_EQ(learner.wait(kRunTime), 1) << "nobody it may talk to";
  EXPECT_THAT(read_text(programs_.err("closed")), Not(HasSubstr("worker_joined")));
  // The same role with another key works.
  certificates_.make({"--role", "worker", "--revoke", "worker"});
  certificates_.make({"--role", "worker"});
  Process again = secured_worker("closed");
  Process second = secured_learner("closed");
  EXPECT_EQ(second.wait(kRunTime), 0) << read_text(programs_.err("closed"));
}

TEST_F(SecuredRun, GoesOnWithAnotherWorkerWhenACertificateEndsInMidRun) {
  certificates_.make({"--role", "worker", "--renew", "--until", "6 seconds"});
  const Process ends = secured_worker("ends");
  Process learner = secured_learner("ends", endless_task());
  ASSERT_TRUE(eventually([&] { return says("ends", "event=worker_joined"); }));
  ASSERT_TRUE(eventually([&] { return says("ends", "event=worker_lost"); }))
      << read_text(programs_.err("ends"));
  certificates_.make({"--role", "worker", "--renew"});
  const Process renewed = secured_worker("ends");
  programs_.expect_goes_on_undisturbed("ends", learner);
}

TEST_F(SecuredRun, AWorkerWhoseCertificateWasRenewedInTimeJoinsAnew) {
  certificates_.make({"--role", "worker", "--renew", "--until", "6 seconds"});
  Process worker = secured_worker("renewed");
  Process learner = secured_learner("renewed", endless_task());
  ASSERT_TRUE(eventually([&] { return says("renewed", "event=worker_joined"); }));
  certificates_.make({"--role", "worker", "--renew"});
  ASSERT_TRUE(eventually([&] {
    const std::string text = read_text(programs_.err("renewed"));
    return text.rfind("event=worker_joined") != text.find("event=worker_joined");
  })) << read_text(programs_.err("renewed"));
  programs_.expect_goes_on_undisturbed("renewed", learner);
  worker.kill(SIGTERM);
  EXPECT_EQ(worker.wait(seconds(20)), 0);
}

}  // namespace
}  // namespace omentum::test

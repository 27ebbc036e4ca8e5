#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(RegistrationFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/registration", 1), 5);
}

}  // namespace
}  // namespace omentum

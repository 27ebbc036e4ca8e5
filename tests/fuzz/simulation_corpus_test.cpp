#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(SimulationFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/simulation", 17), 5);
}

}  // namespace
}  // namespace omentum

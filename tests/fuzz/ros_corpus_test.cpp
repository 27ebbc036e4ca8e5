#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(RosFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/ros", 1), 12);
}

}  // namespace
}  // namespace omentum

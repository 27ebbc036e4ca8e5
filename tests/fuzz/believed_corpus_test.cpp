#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(BelievedFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/believed", 1), 4);
}

}  // namespace
}  // namespace omentum

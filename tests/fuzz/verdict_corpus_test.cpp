#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(VerdictFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/verdict", 3), 2);
}

}  // namespace
}  // namespace omentum

#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(SegmentFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/segment", 1), 8);
}

}  // namespace
}  // namespace omentum

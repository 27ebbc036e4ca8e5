#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(RecordingFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/recording", 3), 7);
}

}  // namespace
}  // namespace omentum

#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(SceneFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/scene", 7), 9);
}

}  // namespace
}  // namespace omentum

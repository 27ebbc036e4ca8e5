#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(ImportFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/import", 1), 8);
}

}  // namespace
}  // namespace omentum

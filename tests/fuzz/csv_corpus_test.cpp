#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(CsvFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/csv", 1), 7);
}

}  // namespace
}  // namespace omentum

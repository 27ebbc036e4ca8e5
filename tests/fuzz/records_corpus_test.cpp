#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(RecordsFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/records", 3), 12);
}

}  // namespace
}  // namespace omentum

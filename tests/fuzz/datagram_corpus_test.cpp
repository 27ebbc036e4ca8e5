#include "tests/fuzz/corpus_runner.h"

namespace omentum {
namespace {

TEST(DatagramFuzz, CorpusPrefixesAndFlippedBytesNeverCrash) {
  EXPECT_GE(test::run_corpus(OMENTUM_TESTS_DIR "/fuzz/corpus/datagram", 1), 12);
}

}  // namespace
}  // namespace omentum

// A foreign writer on the domain of a run until it is killed: dds_stranger RUN DOMAIN.
#include <unistd.h>

#include <cstdlib>

#include "tests/support/stranger.h"

int main(int argc, char** argv) {
  if (argc != 3) return 2;
  const omentum::test::Stranger stranger(static_cast<std::uint32_t>(std::atoi(argv[2])), argv[1]);
  while (true) pause();
}

// Writes the seeds of tests/fuzz/corpus/mcap/. Usage: make_mcap_corpus <folder>

#include <fmt/core.h>

#include <cstdio>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <utility>

#include "core/mcap.h"
#include "proto/recording.pb.h"
#include "tests/support/episode_fixture.h"

int main(int count, char** arguments) {
  if (count != 2) {
    fmt::print(stderr, "usage: make_mcap_corpus <folder>\n");
    return 2;
  }
  const std::string folder = arguments[1];
  const auto write = [&](const std::string& name, const std::string& bytes) {
    std::ofstream(folder + "/" + name, std::ios::binary) << bytes;
  };
  using omentum::McapCompression;
  for (const auto& [name, compression] :
       {std::pair<std::string, McapCompression>{"plain", McapCompression::kNone},
        {"lz4", McapCompression::kLz4},
        {"zstd", McapCompression::kZstd}}) {
    std::ostringstream out;
    omentum::McapWriter writer(out, compression, 64);
    const auto channel = writer.add_channel("/step", *omentum::pb::StepRecord::descriptor());
    omentum::pb::StepRecord record;
    for (std::uint32_t k = 0; k < 3; ++k) writer.write(channel, k, k, record);
    if (!writer.finish()) return 2;
    write(name + ".mcap", out.str());
    write(name + "_cut.mcap", out.str().substr(0, out.str().size() / 2));
  }
  const omentum::EpisodeRecording made = omentum::test::make_episode(2, 2, 1);
  if (!omentum::save_episode(folder + "/episode.mcap", made.task, made.segment, made.context))
    return 2;
  return 0;
}

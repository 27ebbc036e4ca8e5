// Writes the seeds of tests/fuzz/corpus/checkpoint/. Usage: make_checkpoint_corpus <folder>
#include <fmt/format.h>

#include <fstream>
#include <string>

#include "learner/checkpoint.h"
#include "tests/fuzz/tiny_ppo.h"

int main(int argc, char** argv) {
  using namespace omentum;  // NOLINT(google-build-using-namespace)
  if (argc != 2) {
    fmt::print(stderr, "usage: make_checkpoint_corpus <folder>\n");
    return 2;
  }
  const auto ppo = test::make_tiny_ppo();
  pb::Checkpoint checkpoint;
  checkpoint.set_format_version(kCheckpointFormat);
  checkpoint.set_config_text("ppo {\n  hidden: 8\n}\n");
  checkpoint.set_config_hash(1);
  ppo->save(*checkpoint.mutable_ppo());
  to_disk(ppo->weights(), *checkpoint.mutable_previous_weights());
  pb::SlotState& slot = *checkpoint.add_slot();
  slot.set_next_segment(3);
  slot.set_start_state("state");
  slot.set_start_hash(7);
  checkpoint.mutable_ledger()->set_granted(5);
  const Bytes file = encode_checkpoint(checkpoint);
  const auto write = [&](const std::string& name, const char* data, std::size_t size) {
    std::ofstream(std::string(argv[1]) + "/" + name, std::ios::binary)
        .write(data, static_cast<std::streamsize>(size));
  };
  const auto* bytes = reinterpret_cast<const char*>(file.data());
  write("file.pb", bytes, file.size());
  write("truncated.pb", bytes, file.size() / 2);
  write("payload.bin", bytes + 16, file.size() - 20);  // the target frames it itself
  return 0;
}

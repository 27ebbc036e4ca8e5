#pragma once

#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

namespace omentum::test {

/// One line of the recorded session of a robot.
struct WireLine {
  double time_s = 0;
  bool sent = false;     ///< by the client
  std::string datagram;  ///< without the end of line
  int number = 0;        ///< in the file, from 1
};

/// The set dvrk_wire of OMENTUM_REAL_DATA; empty where it is absent.
inline std::vector<WireLine> read_wire_log() {
  const char* folder = std::getenv("OMENTUM_REAL_DATA");  // NOLINT(concurrency-mt-unsafe)
  if (folder == nullptr) return {};
  std::ifstream file(std::string(folder) + "/dvrk_wire/psm1_kinsim_session.tsv");
  std::vector<WireLine> lines;
  std::string text;
  for (int number = 1; std::getline(file, text); ++number) {
    const std::size_t tab = text.find('\t');
    if (text.starts_with('#') || tab == std::string::npos) continue;
    std::string datagram = text.substr(tab + 1);
    const bool sent = datagram.starts_with(">> ");
    if (sent) datagram.erase(0, 3);
    lines.push_back({std::stod(text.substr(0, tab)), sent, datagram, number});
  }
  return lines;
}

}  // namespace omentum::test

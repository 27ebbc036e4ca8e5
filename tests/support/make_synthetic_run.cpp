// Writes made-up runs for looking at the report. Usage: make_synthetic_run <folder> <seeds>; prints
// the report to <folder>/report.html.

#include <fmt/core.h>

#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <string>
#include <vector>

#include "report/report.h"
#include "tests/support/paper_scene.h"
#include "tests/support/synthetic_run.h"

int main(int count, char** arguments) {
  if (count != 3) {
    fmt::print(stderr, "usage: make_synthetic_run <folder> <seeds>\n");
    return 2;
  }
  const std::string folder = arguments[1];
  const int seeds = std::atoi(arguments[2]);
  for (int seed = 1; seed <= seeds; ++seed)
    omentum::test::write_synthetic_run(fmt::format("{}/seed{}", folder, seed), seed);
  const omentum::Scene scene = omentum::test::make_paper_scene();
  std::ofstream(folder + "/report.html", std::ios::binary)
      << omentum::make_report(omentum::load_runs({folder}), &scene);
  return 0;
}

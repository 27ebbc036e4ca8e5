#include "mismatch/explain/verdict_program.h"

#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>

#include "core/check.h"
#include "mismatch/explain/verdict_file.h"
#include "mismatch/explain/verdict_text.h"

namespace omentum {
namespace {

int print_part(const std::string& part, const std::string& folder) {
  namespace fs = std::filesystem;
  const pb::Verdict verdict = read_verdict(folder);
  const fs::path beside =
      fs::is_directory(folder) ? fs::path(folder) : fs::path(folder).parent_path();
  const std::string scene = (beside / "scene.repaired.txtpb").string();
  const std::string text = part == "locate"  ? locate_text(verdict)
                           : part == "name"  ? name_text(verdict)
                           : part == "model" ? model_text(verdict, scene)
                                             : show_text(verdict, scene);
  std::fputs(text.c_str(), stdout);
  if (std::fflush(stdout) != 0) throw_error("standard output: cannot be written");
  return 0;
}

}  // namespace

std::function<int()> add_verdict_commands(CLI::App& app) {
  const auto folder = std::make_shared<std::string>();
  const auto part = std::make_shared<std::string>();
  const auto add = [&](const std::string& name, const std::string& what) {
    CLI::App& sub = *app.add_subcommand(name, what);
    sub.add_option("OUT", *folder, "Folder that mismatch explain wrote, or its verdict.json")
        ->required();
    sub.callback([part, name] { *part = name; });
  };
  add("locate",
      "Print from a stored verdict where simulation and recordings differ, with scores by place");
  add("name",
      "Print from a stored verdict which physics was left out, its rivals, and the misfit that "
      "each leaves");
  add("model",
      "Print from a stored verdict the numbers of the effect with intervals, and the knobs that "
      "switch it on");
  add("show", "Print from a stored verdict all of it on one screen, detection limits included");
  return [part, folder] { return print_part(*part, *folder); };
}

}  // namespace omentum

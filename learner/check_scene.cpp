#include "learner/check_scene.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/mman.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>
#include <filesystem>
#include <system_error>

#include "core/check.h"

namespace omentum {

int check_scene(const std::string& config_text) {
  std::error_code error;
  const std::string worker =
      std::filesystem::read_symlink("/proc/self/exe", error).parent_path() / "sim_worker";
  if (!std::filesystem::exists(worker, error)) {
    std::fprintf(stderr, "learner: the scene is not checked: there is no %s\n", worker.c_str());
    return 0;
  }
  const int file = memfd_create("config", 0);  // inherited by the worker, gone with it
  const auto size = static_cast<ssize_t>(config_text.size());
  if (file < 0 || write(file, config_text.data(), config_text.size()) != size)
    throw_error("--dry-run: no memory for the configuration");
  const std::string path = "/proc/self/fd/" + std::to_string(file);
  const char* arguments[] = {worker.c_str(), "--check-config", path.c_str(), nullptr};
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
  pid_t child = 0;
  const int failed = posix_spawn(&child, worker.c_str(), &actions, nullptr,
                                 const_cast<char**>(arguments), environ);
  posix_spawn_file_actions_destroy(&actions);
  close(file);
  if (failed != 0)
    throw_error("{}: cannot be run: {}", worker, std::generic_category().message(failed));
  int status = 0;
  if (waitpid(child, &status, 0) != child || !WIFEXITED(status))
    throw_error("{} --check-config: did not end by itself", worker);
  return WEXITSTATUS(status);
}

}  // namespace omentum

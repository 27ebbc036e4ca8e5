#include "mismatch/calibrate/case_input.h"

#include <fmt/ranges.h>
#include <unistd.h>

#include <algorithm>
#include <cstdio>
#include <filesystem>

#include "core/check.h"
#include "core/config.h"
#include "mismatch/recording/read_recording.h"
#include "mismatch/recording/text_table.h"
#include "mismatch/scene/believed_scene.h"
#include "mismatch/seen/unreadable_frame.h"

namespace omentum {
namespace {

namespace fs = std::filesystem;

/// "a.prior.txtpb" of the scene "a.txtpb".
std::string prior_file(const std::string& scene) {
  return fs::path(scene).replace_extension(".prior.txtpb").string();
}

/// The scene that was given, else what the recordings say of their set-up; with priors.
pb::Scene scene_of(const std::string& path, const std::vector<std::string>& overrides,
                   const Recording& first, pb::Priors& priors, std::vector<std::string>& warnings) {
  pb::Scene scene;
  if (!path.empty()) {
    if (!path.ends_with(".txt")) {
      const std::string file = prior_file(path);
      if (fs::exists(file)) read_text_proto(file, priors);
      check_ranges(priors, file);
      return load_scene(path, overrides);
    }
    const std::string text = read_whole_file(path);
    Result<BelievedScene> believed = parse_believed_scene(path, text);
    if (!believed) throw_error("{}", believed.error());
    warnings.insert(warnings.end(), believed.value().warnings.begin(),
                    believed.value().warnings.end());
    scene = believed.value().scene;
    priors = believed.value().priors;
  } else if (first.info.has_scene_believed_text()) {
    Result<BelievedScene> believed =
        parse_believed_scene("scene_believed.txt", first.info.scene_believed_text());
    if (!believed) throw_error("{}", believed.error());
    warnings.insert(warnings.end(), believed.value().warnings.begin(),
                    believed.value().warnings.end());
    scene = believed.value().scene;
    priors = believed.value().priors;
  } else if (first.info.has_scene_text()) {
    parse_text_proto("scene of the recording", first.info.scene_text(), scene);
  } else {
    throw_error("--scene: none, and the recordings hold no believed scene");
  }
  return override_scene(scene, overrides);
}

/// What is told of one of several recordings.
std::string told_left_out(const std::string& why) {
  return why + ": this recording is left out; once its file is mended or copied anew it comes in";
}

}  // namespace

CaseInput read_case(const std::vector<std::string>& paths, const std::string& scene,
                    const std::vector<std::string>& overrides) {
  CaseInput input;
  // A scene that was named is read first: recordings take their time.
  if (!scene.empty())
    input.scene = scene_of(scene, overrides, Recording(), input.priors, input.warnings);
  for (const std::string& path : paths) {
    std::size_t count = 0;
    const auto take = [&](const std::string& name, const Recording& recording) {
      for (const auto& [other, unused] : input.recordings) {
        if (other == name) throw_error("--recordings: two are called {}", name);
      }
      input.recordings.emplace_back(name, recording);
      ++count;
    };
    const auto left_out = [&](const std::string& part, const std::string& why) {
      input.left_out.emplace_back(recording_name(part), why);
      input.warnings.push_back(told_left_out(why));
      ++count;
    };
    for_each_recording(path, take, read_recording, left_out);
    if (count == 1) input.named_alone.insert(input.recordings.back().first);
  }
  if (scene.empty()) {
    input.scene =
        scene_of(scene, overrides, input.recordings.front().second, input.priors, input.warnings);
  }
  input.folder = fs::path(scene).parent_path().string();
  return input;
}

void hold_out(const std::vector<std::string>& names, CaseInput& input) {
  for (const std::string& name : names) {
    const auto is_meant = [&name](const std::string& own) {
      return name.ends_with('*') ? own.starts_with(name.substr(0, name.size() - 1)) : own == name;
    };
    bool any = false;
    std::vector<std::string> known;
    for (auto& [own, recording] : input.recordings) {
      known.push_back(own);
      if (!is_meant(own)) continue;
      recording.info.set_held_out(true);
      any = true;
    }
    if (any) continue;
    for (const auto& [own, why] : input.left_out) {
      if (is_meant(own))
        throw_error("--held-out {}: the recording {} cannot be read and is left out: {}", name, own,
                    why);
    }
    throw_error("--held-out: no recording is called {}, there are {}", name,
                fmt::join(known, ", "));
  }
}

std::vector<Observation> observe_case(const CaseInput& input, const Scene& made,
                                      const CloudChoice& clouds, MarkerNotes& notes,
                                      std::vector<std::string>& warnings) {
  // The first by name with markers: equal in whatever order they were named.
  const Recording* first = nullptr;
  std::string first_name;
  for (const auto& [name, recording] : input.recordings) {
    if (recording.find("markers") == nullptr || (first != nullptr && name > first_name)) continue;
    first = &recording;
    first_name = name;
  }
  if (first != nullptr) find_clamp(*first, notes);
  std::vector<Observation> observations;
  std::vector<std::string> refused;
  for (const auto& [name, recording] : input.recordings) {
    std::vector<std::string> own = recording.warnings;
    try {
      observations.push_back(observe(name, name, recording, made, notes, clouds, own));
    } catch (const UnreadableFrame& error) {
      if (input.named_alone.contains(name)) throw;
      refused.emplace_back(error.what());
      own = {told_left_out(refused.back())};
    }
    warnings.insert(warnings.end(), own.begin(), own.end());
  }
  if (observations.empty() && !refused.empty()) throw_error("{}", refused.front());
  std::ranges::sort(observations, {}, &Observation::name);
  number_conditions(observations);
  number_markers(observations, warnings);
  return observations;
}

void tell_warnings(const std::vector<std::string>& warnings, std::size_t& told) {
  for (; told < warnings.size(); ++told)
    std::fprintf(stderr, "warning: %s\n", warnings[told].c_str());
}

bool ProgressLine::is_terminal() { return isatty(STDERR_FILENO) != 0; }

void ProgressLine::show(double share, const std::string& stage, const std::string& work) {
  const std::lock_guard lock(mutex_);
  using Seconds = std::chrono::duration<double>;
  const double passed = Seconds(std::chrono::steady_clock::now() - begin_).count();
  std::string line =
      fmt::format("{}: {:3.0f} %, {}, {}, {:.0f} s", program_, 100 * share, stage, work, passed);
  constexpr double kEnough = 0.02;  // of the work, to say when it ends
  if (share > kEnough) line += fmt::format(", about {:.0f} s left", passed / share * (1 - share));
  if (terminal_) {
    std::fprintf(stderr, "\r%-98s", line.c_str());
    shown_ = true;
  } else if (stage != stage_) {
    std::fprintf(stderr, "%s\n", line.c_str());
  }
  stage_ = stage;
  std::fflush(stderr);
}

void ProgressLine::tell(const std::string& text) {
  const std::lock_guard lock(mutex_);
  std::fprintf(stderr, "%smismatch: %s\n", shown_ ? "\n" : "", text.c_str());
  shown_ = false;
}

void ProgressLine::end() {
  if (shown_) std::fputc('\n', stderr);
  shown_ = false;
}

}  // namespace omentum

#pragma once

#include <chrono>
#include <mutex>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "mismatch/recording/recording.h"
#include "mismatch/seen/observation.h"
#include "mismatch/seen/seen_markers.h"
#include "proto/prior.pb.h"
#include "proto/scene.pb.h"

// What the programs that fit recordings have in common: what comes in, and how far they are.
namespace omentum {

/// A scene and recordings of it as they came in.
struct CaseInput {
  std::vector<std::pair<std::string, Recording>> recordings;  ///< by name
  pb::Scene scene;
  pb::Priors priors;
  std::string folder;                 ///< meshes of the scene lie beside it
  std::set<std::string> named_alone;  ///< recordings that are all that is at a path
  std::vector<std::pair<std::string, std::string>> left_out;  ///< by name, and why
  std::vector<std::string> warnings;
};

/// Recordings from folders, MCAP files or folders of them; the scene of that path (.txtpb, with
/// NAME.prior.txtpb beside it, or scene_believed.txt), else what the recordings say of their
/// set-up. One of several in a folder that cannot be read is left out with a warning. Throws Error.
CaseInput read_case(const std::vector<std::string>& recordings, const std::string& scene,
                    const std::vector<std::string>& overrides);

/// Recordings of these names, or that begin so with "*" at its end, are held out, whatever they say
/// of themselves: predicted, not fitted. Throws Error for a name that none has, with the reason
/// where the recording of that name was left out.
void hold_out(const std::vector<std::string>& names, CaseInput& input);

/// Observations in the order of their names, conditions and markers numbered. What is known of the
/// markers is in `notes`, which learns of the clamp. One of several recordings in a folder whose
/// clouds cannot be read is left out with a warning. Throws Error.
std::vector<Observation> observe_case(const CaseInput& input, const Scene& made,
                                      const CloudChoice& clouds, MarkerNotes& notes,
                                      std::vector<std::string>& warnings);

/// Warnings behind the first `told` go to standard error, and `told` counts them: what is known
/// before anything is simulated is told before, as who meant it otherwise need not wait.
void tell_warnings(const std::vector<std::string>& warnings, std::size_t& told);

/// Share done and time left on standard error, where a person looks at it.
class ProgressLine {
 public:
  explicit ProgressLine(std::string program) : program_(std::move(program)) {}
  ~ProgressLine() { end(); }
  /// `work`: what has been done and by whom.
  void show(double share, const std::string& stage, const std::string& work);
  /// A line of its own, between two states of it.
  void tell(const std::string& text);
  void end();

 private:
  const std::string program_;
  std::mutex mutex_;
  const std::chrono::steady_clock::time_point begin_ = std::chrono::steady_clock::now();
  const bool terminal_ = is_terminal();
  bool shown_ = false;
  std::string stage_;
  static bool is_terminal();
};

}  // namespace omentum

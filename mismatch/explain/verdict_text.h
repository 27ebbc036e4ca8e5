#pragma once

#include <string>

#include "proto/verdict.pb.h"

// Parts of a stored verdict as plain text for a terminal, lines with an end. Precondition: it is
// one that parse_verdict() took.
namespace omentum {

/// Where: centre and radius, or the piece of the clamp, and scores by place.
std::string locate_text(const pb::Verdict& verdict);
/// What: status, sentence, members of the class, rivals and what each leaves.
std::string name_text(const pb::Verdict& verdict);
/// How much: numbers with intervals, and what switches the effect on. `scene`: path of the repaired
/// scene.
std::string model_text(const pb::Verdict& verdict, const std::string& scene);
/// All of it on a screen: the sentence, where, how much, errors before and after, limits.
std::string show_text(const pb::Verdict& verdict, const std::string& scene);
/// Smallest size of each effect that would be seen.
std::string limits_text(const pb::Verdict& verdict);

}  // namespace omentum

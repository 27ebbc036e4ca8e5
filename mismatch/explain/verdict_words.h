#pragma once

#include <string>

#include "proto/verdict.pb.h"
#include "report/section_parts.h"

// Numbers and places of a verdict in words, the same on its page and on a terminal.
namespace omentum {

std::string figure(double value);  ///< three digits; "-" where there is none
std::string mm(double metres);
/// A number of an effect with the digits that its interval justifies (report/section_parts.h).
ShownNumber shown(const pb::VerdictParameter& parameter);
/// "at x = 2.0, y = 4.0 mm from the middle of the sheet"; empty where it says no place.
std::string where_text(const pb::VerdictWhere& where);
/// What a channel that no fit saw says of the claim.
std::string channel_text(const pb::VerdictChannel& channel);
/// "inclusion or soft_spot".
std::string names_of(const pb::VerdictEffect& effect);

}  // namespace omentum

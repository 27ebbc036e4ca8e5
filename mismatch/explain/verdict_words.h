#pragma once

#include <string>

#include "proto/verdict.pb.h"

// Numbers and places of a verdict in words, the same on its page and on a terminal.
namespace omentum {

std::string figure(double value);  ///< four digits; "-" where there is none
std::string mm(double metres);
/// Metres as mm, other units as they are.
std::string with_unit(double value, const std::string& unit);
/// "at x = 2.00, y = 4.00 mm from the middle of the sheet"; empty where it says no place.
std::string where_text(const pb::VerdictWhere& where);
/// What a channel that no fit saw says of the claim.
std::string channel_text(const pb::VerdictChannel& channel);
/// "inclusion or soft_spot".
std::string names_of(const pb::VerdictEffect& effect);

}  // namespace omentum

#pragma once

#include <span>
#include <string>
#include <vector>

#include "mismatch/explain/pulls.h"
#include "proto/verdict.pb.h"
#include "report/section_parts.h"

// Numbers and places of a verdict in words, the same on its page and on a terminal.
namespace omentum {

std::string figure(double value);  ///< three digits; "-" where there is none
std::string mm(double metres);
/// A gain or the threshold of one: below 10 with a decimal, so that it is told from its threshold.
std::string nats(double gain);
/// A number of an effect with the digits that its interval justifies (report/section_parts.h).
ShownNumber shown(const pb::VerdictParameter& parameter);
/// Words for a number of an effect, "play of the tool along z" for tool_backlash and b_z; empty
/// where there are none.
std::string words_of(const std::string& effect, const std::string& number);
/// Name and words, "b_z, play of the tool along z".
std::string named(const std::string& effect, const std::string& number);
/// A key of columns as it is read: "inclusion.k@x=0.002:y=0.004:r=0.009" becomes "inclusion.k at
/// x = 2.0, y = 4.0 mm"; what says no place stays, behind a comma.
std::string key_text(const std::string& key);
/// A text with its keys as key_text() has them.
std::string with_keys_read(const std::string& text);
/// "total = 0.00357 m" of a rival as "total = 3.57 mm"; other texts as they are.
std::string rival_number(const std::string& text);
/// Numbers of a rival in a line, as rival_number() has each.
std::string numbers_of(const pb::VerdictRival& rival);
/// A size of a limit in the unit that people use, "0.2 mm".
std::string least_size(double size, const pb::VerdictLimit& limit);
/// The size that is seen at any place, empty where there is none.
std::string anywhere_text(const pb::VerdictLimit& limit);
/// words_of() the number of a limit.
std::string limit_words(const pb::VerdictLimit& limit);
/// "at x = 2.0, y = 4.0 mm from the middle of the sheet"; empty where it says no place.
std::string where_text(const pb::VerdictWhere& where);
/// What a channel that no fit saw says of the claim.
std::string channel_text(const pb::VerdictChannel& channel);
/// "r08: the camera's clock is 7.6 standard deviations from what was believed".
std::string pull_text(const Pull& pull);
/// Of `pulls` in their order those beyond so many standard deviations, one line for all numbers of
/// a recording that have the same words.
std::vector<std::string> pull_lines(std::span<const Pull> pulls, double beyond);
/// Of a held-out recording whose squared error above its floor grows by more than a tenth with what
/// is claimed; empty where there is none.
std::string contradiction_text(const pb::Verdict& verdict);
/// Whether that is so of all held-out recordings together.
bool foretells_worse(const pb::Verdict& verdict);
/// "inclusion or soft_spot".
std::string names_of(const pb::VerdictEffect& effect);
/// The same as a sentence says them: "a stiffer place (inclusion)".
std::string told_names(const pb::VerdictEffect& effect);

}  // namespace omentum

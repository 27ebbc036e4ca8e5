#include "mismatch/import/file_pattern.h"

#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>

#include "core/csv.h"
#include "core/table.h"
#include "mismatch/recording/text_table.h"

namespace omentum {
namespace {

constexpr std::size_t kMostPieces = 20;
constexpr std::size_t kLongestPath = 4096;

bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
bool is_digit(char c) { return c >= '0' && c <= '9'; }

}  // namespace

Result<FilePattern> FilePattern::parse(std::string_view pattern) {
  FilePattern made;
  const auto wrong = [pattern](const std::string& what) {
    return Failure{fmt::format("\"{}\": {}", shown(pattern), what)};
  };
  std::string_view rest = pattern;
  while (!rest.empty()) {
    Piece piece;
    if (rest.front() == '*') {
      piece.kind = Piece::kStar;
      rest.remove_prefix(1);
    } else if (rest.front() == '{') {
      const std::size_t end = rest.find('}');
      if (end == std::string_view::npos) return wrong("{ without }");
      const std::string_view inside = rest.substr(1, end - 1);
      const std::size_t colon = std::min(inside.find(':'), inside.size());
      const std::string_view kind = inside.substr(std::min(colon + 1, inside.size()));
      piece.text = inside.substr(0, colon);
      rest.remove_prefix(end + 1);
      piece.kind = Piece::kAny;
      if (kind == "letters") piece.kind = Piece::kLetters;
      if (kind == "digits") piece.kind = Piece::kDigits;
      if (const auto count = parse_number(kind); count && *count >= 1 && *count <= 1000) {
        piece.kind = Piece::kCount;
        piece.count = static_cast<std::size_t>(*count);
      }
      if (piece.text.empty()) return wrong("a part without name");
      if (piece.kind == Piece::kAny && colon < inside.size())
        return wrong(fmt::format("{{{}}}: allowed letters, digits or a number of characters",
                                 shown(inside)));
    } else {
      const std::size_t end = std::min(rest.find_first_of("{*"), rest.size());
      piece.text = rest.substr(0, end);
      if (piece.text.find('}') != std::string::npos) return wrong("} without {");
      rest.remove_prefix(end);
    }
    made.pieces_.push_back(std::move(piece));
    if (made.pieces_.size() > 2 * kMostPieces) return wrong("more than 20 parts");
  }
  return made;
}

std::vector<std::string> FilePattern::names() const {
  std::vector<std::string> names;
  for (const Piece& piece : pieces_) {
    if (piece.kind != Piece::kText && piece.kind != Piece::kStar) names.push_back(piece.text);
  }
  return names;
}

bool FilePattern::match_from(std::size_t index, std::string_view rest, Values& values) const {
  if (index == pieces_.size()) return rest.empty();
  const Piece& piece = pieces_[index];
  if (piece.kind == Piece::kText) {
    return rest.starts_with(piece.text) &&
           match_from(index + 1, rest.substr(piece.text.size()), values);
  }
  const bool last = index + 1 == pieces_.size();
  const auto fits = [&](char c) {
    return piece.kind == Piece::kLetters  ? is_letter(c)
           : piece.kind == Piece::kDigits ? is_digit(c)
                                          : c != '/';
  };
  std::size_t size = 0, most = 0;
  while (most < rest.size() && fits(rest[most])) ++most;
  const bool may_be_none = piece.kind == Piece::kDigits || piece.kind == Piece::kStar;
  size = piece.kind == Piece::kCount ? piece.count : may_be_none ? 0 : 1;
  if (piece.kind == Piece::kCount) most = std::min(most, piece.count);
  // The last part takes what is left; letters and digits all there are, so that no way is tried
  // twice.
  if (last || piece.kind == Piece::kLetters || piece.kind == Piece::kDigits)
    size = std::max(size, most);
  for (; size <= most; ++size) {
    // Only where the text behind it goes on can a longer part do better.
    const std::string_view behind = rest.substr(size);
    if (!last && pieces_[index + 1].kind == Piece::kText &&
        !behind.starts_with(pieces_[index + 1].text))
      continue;
    std::string before;
    const bool named = piece.kind != Piece::kStar;
    bool added = false;
    if (named) {
      const auto [found, fresh] = values.try_emplace(piece.text, rest.substr(0, size));
      added = fresh;
      if (!fresh && found->second != rest.substr(0, size)) continue;
    }
    if (match_from(index + 1, behind, values)) return true;
    if (added) values.erase(piece.text);
  }
  return false;
}

std::optional<Values> FilePattern::match(std::string_view path) const {
  Values values;
  if (path.size() > kLongestPath || !match_from(0, path, values)) return std::nullopt;
  return values;
}

Result<std::string> fill_in(std::string_view text, const Values& values) {
  std::string filled;
  for (std::size_t at = 0; at < text.size();) {
    const std::size_t open = std::min(text.find('{', at), text.size());
    filled += text.substr(at, open - at);
    if (open == text.size()) break;
    const std::size_t close = text.find('}', open);
    if (close == std::string_view::npos)
      return Failure{fmt::format("\"{}\": {{ without }}", shown(text))};
    const std::string name(text.substr(open + 1, close - open - 1));
    const auto found = values.find(name);
    if (found == values.end()) {
      std::vector<std::string> names;
      for (const auto& [known, value] : values) names.push_back(known);
      return Failure{fmt::format("\"{}\": no value {{{}}}, there are {}", shown(text), shown(name),
                                 fmt::join(names, ", "))};
    }
    filled += found->second;
    at = close + 1;
  }
  return filled;
}

Result<std::vector<double>> parse_numbers(std::string_view text, std::size_t count) {
  std::vector<double> numbers;
  std::string_view rest = text;
  while (true) {
    rest.remove_prefix(std::min(rest.find_first_not_of(" ,\t\r\n"), rest.size()));
    if (rest.empty()) break;
    const std::string_view word = rest.substr(0, rest.find_first_of(" ,\t\r\n"));
    rest.remove_prefix(word.size());
    const auto value = parse_number(word);
    if (!value || !std::isfinite(*value))
      return Failure{fmt::format("\"{}\" is no finite number", shown(word))};
    numbers.push_back(*value);
  }
  if (numbers.size() != count)
    return Failure{
        fmt::format("\"{}\": {} numbers, needed {}", shown(text), numbers.size(), count)};
  return numbers;
}

}  // namespace omentum

#pragma once

#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/result.h"

namespace omentum {

/// Named texts: parts of file names, values read from headers.
using Values = std::map<std::string, std::string>;

/// A path with named parts: "lift_{fabric:letters}{repeat:digits}.npy" (proto/import_map.proto).
class FilePattern {
 public:
  /// Fails with one line: a brace without its partner, a kind of part that there is not, more than
  /// 20 parts.
  static Result<FilePattern> parse(std::string_view pattern);
  /// Parts of a path that fits; of several ways the one with the shortest first parts. A part that
  /// stands twice must be the same text.
  std::optional<Values> match(std::string_view path) const;
  /// Names of the parts, in order.
  std::vector<std::string> names() const;

 private:
  struct Piece {
    enum Kind { kText, kAny, kLetters, kDigits, kCount, kStar };
    Kind kind = kText;
    std::string text;  ///< or the name
    std::size_t count = 0;
  };
  bool match_from(std::size_t piece, std::string_view rest, Values& values) const;
  std::vector<Piece> pieces_;
};

/// Puts values in the place of {name}; fails naming one that there is not and those there are.
Result<std::string> fill_in(std::string_view text, const Values& values);

/// Numbers of a text, separated by blanks or commas; fails where there are not `count`.
Result<std::vector<double>> parse_numbers(std::string_view text, std::size_t count);

}  // namespace omentum

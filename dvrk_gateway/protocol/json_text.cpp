#include "dvrk_gateway/protocol/json_text.h"

#include <charconv>
#include <cmath>
#include <limits>

namespace omentum {
namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }

std::size_t digits(std::string_view text, std::size_t from) {
  std::size_t end = from;
  while (end < text.size() && is_digit(text[end])) ++end;
  return end - from;
}

/// Length of the number by the grammar of JSON that text begins with; 0 if there is none.
std::size_t number_length(std::string_view text) {
  std::size_t at = !text.empty() && text[0] == '-' ? 1 : 0;
  const std::size_t whole = digits(text, at);
  if (whole == 0 || (whole > 1 && text[at] == '0')) return 0;
  at += whole;
  if (at < text.size() && text[at] == '.') {
    const std::size_t fraction = digits(text, at + 1);
    if (fraction == 0) return 0;
    at += 1 + fraction;
  }
  if (at < text.size() && (text[at] == 'e' || text[at] == 'E')) {
    std::size_t exponent = at + 1;
    if (exponent < text.size() && (text[exponent] == '+' || text[exponent] == '-')) ++exponent;
    if (digits(text, exponent) == 0) return 0;
    at = exponent + digits(text, exponent);
  }
  return at;
}

}  // namespace

void JsonText::Word::put(char c) {
  if (size == kLongestWord) {
    cut = true;
    return;
  }
  characters[size++] = c >= ' ' && c <= '~' && c != '"' && c != '\\' ? c : '?';
}

bool JsonText::refuse() {
  ok_ = false;
  return false;
}

void JsonText::blanks() {
  const std::size_t at = rest_.find_first_not_of(" \t\r\n");
  rest_.remove_prefix(at == std::string_view::npos ? rest_.size() : at);
}

bool JsonText::ends() {
  blanks();
  return ok_ && rest_.empty();
}

bool JsonText::take(char c) {
  blanks();
  if (!ok_ || rest_.empty() || rest_[0] != c) return false;
  rest_.remove_prefix(1);
  return true;
}

bool JsonText::take_word(std::string_view literal) {
  blanks();
  if (!ok_ || !rest_.starts_with(literal)) return false;
  rest_.remove_prefix(literal.size());
  return true;
}

bool JsonText::open(char c) {
  if (!take(c) || depth_ == kDeepest) return refuse();
  ++depth_;
  return true;
}

/// Whether a further member begins; false at the end, which is taken, and at an error.
bool JsonText::next(char close, bool first) {
  if (take(close)) {
    --depth_;
    return false;
  }
  if (!first && !take(',')) return refuse();
  return ok_;
}

bool JsonText::escape(Word& value) {
  if (rest_.empty()) return refuse();
  const char c = rest_[0];
  rest_.remove_prefix(1);
  if (c == 'u') {
    unsigned code = 0;
    if (rest_.size() < 4) return refuse();
    const auto [end, error] = std::from_chars(rest_.data(), rest_.data() + 4, code, 16);
    if (error != std::errc() || end != rest_.data() + 4) return refuse();
    rest_.remove_prefix(4);
    value.put(code < 128 ? static_cast<char>(code) : '?');
    return true;
  }
  constexpr std::string_view kEscapes = "\"\\/bfnrt";
  if (kEscapes.find(c) == std::string_view::npos) return refuse();
  value.put(c == '/' ? c : '?');
  return true;
}

bool JsonText::word(Word& value) {
  value = {};
  if (!take('"')) return refuse();
  while (!rest_.empty()) {
    const char c = rest_[0];
    rest_.remove_prefix(1);
    if (c == '"') return true;
    if (static_cast<unsigned char>(c) < ' ') return refuse();
    if (c != '\\') {
      value.put(c);
    } else if (!escape(value)) {
      return false;
    }
  }
  return refuse();
}

bool JsonText::boolean(bool& value) {
  value = take_word("true");
  return value || take_word("false") || refuse();
}

bool JsonText::null() { return take_word("null"); }

bool JsonText::number(double& value) {
  value = std::numeric_limits<double>::quiet_NaN();
  if (null()) return true;
  const std::size_t length = ok_ ? number_length(rest_) : 0;
  if (length == 0) return refuse();
  double read = 0;
  const auto [end, error] = std::from_chars(rest_.data(), rest_.data() + length, read);
  rest_.remove_prefix(length);
  if (error == std::errc() && std::isfinite(read)) value = read;
  return true;
}

bool JsonText::skip() {
  blanks();
  if (!ok_ || rest_.empty()) return refuse();
  Word word_unused;
  bool flag = false;
  double value = 0;
  switch (rest_[0]) {
    case '{':
      return object([this](std::string_view) { skip(); });
    case '[':
      return array([this] { skip(); });
    case '"':
      return word(word_unused);
    case 't':
    case 'f':
      return boolean(flag);
    default:
      return number(value);
  }
}

}  // namespace omentum

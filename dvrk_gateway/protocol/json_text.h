#pragma once

#include <array>
#include <string_view>

namespace omentum {

/// Walks through JSON text from front to back and needs no memory but itself: no allocation, no
/// exception, total over any bytes (decision 0027). The first thing that is not JSON, not what was
/// asked for, or nested deeper than kDeepest ends the walk: ok() is false from then on, every
/// further question answers false, and what was read before stays read. Not thread-safe.
class JsonText {
 public:
  /// The datagrams of the robot need 5.
  static constexpr int kDeepest = 8;
  /// Longest key or string that is told apart; of a longer one the rest is dropped.
  static constexpr std::size_t kLongestWord = 63;

  explicit JsonText(std::string_view text) : rest_(text) {}
  bool ok() const { return ok_; }
  /// Ends the walk for a reason of the caller's; answers false.
  bool refuse();
  /// Whether all of the text was one value and the blanks around it.
  bool ends();

  /// The object that begins here: member(key) is called for every one of its members and must take
  /// or skip the value. The key is gone when member returns. False where no object was read.
  template <typename Member>
  bool object(Member&& member) {
    if (!open('{')) return false;
    for (bool first = true; next('}', first); first = false) {
      Word key;
      if (!word(key) || !take(':')) return refuse();
      member(key.text());
    }
    return ok_;
  }
  /// The array that begins here: element() is called where each one begins.
  template <typename Element>
  bool array(Element&& element) {
    if (!open('[')) return false;
    for (bool first = true; next(']', first); first = false) element();
    return ok_;
  }

  /// A string. What is not printable ASCII becomes '?', as do quotes and backslashes, so that a
  /// word may stand in any log and go back into JSON as it is.
  struct Word {
    std::array<char, kLongestWord + 1> characters{};  ///< ends with 0
    std::size_t size = 0;
    bool cut = false;  ///< it was longer
    std::string_view text() const { return {characters.data(), size}; }
    void put(char c);
  };
  bool word(Word& value);
  bool boolean(bool& value);
  /// A number, or null, which is how the robot writes one that is not finite; then, and for one
  /// beyond the range of a double, `value` is NaN.
  bool number(double& value);
  /// Whether null stands here; if so it is taken.
  bool null();
  /// Any value.
  bool skip();

 private:
  void blanks();
  bool take(char c);
  bool take_word(std::string_view literal);
  bool open(char c);
  bool next(char close, bool first);
  bool escape(Word& value);

  std::string_view rest_;
  int depth_ = 0;
  bool ok_ = true;
};

}  // namespace omentum

#pragma once

#include <cstdint>
#include <functional>

namespace omentum {

/// How long the threads of this process have waited for a core, all together; 0 where the kernel
/// does not tell.
std::int64_t waited_for_core_ns();

/// When a participant that seems to be deaf is made anew. Reliable topics can be parted for good by
/// datagrams that anybody can forge (docs/trust.md 2); participants that have just met are not
/// parted. The caller knows whom it should hear; this knows how long that must have lasted, and
/// what only looks like deafness: discovery in progress and a busy machine.
///
/// For one thread. Times are of one steady clock [ns], above 0.
class Deafness {
 public:
  /// What is around a participant, and how its process does.
  struct Around {
    std::uint64_t found = 0;  ///< participants, writers, readers so far; who came back counts twice
    std::uint64_t known = 0;  ///< of them, there now
    std::int64_t waited_for_core_ns = 0;  ///< by the threads of this process, all together
  };

  /// `id` of this process: others have other ones, so that they do not all join anew at one moment.
  explicit Deafness(std::uint32_t id) : id_(id) {}

  /// A participant was made.
  void joined(std::int64_t now_ns);
  /// Somebody was heard whom it is there to hear.
  void heard(std::int64_t now_ns) { heard_ns_ = now_ns; }
  /// It is about to be made anew because it is deaf: the next time is twice as late.
  void gives_up() { ++rejoins_in_vain_; }
  /// It is neither deaf nor unheard: the next time is not late any more.
  void helped() { rejoins_in_vain_ = 0; }

  /// To be called some times a second; asks `look` twice a second at most. `late_ns`: the calling
  /// thread was woken so much later than it wanted.
  void watch(std::int64_t now_ns, std::int64_t late_ns, const std::function<Around()>& look);

  /// It has taken part for long enough, and nothing is going on that looks like deafness.
  bool may_join_anew(std::int64_t now_ns) const;
  /// Who is there was not heard since that moment: so long that it should have been.
  bool is_too_long(std::int64_t since_ns, std::int64_t now_ns) const;

  std::int64_t joined_ns() const { return joined_ns_; }
  std::int64_t heard_ns() const { return heard_ns_; }  ///< last; 0 = never

 private:
  std::int64_t spread_ns(std::int64_t per_known_ns) const;
  std::int64_t pause_ns(std::int64_t now_ns) const;
  bool is_quiet(std::int64_t now_ns) const;

  std::uint32_t id_;
  std::uint32_t rejoins_in_vain_ = 0;
  std::int64_t joined_ns_ = 0;
  std::int64_t heard_ns_ = 0;
  Around around_;
  std::int64_t looked_ns_ = 0;
  std::int64_t disturbed_ns_ = 0;       ///< discovery found more, or this process was kept waiting
  std::int64_t unsettled_from_ns_ = 0;  ///< since then it was never quiet
};

}  // namespace omentum

#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>

#include "core/dds_discovery.h"
#include "core/dds_options.h"
#include "core/deafness.h"

namespace CLI {  // NOLINT(readability-identifier-naming): the library's name
class App;
}

namespace omentum {

/// The gateway's place on the bus, as its command line tells it (docs/dvrk.md 10).
struct BusOptions {
  std::string run;           ///< empty: no DDS at all
  std::uint32_t domain = 0;  ///< 0 ... 230
  DdsOptions dds;
  std::string arm = "PSM1";  ///< name of the arm in CRTK's topics
  bool ros = false;          ///< also as ROS 2 reads it
};

/// Adds --run, --domain, --arm, --ros and the network options.
void add_bus_options(CLI::App& app, BusOptions& options);
/// Throws Error: one line, for options that need --run or that are no names.
void check_bus_options(const BusOptions& options);

/// What is made from the gateway's participant, and made again from the next one.
class BusMember {
 public:
  BusMember() = default;
  virtual ~BusMember() = default;
  BusMember(const BusMember&) = delete;
  BusMember& operator=(const BusMember&) = delete;

  /// All that is made from the participant goes.
  virtual void leave() = 0;
  /// Makes it again; `participant` outlives it, or leave() comes first. Throws Error.
  virtual void join(const dds::Participant& participant) = 0;
};

/// The gateway's participant, which is made anew where it is deaf (docs/trust.md 2). One thread at
/// a time.
class GatewayBus {
 public:
  /// Joins the domain. Throws Error.
  GatewayBus(std::uint32_t domain, DdsProfile profile);

  /// Precondition: the last join_anew() did not fail.
  const dds::Participant& participant() const { return *participant_; }

  /// Where somebody waits for the bus: some times a second, as Deafness::watch().
  void watch(std::int64_t now_ns, std::int64_t late_ns);
  /// A learner is there, and none of the run has been heard since `heard_ns` (0: never) for too
  /// long; or, where one `lacks` what it publishes, for too long since the domain was joined.
  bool is_deaf(std::int64_t heard_ns, bool lacks, std::int64_t now_ns);
  /// Makes the participant anew, and what all members make from it: nothing else may be made from
  /// it. Takes up to some seconds, and is not for while an arm is armed. The threads of the
  /// middleware are ordinary ones also where the calling thread is not. After a failure none of the
  /// members is on the bus, and it is deaf until a later call succeeds.
  Result<void> join_anew(std::span<BusMember* const> members);

 private:
  void make_participant();

  std::uint32_t domain_;
  DdsProfile profile_;
  std::unique_ptr<dds::Participant> participant_;
  std::optional<dds::Discovery> discovery_;  // after it
  Deafness deaf_;
  std::int64_t asked_ns_ = 0;  ///< whether it is deaf, and looked for a learner
};

/// Joins the run's domain, waiting for names of hosts as learner and workers do. Null without
/// --run, and when `stop` became true meanwhile. Throws Error.
std::unique_ptr<GatewayBus> join_bus(const BusOptions& options, const std::function<bool()>& stop);

}  // namespace omentum

#include <dds/dds.h>
#include <dds/ddsi/ddsi_cdrstream.h>
#include <dds/ddsi/ddsi_serdata_default.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <nlohmann/json.hpp>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "core/config.h"
#include "core/wire.h"
#include "core/wire_fields.h"
#include "monitor/bus_messages.h"
#include "monitor/frame_desk.h"
#include "monitor/metrics.h"
#include "monitor/run_state.h"
#include "monitor/top.h"
#include "monitor/web_page.h"

// What may arrive on any topic, from the bytes of a sample on: Cyclone's own check and reading of
// them, ours, and then what the tools make of a record (table, figures, page, recording). A record
// is refused with a reason or shown; what is shown is well-formed whatever the texts in it.
// Bytes: records one after the other, each topic, byte order, length (2 bytes), data (XCDR2).
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size);

namespace {

using namespace omentum;  // NOLINT(google-build-using-namespace)

constexpr std::int64_t kNow = 1'000'000'000'000;

void require(bool good) {
  if (!good) __builtin_trap();
}

/// A sample of the generated type, read as Cyclone 0.10.2 reads one from the network.
template <typename Record>
class Sample {
  using Generated = typename Wire<Record>::Generated;

 public:
  explicit Sample(std::span<const std::uint8_t> bytes, bool swapped) {
    // In words of 8 bytes for alignment; 3 bytes of padding, as a serialised sample ends with.
    std::vector<std::uint64_t> words((bytes.size() + 3) / 8 + 1);
    auto* buffer = reinterpret_cast<std::uint8_t*>(words.data());
    std::copy(bytes.begin(), bytes.end(), buffer);
    std::uint32_t used = 0;
    good_ = dds_stream_normalize(buffer, static_cast<std::uint32_t>(bytes.size()), swapped,
                                 CDR_ENC_VERSION_2, &type(), false, &used);
    if (!good_) return;
    dds_istream_t stream;
    dds_istream_init(&stream, used, buffer, CDR_ENC_VERSION_2);
    dds_stream_read_sample(&stream, &sample_, &type());
  }
  ~Sample() {
    if (good_) dds_stream_free_sample(&sample_, type().type.ops.ops);
  }
  Sample(const Sample&) = delete;
  Sample& operator=(const Sample&) = delete;

  bool good() const { return good_; }
  const void* get() const { return &sample_; }

 private:
  // As ddsi_sertype_default_init() makes it from a descriptor.
  static const ddsi_sertype_default& type() {
    static std::vector<ddsi_sertype_default_desc_key_t> keys;
    static const ddsi_sertype_default made = [] {
      const dds_topic_descriptor_t& about = Wire<Record>::kDescriptor;
      for (std::uint32_t i = 0; i < about.m_nkeys; ++i)
        keys.push_back({about.m_keys[i].m_offset, about.m_keys[i].m_idx});
      ddsi_sertype_default result{};
      result.type.size = about.m_size;
      result.type.align = about.m_align;
      result.type.flagset = about.m_flagset;
      result.type.keys = {about.m_nkeys, keys.data()};
      result.type.ops = {dds_stream_countops(about.m_ops, about.m_nkeys, about.m_keys),
                         const_cast<std::uint32_t*>(about.m_ops)};
      return result;
    }();
    return made;
  }

  Generated sample_{};
  bool good_ = false;
};

/// The view of preset omentum, for frames.
const LiveScene& scene() {
  static const LiveScene made = [] {
    RunManifest manifest;
    manifest.config_text = load_config("omentum", {}).DebugString();
    LiveScene result = make_live_scene(manifest);
    require(result.skin != nullptr);
    return result;
  }();
  return made;
}

/// One tool.
struct Tool {
  RunState state{"fuzz"};
  FrameDesk desk;
  std::vector<std::uint32_t> slots;

  void show() {
    const std::string table = make_top_table(state, kNow);
    require(std::all_of(table.begin(), table.end(), [](char c) {
      const auto code = static_cast<unsigned char>(c);
      return c == '\n' || (code >= 32 && code != 127);
    }));
    make_metrics(state, kNow);
    for (const std::string& text : {make_state_json(state, scene(), kNow), make_curves_json(state)})
      require(nlohmann::json::accept(text) && text.find("<script") == std::string::npos);
    for (const std::uint32_t slot : slots) {
      const auto newest = desk.newest(slot);
      if (!newest) continue;
      const std::string text = make_frame_json(*newest, scene());
      require(text.empty() || nlohmann::json::accept(text));
    }
    desk.due(kNow);
  }
};

template <typename Record>
void feed(Tool& tool, std::span<const std::uint8_t> bytes, bool swapped) {
  const Sample<Record> sample(bytes, swapped);
  if (!sample.good()) return;
  Arrival<Record> arrival{{}, {.valid = true}};
  if (const auto refusal = read_sample(sample.get(), arrival.record))
    return require(!refusal->empty());
  if constexpr (requires { to_message(arrival.record); }) {
    const auto message = to_message(arrival.record);
    std::remove_const_t<decltype(message)> again;
    require(again.ParseFromString(message.SerializeAsString()));
  }
  if constexpr (requires { tool.state.apply(std::move(arrival), kNow); }) {
    tool.state.apply(std::move(arrival), kNow);
  } else if constexpr (std::is_same_v<Record, SimFrame>) {
    tool.slots.push_back(arrival.record.slot);
    tool.desk.look(arrival.record.slot, 10, kNow);
    tool.desk.put(std::move(arrival.record), kNow);
  }
}

using Feed = void (*)(Tool&, std::span<const std::uint8_t>, bool);
constexpr std::array<Feed, 13> kFeeds = {
    feed<PolicyWeights>, feed<RolloutTask>,    feed<RolloutSegment>, feed<WorkerStatus>,
    feed<LearnerStatus>, feed<EpisodeSummary>, feed<RunManifest>,    feed<ControlCommand>,
    feed<ControlReply>,  feed<SimFrame>,       feed<RobotStatus>,    feed<SimulationGrant>,
    feed<SimulationPart>};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  Tool tool;
  std::span<const std::uint8_t> rest(data, size);
  while (rest.size() >= 4) {
    const std::size_t length = std::min<std::size_t>(rest[2] + 256U * rest[3], rest.size() - 4);
    kFeeds[rest[0] % kFeeds.size()](tool, rest.subspan(4, length), rest[1] % 2 != 0);
    rest = rest.subspan(4 + length);
  }
  tool.show();
  return 0;
}

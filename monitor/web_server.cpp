#include "monitor/web_server.h"

#include <fmt/core.h>
#include <httplib.h>

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdio>
#include <mutex>
#include <optional>
#include <thread>

#include "core/clock.h"
#include "core/csv.h"
#include "core/log.h"
#include "monitor/control.h"
#include "monitor/frame_desk.h"
#include "monitor/metrics.h"
#include "monitor/run_watch.h"
#include "monitor/web_connections.h"
#include "monitor/web_page.h"

namespace omentum {
namespace {

constexpr auto kFrameWait = std::chrono::milliseconds(1000);
constexpr std::int64_t kLookNs = 100'000'000;  // a signal does not wake the wait set
constexpr const char* kHtml = "text/html; charset=utf-8";
constexpr const char* kJson = "application/json";
constexpr const char* kText = "text/plain; charset=utf-8";

/// What the bus thread writes and the threads of requests read.
class Board {
 public:
  explicit Board(const std::string& run) : state_(run) {}

  /// With the state and the frames locked.
  template <typename Fn>
  auto with(Fn&& fn) {
    const std::lock_guard lock(mutex_);
    return fn(state_, frames_);
  }
  std::shared_ptr<const LiveScene> scene() {
    const std::lock_guard lock(mutex_);
    return scene_;
  }
  void set_scene(std::shared_ptr<const LiveScene> scene) {
    const std::lock_guard lock(mutex_);
    scene_ = std::move(scene);
  }
  void tell_of_frames() { new_frame_.notify_all(); }
  /// Ends the waits of all requests.
  void close() {
    const std::lock_guard lock(mutex_);
    closed_ = true;
    new_frame_.notify_all();
  }
  /// A frame of the slot with a higher number, waiting for it a while; null without one. Nothing
  /// when too many slots are looked at.
  std::optional<std::shared_ptr<const NumberedFrame>> next_frame(std::uint32_t slot, float hz,
                                                                 std::uint64_t after) {
    std::unique_lock lock(mutex_);
    if (!frames_.look(slot, hz, steady_now_ns())) return std::nullopt;
    std::shared_ptr<const NumberedFrame> frame;
    new_frame_.wait_for(lock, kFrameWait, [&] {
      frame = frames_.newest(slot);
      if (frame && frame->number <= after) frame = nullptr;
      return frame != nullptr || closed_;
    });
    return frame;
  }

 private:
  std::mutex mutex_;
  RunState state_;                                                          // guarded by mutex_
  FrameDesk frames_;                                                        // guarded by mutex_
  std::shared_ptr<const LiveScene> scene_ = std::make_shared<LiveScene>();  // guarded by mutex_
  bool closed_ = false;                                                     // guarded by mutex_
  std::condition_variable new_frame_;
};

void refuse(httplib::Response& response, int status, const std::string& reason) {
  response.status = status;
  response.set_content(reason + "\n", kText);
}

/// Only what is listed is asked for, and the parameters are those of the path.
httplib::Server::HandlerResponse check_request(const httplib::Request& request,
                                               httplib::Response& response) {
  using Response = httplib::Server::HandlerResponse;
  if (request.method != "GET" && request.method != "HEAD") {
    response.set_header("Allow", "GET, HEAD");
    refuse(response, 405, "this page only looks: GET or HEAD");
    return Response::Handled;
  }
  if (request.path != "/frame" && !request.params.empty()) {
    refuse(response, 400, request.path + " has no parameters");
    return Response::Handled;
  }
  return Response::Unhandled;
}

struct FrameRequest {
  std::uint32_t slot = 0;
  float hz = 10;
  std::uint64_t after = 0;
};

Result<FrameRequest> parse_frame_request(const httplib::Request& request, std::uint32_t slots) {
  FrameRequest wanted;
  bool has_slot = false;
  for (const auto& [name, text] : request.params) {
    if (request.params.count(name) > 1) return Failure{name + ": given twice"};
    if (name != "slot" && name != "hz" && name != "after")
      return Failure{"parameters are slot, hz and after"};
    const std::uint64_t max = name == "slot" ? std::max(slots, 1U) - 1
                              : name == "hz" ? static_cast<std::uint64_t>(kMaxFramesHz)
                                             : std::uint64_t{1} << 53;  // exact in a browser
    const Result<std::uint64_t> value = parse_parameter(name, text, max);
    if (!value) return Failure{value.error()};
    if (name == "slot") {
      wanted.slot = static_cast<std::uint32_t>(value.value());
      has_slot = true;
    } else if (name == "hz") {
      wanted.hz = static_cast<float>(value.value());
    } else {
      wanted.after = value.value();
    }
  }
  if (!has_slot) return Failure{"slot: missing"};
  if (!(wanted.hz > 0)) return Failure{"hz: 0, allowed 1 ... 50"};
  return wanted;
}

void serve_frame(Board& board, const httplib::Request& request, httplib::Response& response) {
  const std::uint32_t slots = board.with(
      [](RunState& state, FrameDesk&) { return state.manifest() ? state.manifest()->slots : 0; });
  const Result<FrameRequest> wanted = parse_frame_request(request, slots);
  if (!wanted) return refuse(response, 400, wanted.error());
  if (slots == 0) return refuse(response, 404, "no learner has told how many slots there are");
  const auto [slot, hz, after] = wanted.value();
  const auto frame = board.next_frame(slot, hz, after);
  if (!frame) {
    return refuse(response, 429, fmt::format("{} other slots are looked at", FrameDesk::kMaxSlots));
  }
  const std::string json = *frame ? make_frame_json(**frame, *board.scene()) : "";
  if (json.empty()) {
    response.status = 204;
  } else {
    response.set_content(json, kJson);
  }
}

void add_routes(httplib::Server& server, Board& board) {
  server.set_tcp_nodelay(true);
  // The library's own choice would let a second process listen on the same port.
  server.set_socket_options([](socket_t socket) {
    const int yes = 1;
    setsockopt(socket, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
  });
  server.set_payload_max_length(1024);  // nothing that is sent here has a body
  server.set_default_headers(
      {{"X-Content-Type-Options", "nosniff"},
       {"Cache-Control", "no-store"},
       {"Content-Security-Policy",
        "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; connect-src "
        "'self'; img-src data:; frame-ancestors 'none'"}});
  server.set_pre_routing_handler(check_request);
  server.Get("/", [&board](const httplib::Request&, httplib::Response& response) {
    const std::string run = board.with([](RunState& state, FrameDesk&) { return state.run(); });
    response.set_content(make_monitor_page(run, *board.scene()), kHtml);
  });
  server.Get("/state", [&board](const httplib::Request&, httplib::Response& response) {
    const auto scene = board.scene();
    response.set_content(board.with([&](RunState& state, FrameDesk&) {
      return make_state_json(state, *scene, steady_now_ns());
    }),
                         kJson);
  });
  server.Get("/curves", [&board](const httplib::Request&, httplib::Response& response) {
    response.set_content(
        board.with([](RunState& state, FrameDesk&) { return make_curves_json(state); }), kJson);
  });
  server.Get("/metrics", [&board](const httplib::Request&, httplib::Response& response) {
    response.set_content(board.with([](RunState& state, FrameDesk&) {
      return make_metrics(state, steady_now_ns());
    }),
                         "text/plain; version=0.0.4; charset=utf-8");
  });
  server.Get("/frame", [&board](const httplib::Request& request, httplib::Response& response) {
    serve_frame(board, request, response);
  });
}

/// Asks the learner for frames; nothing where this role may not (docs/monitor.md 2).
std::unique_ptr<Operator> make_operator(const dds::Participant& participant,
                                        const std::string& run) {
  try {
    return std::make_unique<Operator>(participant, run, "omentum monitor");
  } catch (const Error& error) {
    log().warn("event=no_live_frames reason=\"{}\"", error.what());
    return nullptr;
  }
}

void send_all(Operator* to, const std::vector<ControlCommand>& commands) {
  for (const ControlCommand& command : commands) {
    if (to == nullptr) return;
    if (const auto sent = to->send(command); !sent)
      log().warn("event=not_sent reason=\"{}\"", sent.error());
  }
}

void follow_manifest(Board& board) {
  const std::shared_ptr<const LiveScene> scene = board.scene();
  const bool known = !scene->markup.empty() || !scene->problem.empty();
  const auto changed = board.with([&](RunState& state, FrameDesk&) -> std::optional<RunManifest> {
    const std::optional<RunManifest>& now = state.manifest();
    if (!now || (known && now->config_hash == scene->config_hash)) return std::nullopt;
    return now;
  });
  if (!changed) return;
  auto made = std::make_shared<LiveScene>(make_live_scene(*changed));
  if (!made->problem.empty()) log().warn("event=no_3d_view reason=\"{}\"", made->problem);
  board.set_scene(std::move(made));
}

}  // namespace

Result<std::uint64_t> parse_parameter(const std::string& name, const std::string& text,
                                      std::uint64_t max) {
  const bool digits =
      !text.empty() && text.size() <= 19 &&
      std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
  const std::uint64_t value = digits ? std::stoull(text) : 0;
  if (!digits || value > max)
    return Failure{fmt::format("{}: not a number of 0 ... {}", name, max)};
  return value;
}

int run_monitor(const MonitorOptions& options) {
  catch_stop_signals();
  Board board(options.tool.run);
  BoundedServer server{BoundedServer::Limits()};
  add_routes(server, board);
  const std::string address = plain_address(options.address);
  // Before the bus: a port that is taken is told at once.
  const int port = options.port != 0 ? options.port : server.bind_to_any_port(address);
  if (port <= 0 || (options.port != 0 && !server.bind_to_port(address, port))) {
    throw_error("--address {} --port {}: cannot listen there; choose another port, or 0 for any",
                options.address, options.port);
  }
  RunLink link(options.tool, "omentum-monitor", true);
  if (!link.join()) return 0;
  std::unique_ptr<Operator> to_learner = make_operator(link.participant(), options.tool.run);
  std::atomic<bool> listened = false;
  std::jthread listening([&server, &listened] {
    server.listen_after_bind();
    listened = true;
  });
  fmt::print("http://{}:{}/ shows run {} of domain {}\n", address_in_url(address), port,
             options.tool.run, options.tool.domain);
  std::fflush(stdout);
  while (!stop_requested()) {
    const auto deaf = board.with(
        [&](RunState& state, FrameDesk&) { return link.is_deaf(state, steady_now_ns()); });
    if (deaf) {
      to_learner.reset();
      link.leave();
      if (!link.join()) break;
      to_learner = make_operator(link.participant(), options.tool.run);
    }
    link.watch().wait(kLookNs);
    send_all(to_learner.get(), board.with([&](RunState& state, FrameDesk& frames) {
      link.watch().take_into(state, [&frames, &board](SimFrame&& frame) {
        frames.put(std::move(frame), steady_now_ns());
        board.tell_of_frames();
      });
      return frames.due(steady_now_ns());
    }));
    follow_manifest(board);
  }
  send_all(to_learner.get(),
           board.with([](RunState&, FrameDesk& frames) { return frames.all_off(); }));
  board.close();
  // stop() does nothing before the thread listens, and then the thread would never end.
  while (!server.is_running() && !listened) std::this_thread::yield();
  server.stop();
  return 0;
}

}  // namespace omentum

#include "monitor/web_script.h"

namespace omentum {
namespace {

constexpr const char* kScript = R"js("use strict";
(function () {
  const get = (id) => document.getElementById(id);
  const seen = document.documentElement.dataset;
  const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
  let scene = null, slots = 0, watched = null;

  async function ask(address) {
    const reply = await fetch(address, { cache: "no-store" });
    if (!reply.ok) throw new Error(await reply.text());
    return reply.status === 204 ? null : reply.json();
  }
  function fill(markup) {
    for (const [id, text] of Object.entries(markup)) get(id).innerHTML = text;
  }
  async function repeat(period_ms, act) {
    for (;;) {
      try {
        await act();
        get("link").textContent = "";
      } catch (error) {
        get("link").textContent = "The monitor does not answer; what you see is old.";
      }
      await sleep(period_ms);
    }
  }
  repeat(1000, async () => {
    const state = await ask("state");
    if (scene !== null && state.scene !== scene) location.reload();  // another scene, another page
    scene = state.scene;
    slots = state.slots;
    fill(state.markup);
    if (get("slot")) get("slot").max = Math.max(0, slots - 1);
    seen.updates = Number(seen.updates || 0) + 1;
  });
  repeat(3000, async () => {
    const curves = await ask("curves");
    if (seen.firstSteps === undefined && curves.steps > 0) seen.firstSteps = curves.steps;
    seen.steps = curves.steps;
    fill(curves.markup);
  });

  // ---- 3-D view: one request at a time, answered when there is a newer frame -------------------------------------
  function show(frame) {
    const raw = atob(frame.positions), bytes = new Uint8Array(raw.length);
    for (let k = 0; k < raw.length; ++k) bytes[k] = raw.charCodeAt(k);
    window.show_frame({ positions: new Float32Array(bytes.buffer), tools: new Float32Array(frame.tool),
                        held: [frame.held], note: frame.note });
    seen.frames = Number(seen.frames || 0) + 1;
    if (Number(seen.frames) > 8) return;  // pictures are compared for the first second only
    const picture = document.querySelector(".pane canvas").toDataURL();
    if (show.picture !== undefined && show.picture !== picture) seen.moved = "true";
    show.picture = picture;
  }
  async function watch(slot, hz) {
    const mine = { slot };
    watched = mine;
    let after = 0;
    while (watched === mine) {
      try {
        const frame = await ask(`frame?slot=${slot}&hz=${hz}&after=${after}`);
        if (watched !== mine) return;
        get("watching").textContent = frame ? "" : "waiting for frames of slot " + slot;
        if (frame) {
          after = frame.number;
          show(frame);
        }
        await sleep(1000 / hz / 2);
      } catch (error) {
        get("watching").textContent = error.message;
        await sleep(2000);
      }
    }
  }
  if (!get("watch")) return;
  get("watch").addEventListener("click", () => {
    const stop = watched !== null;
    get("watch").textContent = stop ? "Watch" : "Stop";
    if (stop) {
      watched = null;
    } else {
      watch(Number(get("slot").value), Number(get("hz").value));
    }
  });
  const chosen = /^#slot=(\d+)$/.exec(location.hash);
  if (chosen) {
    get("slot").value = chosen[1];
    get("watch").click();
  }
})();
)js";

}  // namespace

std::string monitor_script() { return kScript; }

}  // namespace omentum

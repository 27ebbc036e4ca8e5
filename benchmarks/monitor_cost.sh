#!/usr/bin/env bash
# Share of a core that `omentum monitor` takes beside 20 workers while a page shows one slot, asked for HZ times a second.
# Usage: monitor_cost.sh [SECONDS [HZ]]; goal: 3 % at 10 frames/s. For benchmarks/run.sh monitor (docs/monitor.md 2).
# Fewer frames come than are asked for: a slot stands still while the learner learns and while others have the cores.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../build/release/bin}
seconds=${1:-30} hz=${2:-25}
folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT
domain=$((1 + $$ % 90)) port=$((20000 + $$ % 10000))
for _ in {1..20}; do
  "$bin/sim_worker" --run cost --domain $domain --lanes 8 2>/dev/null &
done
"$bin/learner" --run cost --quiet --set run.domain=$domain --set "run.runs_dir=$folder" --set rollout.slots=160 \
  --set rollout.max_steps=2000000000 2>"$folder/learner.err" &
"$bin/omentum" monitor --run cost --domain $domain --port $port >/dev/null &
monitor=$!
url=http://127.0.0.1:$port
until curl -sf "$url/frame?slot=3&hz=$hz" | grep -q positions; do sleep 0.2; done
# What the page asks for.
(while curl -sf "$url/state" -o /dev/null; do sleep 1; done) &
(while curl -sf "$url/curves" -o /dev/null; do sleep 3; done) &
python3 - "$port" "$hz" >"$folder/frames" <<'PY' &
import http.client, json, sys, time
link, after, count = http.client.HTTPConnection("127.0.0.1", int(sys.argv[1])), 0, 0
while True:
    link.request("GET", f"/frame?slot=3&hz={sys.argv[2]}&after={after}")
    reply = link.getresponse()
    body = reply.read()
    if reply.status == 200:
        after, count = json.loads(body)["number"], count + 1
        print(count, flush=True)
    time.sleep(0.02)
PY
ticks() { awk '{ print $14 + $15 }' /proc/$monitor/stat; }
sleep 3
first=$(ticks) frames=$(wc -l <"$folder/frames")
sleep "$seconds"
last=$(ticks)
awk -v t=$((last - first)) -v hz="$(getconf CLK_TCK)" -v s="$seconds" -v f=$(($(wc -l <"$folder/frames") - frames)) \
  'BEGIN { printf "monitor.core_share %.4f\nmonitor.frames_per_s %.1f\n", t / hz / s, f / s }'

#!/usr/bin/env bash
# A participant of another DDS library forges segments, weights and tasks during a training: nothing of it counts.
# Needs the Python package: PEER_PYTHON=/path/to/python with `pip install cyclonedds==11.0.1`; skipped without.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../../build/release/bin}
python=${PEER_PYTHON:-python3}
"$python" -c 'import cyclonedds' 2>/dev/null || { echo "skipped: no Python package cyclonedds"; exit 77; }

folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$folder"' EXIT
domain=$((1 + $$ % 90))

learner() { # run
  local sets=(run.domain=$domain "run.runs_dir=$folder" scene.tissue.grid.count_x=12 scene.tissue.grid.count_y=12
    scene.tissue.anchor_max_y_m=-0.014 task.episode_steps=60 rollout.slots=6 rollout.steps_per_segment=32
    rollout.max_steps=${STEPS:-60000} ppo.hidden=16 ppo.minibatch=64 ppo.epochs=2 evaluation.enabled=false)
  local arguments=() set
  for set in "${sets[@]}"; do arguments+=(--set "$set"); done
  "$bin/learner" --run "$1" --quiet "${arguments[@]}" 2>"$folder/$1.err"
}
train() { # run
  "$bin/sim_worker" --run "$1" --domain $domain --lanes 6 2>"$folder/$1.worker.err" &
  learner "$1" || { cat "$folder/$1.err"; exit 1; }
  wait $!
  sed -n 's/.*"weights_hash": "\(.*\)".*/\1/p' "$folder/$1/summary.json"
}

calm=$(train calm)
eval "$("$bin/learner" --print-dds-env)"
"$python" "$here/python_stranger.py" forged $domain "${SECONDS_OF_FORGING:-30}" >"$folder/stranger" &
stranger=$!
forged=$(train forged)
wait $stranger || { echo "the stranger could not forge: $(cat "$folder/stranger")"; exit 1; }
cat "$folder/stranger"
grep -o 'ledger .*' "$folder/forged.err"
lines=$(cat "$folder"/forged*.err | wc -l)
echo "calm $calm, forged $forged, $lines lines of log"
[[ $calm == "$forged" ]] || { echo "other weights"; exit 1; }
grep -q ' foreign=[1-9]' "$folder/forged.err" || { echo "no segment was foreign"; exit 1; }
((lines < 60)) || { echo "the log is poured full"; exit 1; }

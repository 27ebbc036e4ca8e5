#!/usr/bin/env bash
# Tools of others on a live run: the Python package cyclonedds decodes every public topic through `omentum mirror`, and
# the Python package mcap opens what `omentum record` wrote.
# Needs the packages: PEER_PYTHON=/path/to/python with `pip install cyclonedds==11.0.1 mcap mcap-protobuf-support`;
# skipped without.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
bin=${OMENTUM_BIN:-$here/../../build/release/bin}
python=${PEER_PYTHON:-python3}
"$python" -c 'import cyclonedds, mcap, mcap_protobuf' 2>/dev/null ||
  { echo "skipped: no Python packages cyclonedds, mcap, mcap-protobuf-support"; exit 77; }

folder=$(mktemp -d)
trap 'kill $(jobs -p) 2>/dev/null || true; wait; rm -rf "$folder"' EXIT
domain=$((1 + $$ % 45)) open=$((46 + $$ % 45))
sets=()
for set in run.domain=$domain "run.runs_dir=$folder" scene.tissue.grid.count_x=12 scene.tissue.grid.count_y=12 \
  scene.tissue.anchor_max_y_m=-0.014 task.episode_steps=60 rollout.slots=6 rollout.steps_per_segment=32 \
  rollout.max_steps=2000000000 ppo.hidden=16 ppo.minibatch=64 ppo.epochs=2 evaluation.enabled=false; do
  sets+=(--set "$set")
done
"$bin/sim_worker" --run seen --domain $domain --lanes 6 2>"$folder/worker.err" &
"$bin/learner" --run seen --quiet "${sets[@]}" 2>"$folder/learner.err" &
"$bin/omentum" mirror --run seen --domain $domain --to-domain $open >"$folder/mirror.out" &
"$bin/omentum" record --run seen --domain $domain --seconds 10 --out "$folder/seen.mcap" >"$folder/record.out" &
recorder=$!

unset CYCLONEDDS_URI
eval "$("$bin/learner" --print-dds-env)"
"$python" "$here/python_tools.py" topics $open seen
wait $recorder
cat "$folder/record.out"
"$python" "$here/python_tools.py" mcap "$folder/seen.mcap"

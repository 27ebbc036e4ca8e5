#!/usr/bin/env bash
# deploy/train.sh: a run has one owner, and nothing outlives a train.sh that is killed. Argument: repository root.
# OMENTUM_BIN: the programs.
set -uo pipefail
root=$1
scratch=$(mktemp -d)
run=owned$$  # the processes of another copy of this test have other names
trap 'kill -KILL $(left) 2>/dev/null; rm -rf "$scratch"' EXIT
left() { pgrep -f "(bin/(learner|sim_worker)|train.sh) .*--run $run( |\$)"; }
die() {
  echo "$1"
  cat "$scratch"/*.log
  ps -o pid,ppid,stat,args -p "$(left | paste -sd,)" 2>/dev/null
  exit 1
}
train() {
  exec "$root/deploy/train.sh" --no-setup --preset paper_literal --run "$run" --workers 2 --set run.runs_dir="$scratch/runs" \
    --set rollout.slots=16 --set rollout.steps_per_segment=32 --set run.checkpoint_interval_s=0 "$@"
}

(train --steps 200000000) >"$scratch/first.log" 2>&1 &
first=$!
for ((i = 0; i < 600; ++i)); do
  ! grep -q '^update 2/' "$scratch/first.log" || break
  sleep 0.1
done
grep -q '^update 2/' "$scratch/first.log" || die "no second update"

(train --steps 1000) >"$scratch/second.log" 2>&1
status=$?
((status == 2)) || die "a second train.sh ended with code $status"
grep -q "run $run is in use by train.sh of host .*, pid $first" "$scratch/second.log" || die "no word on the owner"
[[ ! -e $scratch/runs/$run.old1 ]] || die "the folder was moved under the first run"

kill -KILL "$first"
wait "$first" 2>/dev/null
for ((i = 0; i < 300; ++i)); do
  [[ -n $(left) ]] || break
  sleep 0.1
done
[[ -z $(left) ]] || die "processes outlive their train.sh"
grep -q 'resume with the same run name' "$scratch/first.log" || die "the learner did not save"

(train --steps 3000 --set evaluation.enabled=false) >"$scratch/third.log" 2>&1 || die "a new run ended with code $?"
echo "refused with code 2, ended with its parent, free again"

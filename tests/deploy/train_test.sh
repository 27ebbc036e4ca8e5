#!/usr/bin/env bash
# deploy/train.sh with real processes: a stopped run is resumable and ends with the weights of a run that was never
# stopped; a killed worker is replaced; nothing is left running. Argument: repository root. OMENTUM_BIN: the programs.
set -uo pipefail
root=$1
scratch=$(mktemp -d)
whole=whole$$ parts=parts$$ lonely=lonely$$  # the processes of another copy of this test have other names
trap 'kill -KILL $(left "($whole|$parts|$lonely)") 2>/dev/null; rm -rf "$scratch"' EXIT
small=(--no-setup --preset paper_literal --steps 3000 --workers 2 --set run.runs_dir="$scratch/runs" --set rollout.slots=16
  --set rollout.steps_per_segment=32 --set evaluation.enabled=false --set run.checkpoint_interval_s=0)

die() {
  echo "$1"
  [[ ! -f ${2-} ]] || tail -n 30 "$2"
  ps -L -o pid,stat,etimes,wchan:24,comm,args -p "$(left "($whole|$parts|$lonely)" | paste -sd,)" 2>/dev/null  # who hangs
  exit 1
}
# At most 90 s: then, or 30 s after a signal of ours, it is killed and the code is 124 or 137.
train() { exec timeout --foreground --kill-after=30 90 "$root/deploy/train.sh" "${small[@]}" "$@"; }
weights() { tr -d ' "\n' <"$1/summary.json" | sed -n 's/.*weights_hash:\([0-9a-f]*\).*/\1/p'; }
# Processes of ours that name the run; $2 = which programs.
left() { pgrep -f "^$OMENTUM_BIN/${2:-(learner|sim_worker)} .*--run $1( |\$)"; }
# Waits until a text is in the log of a running train.sh. $1 = log, $2 = text.
await() {
  local i
  for ((i = 0; i < 600; ++i)); do
    ! grep -q "$2" "$1" || return 0
    kill -0 "$train" 2>/dev/null || break
    sleep 0.05
  done
  grep -q "$2" "$1"
}

(train --run "$whole") >"$scratch/whole.log" 2>&1 || die "a plain run ended with code $?" "$scratch/whole.log"
[[ -s $scratch/runs/$whole/report.html ]] || die "no report" "$scratch/whole.log"
grep -q '^training ' "$scratch/whole.log" || die "no summary of times" "$scratch/whole.log"
[[ -z $(left "$whole") ]] || die "processes of the plain run are left"
reference=$(weights "$scratch/runs/$whole")
[[ -n $reference ]] || die "no weights in the summary" "$scratch/whole.log"

# The only worker is killed: without another one the run would never end.
(train --run "$lonely" --workers 1) >"$scratch/lonely.log" 2>&1 &
train=$!
await "$scratch/lonely.log" '^update 1/' || die "no first update with one worker" "$scratch/lonely.log"
first=$(left "$lonely" sim_worker)
[[ $first =~ ^[0-9]+$ ]] || die "not one worker but: $first" "$scratch/lonely.log"
kill -KILL "$first"
wait "$train"
status=$?
((status == 0)) || die "the run whose worker was killed ended with code $status" "$scratch/lonely.log"
grep -q 'worker 1 ended with code 137 .* started again' "$scratch/lonely.log" || die "no other worker" "$scratch/lonely.log"
[[ $(weights "$scratch/runs/$lonely") == "$reference" ]] || die "another worker, other weights" "$scratch/lonely.log"
[[ -z $(left "$lonely") ]] || die "processes of the run whose worker was killed are left"

# Stopped after the second update.
(train --run "$parts") >"$scratch/parts.log" 2>&1 &
train=$!
await "$scratch/parts.log" '^update 2/' || die "no second update" "$scratch/parts.log"
kill -TERM "$train"
wait "$train"
status=$?
# On a fast machine the run may be over before it is stopped; the comparison below holds all the same.
if ((status == 130)); then
  grep -q -- '--resume' "$scratch/parts.log" || die "no word on how to resume" "$scratch/parts.log"
  [[ -z $(left "$parts") ]] || die "processes of the stopped run are left"
elif ((status != 0)); then
  die "a stopped run ended with code $status" "$scratch/parts.log"
fi
(train --run "$parts" --resume) >"$scratch/resumed.log" 2>&1 || die "resuming ended with code $?" "$scratch/resumed.log"
[[ -z $(left "$parts") ]] || die "processes of the resumed run are left"
[[ $(weights "$scratch/runs/$parts") == "$reference" ]] ||
  die "weights differ: $reference and $(weights "$scratch/runs/$parts")" "$scratch/resumed.log"

# Two seeds, and the earlier folder moved aside.
(train --run "$parts" --seeds 2) >"$scratch/seeds.log" 2>&1 || die "two seeds ended with code $?" "$scratch/seeds.log"
[[ -d $scratch/runs/$parts.old1 ]] || die "the earlier run was not kept" "$scratch/seeds.log"
[[ $(weights "$scratch/runs/$parts/seed1") == "$reference" ]] || die "seed 1 is another run" "$scratch/seeds.log"
[[ $(weights "$scratch/runs/$parts/seed2") != "$reference" ]] || die "seed 2 is the same run" "$scratch/seeds.log"
echo "stopped with code $status; whole, replaced, resumed and seed 1 have weights $reference"

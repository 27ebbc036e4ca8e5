#!/usr/bin/env bash
# deploy/train.sh with real processes: a stopped run is resumable and ends with the weights of a run that was never
# stopped; a killed worker is replaced; nothing is left running. Argument: repository root. OMENTUM_BIN: the programs.
set -uo pipefail
root=$1
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
small=(--no-setup --preset paper --steps 3000 --workers 2 --set run.runs_dir="$scratch/runs" --set rollout.slots=16
  --set rollout.steps_per_segment=32 --set evaluation.enabled=false --set run.checkpoint_interval_s=0)

die() {
  echo "$1"
  [[ ! -f ${2-} ]] || tail -n 30 "$2"
  exit 1
}
weights() { tr -d ' "\n' <"$1/summary.json" | sed -n 's/.*weights_hash:\([0-9a-f]*\).*/\1/p'; }
# Processes of ours that name the run.
left() { pgrep -f "^$OMENTUM_BIN/(learner|sim_worker) .*--run $1( |\$)"; }

"$root/deploy/train.sh" "${small[@]}" --run whole >"$scratch/whole.log" 2>&1 || die "a plain run failed" "$scratch/whole.log"
[[ -s $scratch/runs/whole/report.html ]] || die "no report" "$scratch/whole.log"
grep -q '^training ' "$scratch/whole.log" || die "no summary of times" "$scratch/whole.log"
[[ -z $(left whole) ]] || die "processes of run whole are left"

# Stopped after the first update, with one worker killed before that.
"$root/deploy/train.sh" "${small[@]}" --run parts >"$scratch/parts.log" 2>&1 &
train=$!
for ((i = 0; i < 600; ++i)); do
  grep -q '^update 1/' "$scratch/parts.log" && break
  kill -0 "$train" 2>/dev/null || break
  sleep 0.05
done
worker=$(pgrep -f "^$OMENTUM_BIN/sim_worker .*--run parts( |\$)" | head -n 1)
[[ -n $worker ]] && kill -KILL "$worker"
for ((i = 0; i < 600; ++i)); do
  grep -q '^update 2/' "$scratch/parts.log" && break
  kill -0 "$train" 2>/dev/null || break
  sleep 0.05
done
kill -TERM "$train"
wait "$train"
status=$?
# On a fast machine the run may be over before it is stopped; the comparison below holds all the same.
if ((status == 130)); then
  grep -q -- '--resume' "$scratch/parts.log" || die "no word on how to resume" "$scratch/parts.log"
  [[ -z $(left parts) ]] || die "processes of the stopped run are left"
elif ((status != 0)); then
  die "a stopped run ended with code $status" "$scratch/parts.log"
fi
"$root/deploy/train.sh" "${small[@]}" --run parts --resume >"$scratch/resumed.log" 2>&1 || die "resuming failed" "$scratch/resumed.log"
[[ -z $(left parts) ]] || die "processes of the resumed run are left"
[[ -n $(weights "$scratch/runs/whole") && $(weights "$scratch/runs/whole") == "$(weights "$scratch/runs/parts")" ]] ||
  die "weights differ: $(weights "$scratch/runs/whole") and $(weights "$scratch/runs/parts")" "$scratch/resumed.log"

# Two seeds, and the earlier folder moved aside.
"$root/deploy/train.sh" "${small[@]}" --run parts --seeds 2 >"$scratch/seeds.log" 2>&1 || die "two seeds failed" "$scratch/seeds.log"
[[ -d $scratch/runs/parts.old1 ]] || die "the earlier run was not kept" "$scratch/seeds.log"
[[ $(weights "$scratch/runs/parts/seed1") == "$(weights "$scratch/runs/whole")" ]] || die "seed 1 is another run" "$scratch/seeds.log"
[[ $(weights "$scratch/runs/parts/seed2") != "$(weights "$scratch/runs/whole")" ]] || die "seed 2 is the same run" "$scratch/seeds.log"
echo "stopped with code $status; whole, resumed and seed 1 have weights $(weights "$scratch/runs/whole")"

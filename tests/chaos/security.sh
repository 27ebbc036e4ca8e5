# Chaos rows of DDS Security, to be sourced: stranger, wrong_role, expired. A row gets $BIN (folder of the programs)
# and $SCRATCH (a folder of its own), prints one line and returns 0, 1 (failed) or 77 (skipped).
# shellcheck shell=bash

security_make=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)/deploy/security/make.sh
security_task=(scene.tissue.grid.count_x=12 scene.tissue.grid.count_y=12 scene.tissue.anchor_max_y_m=-0.014
  task.episode_steps=60 rollout.slots=6 rollout.steps_per_segment=32 ppo.hidden=16 ppo.minibatch=64 ppo.epochs=2
  evaluation.enabled=false)

# A DDS domain that no other test of this machine has, held until the row ends. Sets security_domain.
security_take_domain() {
  local number
  for ((number = 1; number <= 90; ++number)); do
    security_domain=$((1 + (BASHPID + number) % 90))
    exec {security_lock}>>"/tmp/omentum_test_domain_$security_domain"
    if flock -n "$security_lock"; then return 0; fi
    exec {security_lock}>&-
  done
  return 1
}
# Starts a learner of run $1 in the background; $2 = steps, $3... = further options. Its id is $!. Its updates go to
# $run.updates.
security_learner() {
  local run=$1 steps=$2 sets=() set
  shift 2
  for set in "${security_task[@]}" "rollout.max_steps=$steps" "run.domain=$security_domain" \
    "run.runs_dir=$security_folder/runs"; do sets+=(--set "$set"); done
  "$BIN/learner" --run "$run" --max-wait 60 "${sets[@]}" "$@" >"$security_folder/$run.updates" \
    2>"$security_folder/$run.learner" &
}
# Starts a worker of run $1 in the background, log $2; $3... = further options.
security_worker() {
  local run=$1 log=$2
  shift 2
  "$BIN/sim_worker" --run "$run" --domain "$security_domain" --max-wait 60 "$@" 2>"$security_folder/$log" &
}
security_hash() { sed -n 's/.*"weights_hash": "\(.*\)".*/\1/p' "$security_folder/runs/$1/summary.json"; }
# Whether every number of the ledger's last line of run $1 is accounted for.
security_balanced() {
  grep -o 'ledger .*' "$security_folder/$1.learner" | tail -n 1 | tr ' ' '\n' | awk -F= '
    { n[$1] = $2 }
    END { exit !(n["granted"] > 0 && n["granted"] == n["admitted"] + n["outstanding"] + n["cancelled"] + n["regranted"] &&
                 n["received"] == n["admitted"] + n["duplicate"] + n["stale"] + n["invalid"] + n["foreign"] + n["overflow"]) }'
}
# Waits up to $1 seconds until file $2 holds $3.
security_wait_for() {
  local tries=$((10 * $1))
  until grep -qs -- "$3" "$2"; do
    ((tries-- > 0)) || return 1
    sleep 0.1
  done
}
# Trains without security and disturbance; $1 = steps. Prints the hash.
security_calm_hash() {
  local learner
  security_worker calm calm.worker --lanes 6
  security_learner calm "$1"
  learner=$!
  wait "$learner" && security_hash calm
}
# Runs a row's body in a folder, on a domain and with processes of its own.
security_row() (
  security_folder=$SCRATCH/$1
  trap 'kill -KILL $(jobs -p) 2>/dev/null; wait 2>/dev/null' EXIT
  command -v openssl >/dev/null || { echo "no openssl"; exit 77; }
  mkdir -p "$security_folder" && security_take_domain || { echo "no folder or no free domain"; exit 1; }
  keys=$security_folder/security
  "$security_make" --out "$keys" --role learner --role worker >"$security_folder/make" 2>&1 ||
    { tail -n 1 "$security_folder/make"; exit 1; }
  "$1"
)
# End of a row: learner with id $1 of run $2 must have ended well, with the weights $3; $4 = what to say then.
security_judge() {
  local status hash
  wait "$1"
  status=$?
  ((status == 0)) || { echo "learner ended with $status: $(tail -n 1 "$security_folder/$2.learner")"; return 1; }
  hash=$(security_hash "$2")
  [[ -n $3 && $hash == "$3" ]] || { echo "weights $hash instead of $3"; return 1; }
  security_balanced "$2" || { echo "ledger: $(grep -o 'ledger .*' "$security_folder/$2.learner" | tail -n 1)"; return 1; }
  echo "$4, ledger balanced, weights ${hash:0:8} as undisturbed"
}

# A worker without certificate and, where the tests are built, a forger, beside a secured training.
stranger() {
  local calm learner forger='' log=$security_folder/stranger.worker
  calm=$(security_calm_hash 9216)
  if [[ -x $BIN/dds_stranger ]]; then
    "$BIN/dds_stranger" closed "$security_domain" 2>"$security_folder/forger" &
    forger=' and a forger'
  fi
  security_worker closed stranger.worker --lanes 6
  security_wait_for 20 "$log" 'info run=' || { echo "the stranger did not start"; return 1; }
  security_worker closed closed.worker --lanes 6 --security-dir "$keys/worker"
  security_learner closed 9216 --security-dir "$keys/learner"
  learner=$!
  security_judge "$learner" closed "$calm" "a worker without certificate$forger got nothing" || return 1
  ! grep -q follow_learner "$log" && grep -q ' foreign=0 ' "$security_folder/closed.learner" || {
    echo "a participant without certificate was heard"
    return 1
  }
}

# A program with a worker's certificate that wants to write weights, beside a secured training.
wrong_role() {
  local calm learner impostor line
  calm=$(security_calm_hash 9216)
  security_worker closed closed.worker --lanes 6 --security-dir "$keys/worker"
  security_learner closed 9216 --security-dir "$keys/learner"
  learner=$!
  security_learner impostor 9216 --security-dir "$keys/worker"
  impostor=$!
  wait "$impostor"
  (($? == 2)) || { echo "the impostor was not refused"; return 1; }
  line=$(tail -n 1 "$security_folder/impostor.learner")
  [[ $line == *'worker may not write omentum/'*'Not Allowed By Security'* ]] || { echo "told as: $line"; return 1; }
  line=${line#learner: }
  security_judge "$learner" closed "$calm" "refused: ${line%%: Not*}"
}

# The first digits of the weights after each update of run $1, numbered; $2 = up to this update.
security_weights() {
  sed -n 's/^update \([0-9]*\)\/.* weights \([0-9a-f]*\)$/\1 \2/p' "$security_folder/$1.updates" | head -n "$2"
}

# A worker whose certificate ends in mid-run and is renewed. The run goes on until it is stopped, on a machine of any
# speed; what it learned is compared update by update with a run that nothing disturbed.
expired() {
  local learner updates steps=2000000000 log=$security_folder/closed.learner
  "$security_make" --out "$keys" --role worker --renew --until '6 seconds' >/dev/null || return 1
  security_worker closed ends.worker --lanes 6 --security-dir "$keys/worker"
  security_learner closed $steps --security-dir "$keys/learner"
  learner=$!
  security_wait_for 60 "$log" event=worker_lost || { echo "the learner still has the worker"; return 1; }
  updates=$(security_weights closed $steps | wc -l)
  "$security_make" --out "$keys" --role worker --renew >/dev/null || return 1
  security_worker closed renewed.worker --lanes 6 --security-dir "$keys/worker"
  security_wait_for 60 "$security_folder/closed.updates" "^update $((updates + 10))/" ||
    { echo "the renewed worker does not go on: $(tail -n 1 "$log")"; return 1; }
  kill -TERM "$learner"
  wait "$learner"
  (($? == 130)) || { echo "the learner did not stop: $(tail -n 1 "$log")"; return 1; }
  updates=$(security_weights closed $steps | wc -l)

  security_worker calm calm.worker --lanes 6
  security_learner calm $steps
  security_wait_for 60 "$security_folder/calm.updates" "^update $updates/" || { echo "no undisturbed run"; return 1; }
  cmp -s <(security_weights closed "$updates") <(security_weights calm "$updates") ||
    { echo "other weights than undisturbed"; return 1; }
  security_balanced closed || { echo "ledger: $(grep -o 'ledger .*' "$log" | tail -n 1)"; return 1; }
  echo "worker left at the end of its certificate, the renewed one went on; ledger balanced, $updates updates as undisturbed"
}

row_stranger() { security_row stranger; }
row_wrong_role() { security_row wrong_role; }
row_expired() { security_row expired; }

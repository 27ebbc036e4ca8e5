# Chaos row of Slurm, to be sourced: slurm. It gets $BIN (folder of the programs) and $SCRATCH (a folder of its own that
# the nodes share), prints one line and returns 0, 1 (failed) or 77 (skipped).
# shellcheck shell=bash

slurm_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# shellcheck source=tests/chaos/security.sh
. "$slurm_root/tests/chaos/security.sh"

# A learner job and two workers; one worker is requeued, as by a preemption, and comes back when Slurm lets it. The learner's
# job ends with the report.
row_slurm() (
  steps=400000
  command -v sbatch >/dev/null && [[ $(sinfo -h -t idle,mixed 2>/dev/null) ]] || { echo "no Slurm with a free node"; exit 77; }
  security_folder=$SCRATCH/slurm
  mkdir -p "$security_folder/runs" && security_take_domain || { echo "no folder or no free domain"; exit 1; }
  calm=$(security_calm_hash $steps)
  export BIN RUNS=$security_folder/runs
  sets=()
  for set in "${security_task[@]}" rollout.max_steps=$steps "run.domain=$security_domain"; do sets+=(--set "$set"); done
  cd "$slurm_root" || exit 1
  log=$security_folder/slurm.learner
  learner=$(sbatch --parsable -o "$log" deploy/slurm/learner.sh --preset omentum --run slurm --quiet "${sets[@]}") || exit 1
  workers=$(sbatch --parsable --array=1-2 -o "$security_folder/worker%a" deploy/slurm/worker.sh --run slurm \
    --domain "$security_domain") || exit 1
  trap 'scancel "$learner" "$workers"' EXIT
  security_wait_for 60 "$security_folder/worker1" event=follow_learner || { echo "no worker joined"; exit 1; }
  scontrol requeue "${workers}_1" || { echo "the worker could not be requeued"; exit 1; }
  security_wait_for 30 "$log" 'event=worker_le\|event=worker_lost' || { echo "the worker did not leave"; exit 1; }
  security_wait_for 240 "$log" 'ledger granted' || { echo "not finished: $(tail -n 1 "$log")"; exit 1; }
  for ((tries = 0; tries < 240; ++tries)); do
    state=$(scontrol show job "$learner" | grep -o 'JobState=[A-Z_]*')
    [[ $state == JobState=RUNNING || $state == JobState=COMPLETING ]] || break
    sleep 0.5
  done
  [[ $state == JobState=COMPLETED ]] || { echo "the learner's job ended as $state: $(tail -n 1 "$log")"; exit 1; }
  [[ -s $RUNS/slurm/report.html ]] || { echo "no report in the run folder"; exit 1; }
  requeued=$(squeue -h -j "$workers" -o %T | grep -c PENDING)
  security_balanced slurm || { echo "ledger: $(grep -o 'ledger .*' "$log")"; exit 1; }
  hash=$(security_hash slurm)
  [[ -n $calm && $hash == "$calm" ]] || { echo "weights $hash instead of $calm"; exit 1; }
  echo "one of two worker jobs preempted ($requeued waits to be started again), report written, ledger balanced, weights ${hash:0:8} as undisturbed"
)

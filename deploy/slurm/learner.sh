#!/usr/bin/env bash
#SBATCH --job-name=omentum-learner
#SBATCH --cpus-per-task=2
#SBATCH --mem=2G
#SBATCH --requeue
#SBATCH --open-mode=append
# Learner of a run as a job (docs/cluster.md 6): sbatch deploy/slurm/learner.sh --run NAME [options of the learner]. At the
# end it studies the grasp and writes RUNS/NAME/report.html. Ends with the learner's code, or with 1 where the report fails.
# BIN and RUNS name other folders than build/release/bin and runs, INTERFACE another address than the host's first one.
set -uo pipefail
folder=${SLURM_SUBMIT_DIR:-$PWD}
bin=${BIN:-$folder/build/release/bin} runs=${RUNS:-$folder/runs}
run='' previous=''
for argument in "$@"; do
  [[ $previous != --run ]] || run=$argument
  previous=$argument
done
[[ -n $run ]] || { echo "learner.sh: --run NAME is missing" >&2; exit 2; }
mkdir -p "$runs" || exit 2
# An address: the own name of a Debian host is 127.0.1.1 there.
address=${INTERFACE:-$(hostname -I | cut -d' ' -f1)}
echo "$address" >"$runs/.$run.learner_host.new" && mv "$runs/.$run.learner_host.new" "$runs/.$run.learner_host" || exit 2
stopped=0 pid=''
trap 'stopped=1; [[ -z $pid ]] || kill -TERM "$pid" 2>/dev/null' TERM INT
# Runs a program so that Slurm's SIGTERM before a preemption reaches it at once.
attended() {
  local status
  "$@" &
  pid=$!
  wait "$pid"
  status=$?
  while kill -0 "$pid" 2>/dev/null; do  # only the wait was ended
    wait "$pid"
    status=$?
  done
  pid=''
  return "$status"
}
attended "$bin/learner" --discovery hub --interface "$address" --set "run.runs_dir=$runs" "$@"
status=$?
if ((status != 0 || stopped)); then exit "$status"; fi
attended "$bin/sim_worker" --grasp-study "$runs/$run" || echo "learner.sh: no grasp study" >&2
((stopped == 0)) || exit 130
attended "$bin/report" "$runs/$run"

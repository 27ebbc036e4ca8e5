#!/usr/bin/env bash
#SBATCH --job-name=omentum-learner
#SBATCH --cpus-per-task=2
#SBATCH --mem=2G
#SBATCH --requeue
#SBATCH --open-mode=append
# Learner of a run as a job (docs/cluster.md 6): sbatch deploy/slurm/learner.sh --run NAME [options of the learner].
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
# Slurm's SIGTERM before a preemption reaches the learner, which saves its checkpoint.
exec "$bin/learner" --discovery hub --interface "$address" --set "run.runs_dir=$runs" "$@"

#!/usr/bin/env bash
#SBATCH --job-name=omentum-worker
#SBATCH --cpus-per-task=1
#SBATCH --mem=1G
#SBATCH --requeue
#SBATCH --open-mode=append
# Workers of a run as a job array (docs/cluster.md 6): sbatch --array=1-N deploy/slurm/worker.sh --run NAME
# [options of sim_worker]. BIN and RUNS name other folders than build/release/bin and runs.
set -uo pipefail
folder=${SLURM_SUBMIT_DIR:-$PWD}
bin=${BIN:-$folder/build/release/bin} runs=${RUNS:-$folder/runs}
run='' previous=''
for argument in "$@"; do
  [[ $previous != --run ]] || run=$argument
  previous=$argument
done
[[ -n $run ]] || { echo "worker.sh: --run NAME is missing" >&2; exit 2; }
until [[ -s $runs/.$run.learner_host ]]; do sleep 2; done
exec "$bin/sim_worker" --discovery hub --hub "$(<"$runs/.$run.learner_host")" "$@"

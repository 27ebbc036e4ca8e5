#!/bin/bash
# The learner's container: trains, then studies the grasp and writes the report, as deploy/train.sh does. Options are the
# learner's. Ends with its code, or with 1 where the report fails.
set -u
[[ -w $OMENTUM_RUNS_DIR ]] || {
  echo "learner: $OMENTUM_RUNS_DIR cannot be written by user $(id -u): chown $(id -u):$(id -g) its folder on the host" >&2
  exit 2
}
stopped=0 pid=''
trap 'stopped=1; [[ -z $pid ]] || kill -TERM "$pid" 2>/dev/null' TERM INT
# Runs a program so that a signal to this shell reaches it at once.
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
run=omentum preset='' previous=''
for argument in "$@"; do
  case $previous in --run) run=$argument ;; --preset) preset=$argument ;; esac
  previous=$argument
done
attended learner --set "run.runs_dir=$OMENTUM_RUNS_DIR" "$@"
status=$?
rm -f "${OMENTUM_HEARTBEAT-}"  # what follows has none
if ((status != 0 || stopped)); then exit "$status"; fi
folder=$OMENTUM_RUNS_DIR/$run
attended sim_worker --grasp-study "$folder" || echo "learner: no grasp study" >&2
((stopped == 0)) || exit 130
attended report "$folder"

#!/usr/bin/env bash
# deploy/train.sh ends whatever its processes do about signals; these are stand-ins. Argument: repository root.
set -uo pipefail
root=$1
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir "$scratch/bin"

program() {  # $1 = name; its text comes from stdin
  cat - >"$scratch/bin/$1"
  chmod +x "$scratch/bin/$1"
}
program report <<<'#!/bin/bash'
# Like the learner: a configuration first, then a run that ends when $FOLDER/end is there.
program learner <<'TEXT'
#!/bin/bash
[[ " $* " != *" --dry-run "* ]] || { printf 'workers: 2\nmax_steps: 1\n'; exit 0; }
[[ $LEARNER != dies ]] || exit 1
if [[ $LEARNER == waits ]]; then
  trap 'exit 130' TERM
  while true; do sleep 0.02; done
fi
for ((i = 0; i < 200; ++i)); do [[ $(cat "$FOLDER"/started 2>/dev/null | wc -l) == 2 ]] && break; sleep 0.05; done
exit 130
TEXT
# Misses its first two signals, or all of them, or aborts as a check of ours does.
program sim_worker <<'TEXT'
#!/bin/bash
[[ " $* " != *" --check-config "* ]] || exit 0
[[ $MISSES != aborts ]] || kill -ABRT $$
missed=0
trap '((++missed <= MISSES)) || exit 0' TERM
echo $$ >>"$FOLDER/started"
while true; do sleep 0.02; done
TEXT

failed=0
ends() {  # $1 = what, $2 = expected code, rest = environment
  local what=$1 want=$2 status
  shift 2
  rm -f "$scratch/started"
  env OMENTUM_BIN="$scratch/bin" FOLDER="$scratch" "$@" timeout --foreground --kill-after=1 60 \
    "$root/deploy/train.sh" --no-setup --run stop --workers 2 --set run.runs_dir="$scratch/runs" >"$scratch/log" 2>&1
  status=$?
  if ((status != want)); then
    echo "$what: code $status, expected $want"
    cat "$scratch/log"
    failed=1
  fi
  while read -r pid; do
    ! kill -KILL "$pid" 2>/dev/null || { echo "$what: worker $pid is left"; failed=1; }
  done < <(cat "$scratch/started" 2>/dev/null)
}
ends "workers that miss two signals" 130 LEARNER=runs MISSES=2
ends "workers that miss every signal" 130 LEARNER=runs MISSES=1000000
for _ in {1..10}; do ends "a learner that dies before its workers begin" 1 LEARNER=dies MISSES=0; done
ends "workers that abort again and again" 1 LEARNER=waits MISSES=aborts
((failed)) || echo "every run ended, no worker is left"
exit "$failed"

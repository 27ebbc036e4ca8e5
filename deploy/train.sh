#!/usr/bin/env bash
# Trains on this machine: set-up, build, learner and workers over loopback, evaluation, report. See --help.
set -uo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bin=${OMENTUM_BIN:-$root/build/release/bin}  # the tests name another build

usage() {
  cat <<'TEXT'
usage: deploy/train.sh [--preset P] [--steps N] [--seeds K] [--workers W] [--run NAME] [--resume] [--set a.b=c]...

Installs what is missing, builds, trains with one learner and W workers on this machine, evaluates, writes the report.
  --preset P     one of deploy/presets (default omentum)
  --steps N      environment steps of each run (default: the preset's rollout.max_steps)
  --seeds K      K runs one after the other, seeds counted up from rollout.run_seed (default 1)
  --workers W    simulation workers (default: run.workers of the preset, at most the cores)
  --run NAME     run folder runs/NAME; with several seeds runs/NAME/seed1, ... (default: the preset's name)
  --resume       continue runs/NAME; without it an existing runs/NAME is moved aside to runs/NAME.oldN
  --set a.b=c    override a knob; may be repeated (learner --help lists every knob)
  --no-setup     take build/release as it is
  --version      print release, revision and build of the programs
A run belongs to one process: a second one on the same name is refused with host and pid of the first.
Ctrl-C stops cleanly and leaves a run that --resume continues; a second one ends everything at once.
Exit codes: 0 done, 1 failed, 2 wrong input, 130 stopped.
TEXT
}

wrong() {
  echo "train.sh: $1 (see --help)" >&2
  exit 2
}
say() { echo "train: $*"; }

preset=omentum steps='' seeds=1 workers='' name='' resume=0 setup=1
sets=()
while (($#)); do
  option=$1
  case $option in
    --preset | --steps | --seeds | --workers | --run | --set)
      (($# > 1)) || wrong "$option needs a value"
      value=$2
      shift
      ;;
    --*=*)
      wrong "write ${option%%=*} VALUE, not $option"
      ;;
  esac
  case $option in
    --preset) preset=$value ;;
    --steps)
      [[ ! $value =~ ^[1-9]e[0-9]{1,2}$ ]] || value=$(printf '%.0f' "$value")  # 1e6
      [[ $value =~ ^[1-9][0-9]{0,11}$ ]] || wrong "--steps $value: a number from 1 to 999999999999"
      steps=$value
      ;;
    --seeds) [[ $value =~ ^[1-9][0-9]{0,2}$ ]] || wrong "--seeds $value: a number from 1 to 999"; seeds=$value ;;
    --workers) [[ $value =~ ^[1-9][0-9]{0,2}$ ]] || wrong "--workers $value: a number from 1 to 999"; workers=$value ;;
    --run)
      # The rule of check_run_name() in core/topics.cpp.
      [[ $value =~ ^[A-Za-z0-9_][A-Za-z0-9._-]{0,99}$ ]] ||
        wrong "--run $value: 1 to 100 of A-Z a-z 0-9 _ - . and neither - nor . first"
      name=$value
      ;;
    --set) [[ $value == ?*=* ]] || wrong "--set $value: must read a.b=c"; sets+=("$value") ;;
    --resume) resume=1 ;;
    --no-setup) setup=0 ;;
    -h | --help) usage; exit 0 ;;
    --version) "$bin/learner" --version; exit ;;
    *) wrong "unknown option $option" ;;
  esac
  shift
done
presets=("$root"/deploy/presets/*.txtpb)
presets=("${presets[@]##*/}")
presets=("${presets[@]%.txtpb}")
[[ " ${presets[*]} " == *" $preset "* ]] || wrong "--preset $preset: one of ${presets[*]}"
: "${name:=$preset}"

# Last value of a knob among the --set options, else the default given.
knob() {
  local value=$2 assignment
  for assignment in "${sets[@]}"; do [[ $assignment != "$1="* ]] || value=${assignment#*=}; done
  echo "$value"
}
runs_dir=$(knob run.runs_dir "$root/runs")
run_dir=$runs_dir/$name
seed_base=$(knob rollout.run_seed 1)
[[ $seed_base =~ ^[0-9]{1,18}$ ]] || wrong "--set rollout.run_seed=$seed_base: a number"
domain=$(knob run.domain "")
common=(--preset "$preset")
for assignment in "${sets[@]}"; do common+=(--set "$assignment"); done
[[ -z $steps ]] || common+=(--set "rollout.max_steps=$steps")

now() { date +%s.%N; }
since() { awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f", b - a }'; }
add() { awk -v a="$1" -v b="$2" 'BEGIN { printf "%.1f", a + b }'; }

# Whose lock a file is: "host pid", empty where nobody holds it.
owner_of() {
  [[ -e $1 ]] && ! flock -n "$1" true && cat "$1"
}
refuse_owned() {  # $1 = lock file, $2 = program
  local owner
  owner=$(owner_of "$1") || return 0
  fail "run $name is in use by $2 of host ${owner% *}, pid ${owner#* }" 2
}
# This script's own lock on the run, and those that learners hold (learner/run_lock.h): before anything is moved.
own_run() {
  local file
  mkdir -p "$runs_dir" || fail "$runs_dir cannot be made" 2
  refuse_owned "$runs_dir/.$name.train.lock" train.sh
  exec {run_lock}>>"$runs_dir/.$name.train.lock" && flock -n "$run_lock" || refuse_owned "$runs_dir/.$name.train.lock" train.sh
  echo "$(uname -n) $$" >"$runs_dir/.$name.train.lock"
  for file in "$runs_dir/.$name.lock" "$run_dir"/.seed*.lock; do refuse_owned "$file" "the learner"; done
}

scratch=$(mktemp -d) || exit 1
learner_pid='' tee_pid='' supervisors=() stop=0 worker_failed=0

# Asks processes to stop until they are gone, after $1 tenths of a second with force; $2... = children of this shell.
# Nothing here waits for ever for a process that missed a signal or cannot end.
insist() {
  local tries=$1 pid
  shift
  while kill -TERM "$@" 2>/dev/null; do
    ((tries-- > 0)) || kill -KILL "$@" 2>/dev/null
    sleep 0.1
  done
  for pid in "$@"; do wait "$pid" 2>/dev/null; done
}
stop_workers() {
  ((${#supervisors[@]})) || return 0
  insist 200 "${supervisors[@]}"
  supervisors=()
}
finish() {
  trap '' INT TERM HUP
  if [[ -n $learner_pid ]] && kill -0 "$learner_pid" 2>/dev/null; then
    kill -TERM "$learner_pid" 2>/dev/null
    ((stop < 2)) || kill -KILL "$learner_pid" 2>/dev/null
    wait "$learner_pid" 2>/dev/null
  fi
  stop_workers
  [[ -z $tee_pid ]] || wait "$tee_pid" 2>/dev/null
  rm -rf "$scratch"
}
trap finish EXIT
on_signal() {
  ((++stop))
  if ((stop == 1)); then
    echo
    say "stopping: the learner saves its checkpoint (once more ends everything at once)"
    [[ -z $learner_pid ]] || kill -TERM "$learner_pid" 2>/dev/null
  else
    [[ -z $learner_pid ]] || kill -KILL "$learner_pid" 2>/dev/null
  fi
}
trap on_signal INT TERM HUP
trap 'worker_failed=1; [[ -z $learner_pid ]] || kill -TERM "$learner_pid" 2>/dev/null' USR1

resume_hint() {
  local hint="deploy/train.sh --run $name --resume --preset $preset"
  [[ -z $steps ]] || hint+=" --steps $steps"
  ((seeds == 1)) || hint+=" --seeds $seeds"
  [[ -z $workers ]] || hint+=" --workers $workers"
  local assignment
  for assignment in "${sets[@]}"; do hint+=" --set $(printf %q "$assignment")"; done
  echo "$hint"
}
end_stopped() {
  say "stopped; continue with: $(resume_hint)"
  exit 130
}
fail() {
  echo "train.sh: $1" >&2
  exit "${2:-1}"
}

# Keeps one worker alive until this process is told to stop. $1 = number. A worker that cannot even start after
# several tries tells the main process so.
supervise_worker() {
  local number=$1 pause=1 born code main worker log=$folder/worker$1.log
  trap 'trap "" TERM; insist 100 $(jobs -p); exit 0' TERM
  trap '' INT HUP
  exec {run_lock}>&-  # the run is the main process's; what waits here for its end must not hold it
  # Ends when the main process does, however that ends.
  tail --pid=$$ -f /dev/null 2>/dev/null &
  main=$!
  while true; do
    born=$SECONDS
    setpriv --pdeathsig TERM "$bin/sim_worker" --run "$name" --domain "$domain" "${worker_options[@]}" >>"$log" 2>&1 &
    worker=$!
    wait -n "$worker" "$main" 2>/dev/null  # bash would tell of a killed child here
    code=$?
    if ! kill -0 $$ 2>/dev/null; then
      insist 100 "$worker"
      exit 1
    fi
    if ((SECONDS - born >= 60)); then pause=1; fi
    # A start-up error stays what it is; an abort (a check of ours, a bad address) that comes back every time does too.
    if ((code == 2 && pause > 4 || (code == 134 || code == 139) && pause > 16)); then
      echo "train: worker $number cannot run: $(tail -n 1 "$log")"
      kill -USR1 $$
      return 1
    fi
    # A worker that left in peace belongs to a run that is over; the main process stops this one in a moment.
    ((code != 0)) || pause=$((pause < 4 ? 4 : pause))
    sleep "$pause" &
    wait $!
    kill -0 $$ 2>/dev/null || exit 1
    echo "train: worker $number ended with code $code after $((SECONDS - born)) s and is started again (log: $log)"
    pause=$((pause < 30 ? 2 * pause : 30))
  done
}

# A DDS domain that nobody on this host uses: no socket on its ports and its lock is free. Sets `domain`.
domain_in_use() {
  awk -v low=$((7400 + 250 * $1)) -v high=$((7649 + 250 * $1)) '
    function number(hex,   i, n) {
      for (i = 1; i <= length(hex); ++i) n = 16 * n + index("0123456789ABCDEF", substr(hex, i, 1)) - 1
      return n
    }
    FNR > 1 { split($2, at, ":"); port = number(at[2]); if (port >= low && port <= high) found = 1 }
    END { exit !found }' /proc/net/udp
}
lock_domain() {
  { exec {lock}>>"/tmp/omentum_test_domain_$1"; } 2>/dev/null || return 1
  flock -n "$lock" && return 0
  exec {lock}>&-
  return 1
}
choose_domain() {
  if [[ -n $domain ]]; then
    [[ $domain =~ ^[0-9]{1,3}$ ]] && ((domain <= 230)) || wrong "--set run.domain=$domain: a number from 0 to 230"
    ! domain_in_use "$domain" || fail "DDS domain $domain is in use on this host; leave run.domain out for a free one" 2
    return
  fi
  local i
  for ((i = 0; i < 90; ++i)); do
    domain=$((1 + ($$ + i) % 90))
    ! domain_in_use "$domain" && lock_domain "$domain" && return
  done
  fail "no free DDS domain among 1 ... 90"
}

# Value of a top-level or nested number in summary.json; $1 = file, $2 = key.
from_summary() { tr -d '\n' <"$1" | sed -n "s/.*\"$2\": *\([-0-9.e+]*\).*/\1/p"; }
evaluation_rows() {  # $1 = summary.json: name starts target_reached exposed grasp_held
  tr -d '\n ' <"$1" | grep -o '{"name":"[^}]*}' |
    sed -n 's/.*"name":"\([^"]*\)","starts":\([0-9]*\),"target_reached":\([0-9]*\),"exposed":\([0-9]*\),"grasp_held":\([0-9]*\).*/\1 \2 \3 \4 \5/p'
}

# Trains one seed into $folder; $@ = further learner options.
train_one() {
  local number status code
  mkdir -p "$folder" || fail "$folder cannot be made"
  # Interrupts are ignored by tee: the learner still has to print that it has stopped.
  exec {output}> >(exec {run_lock}>&- tee -i -a "$folder/learner.log")
  tee_pid=$!
  setpriv --pdeathsig TERM "$bin/learner" "${common[@]}" --run "$name" --set "run.domain=$domain" "$@" >&"$output" 2>&1 &
  learner_pid=$!
  exec {output}>&-
  for ((number = 1; number <= workers; ++number)); do
    supervise_worker "$number" &
    supervisors+=($!)
  done
  while true; do
    wait "$learner_pid"
    status=$?
    kill -0 "$learner_pid" 2>/dev/null || break
  done
  if ((status > 128)); then  # perhaps a signal to this script ended the wait: ask for the learner's own code
    wait "$learner_pid" 2>/dev/null
    code=$?
    ((code == 127)) || status=$code
  fi
  learner_pid=''
  stop_workers
  wait "$tee_pid" 2>/dev/null
  tee_pid=''
  return "$status"
}

setup_s=0 build_s=0
if ((setup)); then
  "$root/deploy/setup.sh" --no-tests --times "$scratch/times"
  status=$?
  if ((stop > 0)); then
    say "stopped before the training began"
    exit 130
  fi
  ((status == 0)) || fail "the set-up failed" "$status"
  # shellcheck disable=SC1091  # two numbers, written by setup.sh
  . "$scratch/times"
fi
for program in learner sim_worker report; do
  [[ -x $bin/$program ]] || fail "$bin/$program is missing: run deploy/setup.sh"
done

# The resolved configuration; a wrong knob or scene ends here, before anything is moved or started. What is odd is told.
"$bin/learner" "${common[@]}" --run "$name" --dry-run >"$scratch/config" 2>"$scratch/error" ||
  fail "$(tail -n 1 "$scratch/error" | sed 's/^\(learner\|sim_worker\): //')" 2
cat "$scratch/error" >&2
resolved() { sed -n "s/^ *$1: *\"\{0,1\}\([^\"]*\)\"\{0,1\}$/\1/p" "$scratch/config" | tail -n 1; }
if [[ -z $workers ]]; then
  workers=$(resolved workers)
  cores=$(nproc)
  ((workers <= cores)) || workers=$cores
fi
worker_options=()
lanes=$(resolved lanes) width=$(resolved lane_width)
((${lanes:-0} == 0)) || worker_options+=(--lanes "$lanes")
((${width:-0} == 0)) || worker_options+=(--lane-width "$width")

own_run
if ((resume)); then
  [[ -d $run_dir ]] || fail "--resume: there is no $run_dir" 2
elif [[ -e $run_dir ]]; then
  for ((i = 1; ; ++i)); do [[ -e $run_dir.old$i ]] || break; done
  mv "$run_dir" "$run_dir.old$i" || fail "$run_dir cannot be moved aside"
  say "the earlier run is now $run_dir.old$i"
fi

choose_domain
say "preset $preset, $(resolved max_steps) steps, $seeds seed(s), $workers worker(s), DDS domain $domain, folder $run_dir"
training_s=0 evaluation_s=0 folders=()
for ((seed = 1; seed <= seeds; ++seed)); do
  if ((seeds == 1)); then
    folder=$run_dir
    options=(--set "run.runs_dir=$runs_dir")
  else
    # The learner names its folder after the run; the seeds are separate runs seedN inside runs/NAME.
    folder=$run_dir/seed$seed
    options=(--set "run.runs_dir=$run_dir" --set "rollout.run_seed=$((seed_base + seed - 1))")
  fi
  folders+=("$folder")
  if ((resume)) && ((seeds > 1)) && [[ -s $folder/summary.json ]]; then
    say "seed $seed is done already"
    continue
  fi
  ((seeds == 1)) || say "seed $seed of $seeds"
  session=$name
  ((seeds == 1)) || name=seed$seed
  train_one "${options[@]}"
  status=$?
  name=$session
  ((worker_failed == 0)) || fail "the workers cannot run; see $folder/worker1.log"
  if ((stop > 0 || status == 130)); then end_stopped; fi
  if ((status != 0)); then
    reason=$(grep -a '^learner: ' "$folder/learner.log" || tail -n 1 "$folder/learner.log")
    fail "the learner ended with code $status: $(tail -n 1 <<<"${reason#learner: }")" $((status == 2 ? 2 : 1))
  fi
done

# Of the first seed only: it depends on the configuration, not on the policy, and is made once. The report reads it.
study_began=$(now)
"$bin/sim_worker" --grasp-study "${folders[0]}" >"$scratch/study" 2>&1 ||
  echo "train.sh: no grasp study: $(tail -n 1 "$scratch/study" | sed 's/^sim_worker: //')" >&2
study_s=$(since "$study_began")
((stop == 0)) || end_stopped

began=$(now)
report_line=$("$bin/report" "$run_dir" 2>&1)
report_status=$?
report_s=$(since "$began")
grep "^report: " <<<"$report_line" >&2
((stop == 0)) || end_stopped

echo
for folder in "${folders[@]}"; do
  training_s=$(add "$training_s" "$(from_summary "$folder/summary.json" wall_s)")
  evaluation_s=$(add "$evaluation_s" "$(from_summary "$folder/summary.json" evaluation)")
done
rows=$(for folder in "${folders[@]}"; do
  while read -r set starts reached exposed held; do
    printf '%-10s %-18s %7s %15s %8s %11s\n' "${folder##*/}" "$set" "$starts" "$reached" "$exposed" "$held"
  done < <(evaluation_rows "$folder/summary.json")
done)
if [[ -n $rows ]]; then
  printf '%-10s %-18s %7s %15s %8s %11s\n%s\n\n' run evaluation starts target_reached exposed grasp_held "$rows"
fi
evaluation_s=$(add "$evaluation_s" "$study_s")
printf 'set-up      %8s s\nbuild       %8s s\ntraining    %8s s\nevaluation  %8s s\nreport      %8s s\n' \
  "$setup_s" "$build_s" "$training_s" "$evaluation_s" "$report_s"
echo
for folder in "${folders[@]}"; do say "run      $folder (summary.json, metrics.csv, policy.onnx, checkpoints, recordings)"; done
((report_status == 0)) || fail "the report failed: $(tail -n 1 <<<"$report_line")"
say "report   $run_dir/report.html"

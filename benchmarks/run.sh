#!/usr/bin/env bash
# Prints figures of this machine, one line "name value unit" each, on stdout; everything else goes to stderr.
# See --help. Compare figures of one machine only.
set -uo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bin=${OMENTUM_BIN:-$root/build/release/bin}

usage() {
  cat <<'TEXT'
usage: benchmarks/run.sh [--steps N] [--save] [tissue] [elastic] [compare] [ppo] [workers] [train] [camera] [bus] [security]
                         [monitor] [gateway] [columns] [solve] [terms] [recordings] [explain]

Figures of the groups named (default: tissue elastic ppo workers train):
  tissue    tissue.<scene>.env_steps_per_s: environment steps (20 ms simulated) per second of one core, all of a step
  elastic   tissue.elastic*.env_steps_per_s: elastic shell on one core, physics alone, free, on a mesh, over a sphere and
            on a board, with static errors; cost of lanes of two stiffnesses; tissue.solid.env_steps_per_s: the organ of
            scene omentum_soft alone; tissue.reference.recording_s;
            effect.<name>.cost_ratio: the lift with an effect over that without, effect.solid.<name>.cost_ratio: of an
            elastic solid; and, where libbullet-dev was there at the build or python3 has mujoco, peer.bullet.* and
            peer.mujoco.* of the same lift
  compare   compare.<air or board>.<case>.<E>_mm: elastic shell against the converged reference at rest, rms;
            compare.*.by_<parameter>_percent: difference of the derivatives of the surface
  ppo       ppo.us_per_sample_epoch and, where python3 has torch, the same of ppo.torch_us_per_sample_epoch
  workers   workers.speedup_2_over_1: collecting only, preset paper_literal; two pinned workers against one, taking turns;
            workers.machine_speedup_2_over_1: two systems of one worker each, what the cores can give at that time
  train     train.wall_3M_s (preset paper_literal), train.omentum.wall_3M_s, train.small_buffer.wall_3M_s (preset paper with
            socket buffers of 208 KiB): learner start to last checkpoint, two workers, no evaluation
  bus       bus.steps_per_s: tasks to segments over DDS, nothing simulated, 8 worker processes, 64 slots of 256 steps,
            states of 23,064 bytes; bus.core_share_at_20k: of the learner; bus.weights_p99_ms_8_workers: published to
            received and compared with their hash, workers computing preset paper_literal; bus.throughput_kept_16_workers:
            preset omentum, 256 slots, no updates, 16 workers against 2; bus.updates_ceiling_steps_per_s: what one learner
            of preset omentum learns from workers that need no time
  security  security.cost_percent: preset omentum with updates, two workers, DDS Security on against off, taking turns:
            median of the times per step in 5 rounds
  monitor   monitor.core_share: of `omentum monitor` beside 20 workers while one slot is watched at 10 Hz;
            monitor.frames_per_s: that came
  gateway   gateway.latency_p99_ms (period begins to command handed to the socket, policy included),
            gateway.jitter_p99_ms, gateway.missed_ticks (late by more than 5 ms, or missed), gateway.state_age_p99_ms,
            gateway.machine_stood_still: dvrk_gateway in mode twin against dvrk_double for 60 s beside busy cores
  columns   columns.factor_ms, columns.solve_us_per_column (per step, 40 sites at 24 x 24), columns.case10_60_columns_s:
            10 recordings of 6 s at 24 x 24 with 24 effects and 36 sites, columns.case10_sites_s: with 290 sites at
            16 x 16, columns.overhead_ratio_60: what 60 columns cost over the recording without; of one core
  solve     solve.<preset>.steps, solve.<preset>.wall_s: first greedy evaluation (about every 50,000 steps) that reaches 100 of
            100 starts and exposes at least 95, and that the following two confirm; training alone, two workers; median of
            5 seeds (SOLVE_PRESETS, SOLVE_SEEDS: others than omentum, 5; SOLVE_SETS: knobs to override, "a.b=c d.e=f").
            SOLVE_DEMONSTRATIONS=N: solve.<preset>.demonstrations_N.*, which begins with N episodes of the scripted expert
  terms     terms.<name>.steps_per_s: training of omentum_elastic with one term of a scene at a time, two workers
  recordings  recordings.import_mb_per_s, recordings.import_peak_mb: 300 raw depth images of 640 x 480 into an MCAP file;
            recordings.bag_mb_per_s, recordings.bag_peak_mb: the same from a bag of ROS 2;
            recordings.calibrate_s, recordings.calibrate_paper_s: `mismatch calibrate` by both methods on five lifts of
            another engine, mesh of 0.6 mm, two threads; recordings.held_out_mm, recordings.held_out_paper_mm: mean distance of the
            true surface from that predicted without the pinch point
  explain   explain.null_case_s, explain.case_s: `mismatch explain` on nine stored recordings of another engine, two threads,
            with nothing and with a stiff place concealed; explain.columns_per_s: what one recording would do by one number
  camera    camera.* of bench_camera, where that program is built
Options:
  --steps N   shorter or longer training runs; the figures are then named by N instead of 3M
  --save      also append to benchmarks/results/<cpu>-<n>core.csv with commit, compiler, group, model of the processor and
              load at the start; benchmarks/draw.py makes a page of these files
Programs are those of build/release/bin (OMENTUM_BIN: another folder); deploy/setup.sh builds them, this script its own.
Exit codes: 0 done, 1 a figure could not be measured, 2 wrong option.
TEXT
}

wrong() {
  echo "run.sh: $1 (see --help)" >&2
  exit 2
}
note() { echo "# $*" >&2; }

steps=3000000 save=0 groups=()
while (($#)); do
  case $1 in
    --steps) [[ ${2-} =~ ^[1-9][0-9]{3,10}$ ]] || wrong "--steps needs a number from 1000"; steps=$2; shift ;;
    --save) save=1 ;;
    -h | --help) usage; exit 0 ;;
    tissue | elastic | compare | ppo | workers | train | camera | bus | security | monitor | gateway | columns | solve | terms | recordings | explain) groups+=("$1") ;;
    *) wrong "unknown option or group $1" ;;
  esac
  shift
done
((${#groups[@]})) || groups=(tissue elastic ppo workers train)

scratch=$(mktemp -d) || exit 1
first_core=0
failed=0 children=()
# Ends what this script started, and waits for it.
end_children() {
  ((${#children[@]} == 0)) || kill -TERM "${children[@]}" 2>/dev/null
  local pid
  for pid in "${children[@]}"; do wait "$pid" 2>/dev/null; done
  children=()
}
own_rmem_max=  # of the kernel, while bench_train has another in force
restore_rmem_max() {
  [[ -z $own_rmem_max ]] || sysctl -qw "net.core.rmem_max=$own_rmem_max"
  own_rmem_max=
}
trap 'end_children; restore_rmem_max; rm -rf "$scratch"' EXIT
trap 'exit 130' INT TERM

cpu=$(sed -n 's/^model name[^:]*: *//p' /proc/cpuinfo | head -n 1)
cores=$(nproc)
# Processors of one name differ by half: the model tells them apart.
machine=$(awk -F': *' '/^cpu family/ { f = $2 } /^model\t/ { print "family " f " model " $2; exit }' /proc/cpuinfo)
load=$(cut -d' ' -f1 /proc/loadavg)
commit=$(git -C "$root" rev-parse --short=12 HEAD 2>/dev/null || echo unknown)
[[ -z $(git -C "$root" status --porcelain --untracked-files=no 2>/dev/null) ]] || commit+=+
compiler=$(c++ --version 2>/dev/null | head -n 1 | tr ',' ';')
results=$root/benchmarks/results/$(tr -cs 'A-Za-z0-9' '_' <<<"${cpu:-unknown}" | sed 's/_*$//')-${cores}core.csv
note "cpu=$cpu cores=$cores commit=$commit compiler=$compiler load=$(cut -d' ' -f1-3 /proc/loadavg)"
awk -v cores="$cores" '$1 > 0.5 * cores { exit 1 }' /proc/loadavg || note "other work runs on this machine: the figures will be too low"

# $1 name, $2 value, $3 unit.
figure() {
  echo "$1 $2 $3"
  ((save)) || return 0
  mkdir -p "${results%/*}"
  [[ -s $results ]] || echo "date,commit,compiler,name,value,unit,group,machine,load" >"$results"
  echo "$(date -u +%FT%TZ),$commit,$compiler,$1,$2,$3,$group,$machine,$load" >>"$results"
}
# Passes the lines "name value unit" of a program on; what follows a # is a comment. $@ = command.
figures_of() {
  local name value unit rest status
  "$@" >"$scratch/figures"
  status=$?
  while read -r name value unit rest; do
    if [[ $name == '#'* ]]; then note "${name#'#'} $value $unit $rest"; continue; fi
    [[ $name =~ ^[a-z0-9_.]+$ && $value =~ ^[0-9.e+-]+$ && -n $unit ]] || continue
    figure "$name" "$value" "$unit"
    [[ -z $rest ]] || note "$name ${rest#'# '}"
  done <"$scratch/figures"
  ((status == 0)) || broken "$1 ended with code $status"
}
broken() {
  echo "run.sh: $1" >&2
  failed=1
}
need() {
  # Programs of benchmarks alone are not built by default.
  if [[ $1 == bench_* || $1 == compare_* ]] && [[ $bin == "$root/build/release/bin" ]]; then
    cmake --build "$root/build/release" --target "$1" >&2
  fi
  [[ -x $bin/$1 ]] && return 0
  broken "$bin/$1 is missing: run deploy/setup.sh"
  return 1
}

# A DDS domain whose ports nobody uses and whose lock is free, as in deploy/train.sh. Sets `domain`.
choose_domain() {
  local i
  for ((i = 0; i < 90; ++i)); do
    domain=$((1 + ($$ + i) % 90))
    { exec {lock}>>"/tmp/omentum_test_domain_$domain"; } 2>/dev/null || continue
    flock -n "$lock" && return
    exec {lock}>&-
  done
  broken "no free DDS domain"
  return 1
}

worker_program=("$bin/sim_worker")
security=  # folder of deploy/security/make.sh; empty: none
# One run of the learner and its workers. $1 = workers, $2 = run name, rest = learner options. The log is
# $scratch/<name>.log. With two or more cores worker i sits on core i, counted from $first_core.
run_system() {
  local workers=$1 name=$2 i pin=() status
  shift 2
  choose_domain || return 1
  OMENTUM_SECURITY_DIR=${security:+$security/learner} \
    "$bin/learner" --run "$name" --set "run.runs_dir=$scratch" --set "run.domain=$domain" --set evaluation.enabled=false \
    "$@" >"$scratch/$name.log" 2>&1 &
  local learner=$!
  children=("$learner")
  for ((i = 0; i < workers; ++i)); do
    ((cores < 2)) || pin=(taskset -c "$(((i + first_core) % cores))")
    OMENTUM_SECURITY_DIR=${security:+$security/worker} \
      "${pin[@]}" "${worker_program[@]}" --run "$name" --domain "$domain" >"$scratch/$name.worker$i.log" 2>&1 &
    children+=($!)
  done
  wait "$learner"
  status=$?
  end_children
  exec {lock}>&-
  ((status == 0)) || broken "the learner of $name ended with code $status: $(tail -n 1 "$scratch/$name.log")"
  return "$status"
}

bench_tissue() {
  need bench_tissue || return
  figures_of "$bin/bench_tissue"
}

bench_elastic() {
  need bench_elastic && figures_of "$bin/bench_elastic" 0 "$scratch/lift.txt"
  if [[ -x $bin/peer_bullet ]]; then
    figures_of "$bin/peer_bullet" "$scratch/lift.txt"
  else
    note "libbullet-dev was not there at the build: no peer.bullet.*"
  fi
  if python3 -c 'import mujoco' 2>/dev/null; then
    figures_of python3 "$root/benchmarks/peer_mujoco.py" "$scratch/lift.txt"
  else
    note "mujoco is not installed: no peer.mujoco.*"
  fi
  need bench_reference && figures_of "$bin/bench_reference"
  need bench_effects && figures_of "$bin/bench_effects"
}

bench_compare() {
  need compare_elastic && figures_of "$bin/compare_elastic" air && figures_of "$bin/compare_elastic" board
}

bench_columns() {
  need bench_reference && figures_of "$bin/bench_reference" columns
}

bench_ppo() {
  need bench_ppo || return
  figures_of "$bin/bench_ppo"
  if python3 -c 'import torch' 2>/dev/null; then
    figures_of python3 "$root/benchmarks/torch_ppo.py"
  else
    note "torch is not installed: no ppo.torch_us_per_sample_epoch"
  fi
}

bench_solve() {
  need learner && need sim_worker || return
  local preset
  for preset in ${SOLVE_PRESETS:-omentum}; do
    choose_domain || return
    figures_of python3 "$root/benchmarks/solve.py" "$bin" "$domain" "$preset" "${SOLVE_SEEDS:-5}" \
      --demonstrations "${SOLVE_DEMONSTRATIONS:-0}" ${SOLVE_SETS:+$(printf -- '--set %s ' $SOLVE_SETS)}
    exec {lock}>&-
  done
}

bench_terms() {
  need learner && need sim_worker || return
  choose_domain || return
  figures_of python3 "$root/benchmarks/terms.py" "$bin" "$domain"
  exec {lock}>&-
}

bench_recordings() {
  need mismatch || return
  mkdir -p "$scratch/recordings"
  # Debian's python3-numpy belongs to /usr/bin/python3, whatever else is first on the path.
  figures_of /usr/bin/python3 "$root/benchmarks/recordings.py" "$bin/mismatch" "$scratch/recordings"
}

bench_explain() {
  need mismatch || return
  mkdir -p "$scratch/explain"
  figures_of /usr/bin/python3 "$root/benchmarks/explain_cases.py" "$bin/mismatch" "$scratch/explain"
}

bench_camera() {
  need bench_camera || return
  figures_of "$bin/bench_camera"
}

# $1 = figure, $2 = preset, rest = learner options.
train_wall() {
  local figure_name=$1 preset=$2 wall
  shift 2
  run_system 2 "train_$figure_name" --preset "$preset" --set "rollout.max_steps=$steps" "$@" || return
  wall=$(sed -n 's/.*trained steps=.* wall_s=\([0-9.]*\).*/\1/p' "$scratch/train_$figure_name.log")
  [[ -n $wall ]] || { broken "train_$figure_name: no wall_s in its log"; return; }
  figure "$figure_name" "$wall" s
  note "$figure_name: $(sed -n 's/.*trained \(steps=.*\)/\1/p' "$scratch/train_$figure_name.log")"
}

bench_train() {
  need learner && need sim_worker || return
  local size=$steps
  ((steps % 1000000)) || size=$((steps / 1000000))M
  train_wall "train.wall_${size}_s" paper_literal
  train_wall "train.omentum.wall_${size}_s" omentum
  # What a machine with the kernel's default net.core.rmem_max gives a socket: the kernel's own limit where we may set
  # it, else the limit of the DDS profile (which leaves out the learner's spacing of bursts).
  own_rmem_max=$(sysctl -n net.core.rmem_max)
  if sysctl -qw net.core.rmem_max=212992 2>/dev/null; then
    train_wall "train.small_buffer.wall_${size}_s" paper_literal
    restore_rmem_max
    return
  fi
  own_rmem_max=
  note "net.core.rmem_max cannot be set: the small buffer comes from the DDS profile"
  local small
  small=$(sed 's/max="4MiB"/max="208KiB"/' "$root/deploy/dds/small-buffer.xml")
  [[ $small == *208KiB* ]] || { broken "deploy/dds/small-buffer.xml has no receive buffer to limit"; return; }
  CYCLONEDDS_URI=$small train_wall "train.small_buffer.wall_${size}_s" paper_literal
}

# Steps per second of a collecting run. $1 = workers, $2 = name.
collect_rate() {
  run_system "$1" "$2" --preset paper_literal --set run.updates=false --set rollout.max_steps=120000 && rate_of_run "$2"
}
# The same of two systems of one worker each at the same time, added up: what the machine's two cores give.
collect_rate_apart() {
  local core pids=()
  for core in 0 1; do
    ( trap end_children EXIT
      trap 'exit 130' TERM
      first_core=$core
      collect_rate 1 "$1_$core" >"$scratch/apart_$core" ) &
    pids+=($!)
  done
  children=("${pids[@]}")
  wait "${pids[0]}" && wait "${pids[1]}" || { end_children; return 1; }
  children=()
  echo $(($(<"$scratch/apart_0") + $(<"$scratch/apart_1")))
}

# Steps per second at the end of a run's metrics, without its first batches. $1 = run name.
rate_of_run() {
  awk -F, '
    NR == 1 { for (i = 1; i <= NF; ++i) { if ($i == "wall_time_s") wall = i; if ($i == "charts/steps_total") total = i } }
    NR > 1 { at[++n] = $wall; steps[n] = $total }
    END { if (n < 6 || !wall || !total) exit 1
          printf "%.0f", (steps[n] - steps[3]) / (at[n] - at[3]) }' "$scratch/$1/metrics.csv"
}

bench_bus() {
  need bench_bus && need learner && need sim_worker || return
  local group two sixteen
  for group in loop share weights; do
    choose_domain || return
    figures_of "$bin/bench_bus" "$group" --domain "$domain"
    exec {lock}>&-
  done
  run_system 2 bus_2 --preset omentum --set run.updates=false --set rollout.slots=256 --set rollout.max_steps=600000 &&
    two=$(rate_of_run bus_2) &&
    run_system 16 bus_16 --preset omentum --set run.updates=false --set rollout.slots=256 --set rollout.max_steps=600000 &&
    sixteen=$(rate_of_run bus_16) || { broken "bus.throughput_kept_16_workers"; return; }
  figure bus.throughput_kept_16_workers "$(awk -v a="$sixteen" -v b="$two" 'BEGIN { printf "%.1f", 100 * a / b }')" %
  note "bus.throughput_kept_16_workers: $sixteen steps/s of 16 workers, $two of 2"
  worker_program=("$bin/bench_bus" worker)
  run_system 4 bus_updates --preset omentum --set ppo.check_log_probs=false --set rollout.max_steps=400000 &&
    figure bus.updates_ceiling_steps_per_s "$(rate_of_run bus_updates)" steps/s
  worker_program=("$bin/sim_worker")
}

bench_security() {
  need learner && need sim_worker || return
  "$root/deploy/security/make.sh" --out "$scratch/security" >/dev/null || { broken "security: no certificates"; return; }
  local round name rates
  for round in 1 2 3 4 5; do
    rates=()
    for security in "" "$scratch/security"; do
      name=${security:+secure_}round_$round
      run_system 2 "$name" --preset omentum --set rollout.max_steps=600000 || return
      rates+=("$(rate_of_run "$name")") || { broken "security.cost_percent"; return; }
    done
    awk -v a="${rates[0]}" -v b="${rates[1]}" 'BEGIN { print 100 * (a / b - 1) }' >>"$scratch/rounds"
    note "without ${rates[0]}, with ${rates[1]} steps/s"
  done
  security=
  figure security.cost_percent "$(median 1)" %
}

bench_monitor() {
  need omentum && need learner && need sim_worker || return
  local figures name value
  figures=$("$root/benchmarks/monitor_cost.sh" 30) || { broken "monitor.core_share"; return; }
  while read -r name value; do
    figure "$name" "$value" "$([[ $name == *share ]] && echo cores || echo 1/s)"
  done <<<"$figures"
}

bench_gateway() {
  need dvrk_gateway && need dvrk_double && need learner && need sim_worker || return
  # Figures are printed whatever the verdict, which is that of tests/gateway_soak.sh.
  local verdict
  python3 "$root/tests/dvrk_gateway/gateway_soak.py" "$bin" 60 >"$scratch/gateway" &
  children=($!)
  wait "${children[0]}"
  verdict=$?
  children=()
  note "verdict of tests/gateway_soak.sh: code $verdict"
  # It says itself what refuses SCHED_FIFO.
  [[ -s $scratch/gateway ]] || { broken "gateway.*: could not be measured (gateway_soak.py: code $verdict)"; return; }
  figures_of cat "$scratch/gateway"
}

# $1 = column: its median in the rounds.
median() { awk -v c="$1" '{ print $c }' "$scratch/rounds" | sort -g | awk '{ v[NR] = $1 } END { print (v[int((NR + 1) / 2)] + v[int(NR / 2) + 1]) / 2 }'; }

# One worker, two workers, and two systems that know nothing of each other take turns at the same batches. The speed of
# a core that others share drifts by a fifth within seconds: the ratios are those within a round, of which the median counts.
bench_workers() {
  need learner && need sim_worker || return
  if ((cores < 2)); then broken "workers: two cores are needed"; return; fi
  local round one two apart
  for round in 1 2 3 4 5 6 7 8 9; do
    first_core=$((round % 2))
    collect_rate 1 "one_$round" >"$scratch/one" && collect_rate 2 "two_$round" >"$scratch/two" &&
      collect_rate_apart "apart_$round" >"$scratch/apart" || { broken "workers: no rate in round $round"; return; }
    one=$(<"$scratch/one") two=$(<"$scratch/two") apart=$(<"$scratch/apart")
    awk -v a="$one" -v b="$two" -v c="$apart" 'BEGIN { print a, b, b / a, c / a }' >>"$scratch/rounds"
    note "one worker $one, two $two, two systems apart $apart steps/s"
  done
  first_core=0
  figure workers.steps_per_s_1 "$(median 1)" steps/s
  figure workers.steps_per_s_2 "$(median 2)" steps/s
  figure workers.speedup_2_over_1 "$(median 3)" x
  figure workers.machine_speedup_2_over_1 "$(median 4)" x
}

for group in "${groups[@]}"; do
  note "$group"
  "bench_$group"
done
exit "$failed"

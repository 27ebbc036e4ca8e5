#!/usr/bin/env bash
# Makes the pictures of the pages anew. See --help.
set -euo pipefail

pictures=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
root=$(cd "$pictures/../.." && pwd)
bin=${OMENTUM_BIN:-$root/build/release/bin}

usage() {
  cat <<'TEXT'
usage: docs/pictures/make.sh [-o FOLDER] NAME...

Makes these pictures as FOLDER/NAME.png (default: docs/pictures):
  lift           the live view of `omentum monitor` beside a run (a minute)
  monitor        the head of its page
  workers        its view and its table of workers
  robot          the report of five starts on the arm's double (a minute, after a training)
  contact_sheet  a recording as `mismatch info --contact-sheet` draws it (seconds)
  calibrated     a lift before and after a calibration, out of its report (two minutes)
  verdict        the report of `mismatch explain` on a case of another engine (ten minutes and more)
  results        the page of benchmarks/draw.py (seconds)
Programs are those of build/release/bin (OMENTUM_BIN: another folder). TRAINED_RUN names the run folder of a training that is
there already. Needs chromium, for recordings python3-numpy as well.
TEXT
}

wrong() {
  echo "make.sh: $1 (see --help)" >&2
  exit 2
}

out=$pictures names=()
while (($#)); do
  case $1 in
    -o) (($# > 1)) || wrong "-o needs a folder"; out=$(realpath "$2"); shift ;;
    -h | --help) usage; exit 0 ;;
    lift | monitor | workers | robot | contact_sheet | calibrated | verdict | results) names+=("$1") ;;
    *) wrong "unknown picture $1" ;;
  esac
  shift
done
((${#names[@]})) || { usage >&2; exit 2; }

scratch=$(mktemp -d) children=()
trap '((${#children[@]} == 0)) || kill "${children[@]}" 2>/dev/null || true; wait; rm -rf "$scratch"' EXIT

# Writes $out/$1.png of the page $2, $3 pixels ("1000,400"), when so many ms of its time are over: $4.
shoot() {
  timeout 400 chromium --headless=new --no-sandbox --hide-scrollbars --user-data-dir="$scratch/profile" --use-angle=swiftshader \
    --enable-unsafe-swiftshader --virtual-time-budget="${4:-8000}" --window-size="$3" --screenshot="$out/$1.png" "$2" 2>/dev/null
  ls -l "$out/$1.png"
}

# $1 = picture, $2 = report, $3 = entries of its list of lifts for the two views ("0, 1"), $4 = share of their duration, $5 = turn of
# the wheel that brings them nearer.
shoot_lifts() {
  cp "$2" "$scratch/lifts.html"
  cat >>"$scratch/lifts.html" <<HTML
<script>
addEventListener("load", () => {
  const panes = Array.from(document.querySelectorAll(".pane")), box = panes[0].parentElement, slider = document.getElementById("replay-time");
  panes.forEach((pane, k) => {
    const choice = pane.querySelector("select");
    choice.value = [$3][k];
    choice.dispatchEvent(new Event("change"));
  });
  document.body.replaceChildren(box, slider);
  Object.assign(document.body.style, { margin: "0", padding: "8px", maxWidth: "none" });
  slider.value = $4 * slider.max;
  slider.style.display = "none";
  dispatchEvent(new Event("resize"));
  slider.dispatchEvent(new Event("input"));
  panes[0].querySelector("canvas").dispatchEvent(new WheelEvent("wheel", { deltaY: $5, bubbles: true, cancelable: true }));
});
</script>
HTML
  shoot "$1" "file://$scratch/lifts.html" 1000,385
}

# A trained run of preset omentum; sets `run`.
run=${TRAINED_RUN:-}
train() {
  [[ -z $run ]] || return 0
  OMENTUM_BIN=$bin "$root/deploy/train.sh" --no-setup --set "run.runs_dir=$scratch/runs" >"$scratch/train.log"
  run=$scratch/runs/omentum
}

# A run with its monitor, whose page is $page: learner and two workers, from the policy of a training.
start_monitor() {
  local domain port=$((20000 + $$ % 10000)) worker trained=()
  [[ -z ${page:-} ]] || return 0
  for ((domain = 1 + $$ % 90; ; domain = 1 + domain % 90)); do  # that no test has, as in deploy/train.sh
    exec {lock}>>"/tmp/omentum_test_domain_$domain"
    ! flock -n "$lock" || break
    exec {lock}>&-
  done
  [[ -z $run ]] || trained=(--initialise-from "$run/checkpoints/best.pb")  # so that it lifts at once
  "$bin/learner" --preset omentum --run mine --quiet --set run.domain=$domain --set "run.runs_dir=$scratch/runs" \
    --set rollout.max_steps=100000000 "${trained[@]}" 2>"$scratch/learner.log" &
  children+=($!)
  for worker in 1 2; do
    "$bin/sim_worker" --run mine --domain $domain 2>"$scratch/worker$worker.log" &
    children+=($!)
  done
  "$bin/omentum" monitor --run mine --domain $domain --port $port >"$scratch/monitor.log" &
  children+=($!)
  # Until there are curves, ten minutes at most.
  timeout 600 bash -c 'until (($(wc -l <"$1") > 40)); do sleep 1; done 2>/dev/null' - "$scratch/runs/mine/metrics.csv"
  "$bin/omentum" top --run mine --domain $domain --once
  page=http://127.0.0.1:$port/
}

# $1 = picture, $2 = its width and height, $3 = its left and $4 its upper edge in the page of the monitor, $5 = slot.
shoot_monitor() {
  start_monitor
  local wanted=$out
  out=$scratch
  shoot "whole_$1" "$page#slot=$5" 1180,2900 6000
  out=$wanted
  echo "<body style='margin: 0; overflow: hidden'><img style='margin: -$4px 0 0 -$3px' src='whole_$1.png'>" >"$scratch/part.html"
  shoot "$1" "file://$scratch/part.html" "$2"
}

# The tissue is where the episode is at that moment: again, or another slot, where it is not held.
make_lift() { shoot_monitor lift 820,560 28 1945 3; }

make_monitor() { shoot_monitor monitor 1180,1010 0 0 3; }

make_workers() { shoot_monitor workers 1180,1010 0 1800 9; }

make_robot() {
  train
  mkdir -p "$scratch/robot/runs"
  ln -sfn "$(realpath "$run")" "$scratch/robot/runs/omentum"  # the page names the folder
  # A machine that others use stands still now and then: limits for a double alone.
  printf 'state_age_s: 0.4\nsilence_s: 0.3\ngap_s: 0.3\ntick_gap_s: 0.4\nmissed_actions: 10\n' >"$scratch/robot/limits.txtpb"
  (cd "$scratch/robot" && OMENTUM_BIN=$bin "$root/tests/dvrk_gateway/experiment_on_double.py" --policy runs/omentum --out experiment \
    --starts 5 --limits limits.txtpb)
  shoot robot "file://$scratch/robot/experiment/report.html" 1000,900
}

# Six lifts of a small sheet with a stiff place; the scene of them lacks it.
make_example() {
  [[ -e $scratch/example ]] || /usr/bin/python3 "$root/tests/mismatch/explained_lifts.py" "$bin/mismatch" "$scratch/example" inclusion 6
}

make_contact_sheet() {
  make_example
  "$bin/mismatch" import "$scratch/example/lifts/lift0" -o "$scratch/lift0.mcap"
  "$bin/mismatch" info "$scratch/lift0.mcap" --scene "$scratch/example/believed.txtpb" --contact-sheet "$out/contact_sheet.png"
}

make_calibrated() {
  make_example
  "$bin/mismatch" calibrate --scene "$scratch/example/believed.txtpb" -r "$scratch/example/lifts" -o "$scratch/calibrated" --tolerance-mm 6
  shoot_lifts calibrated "$scratch/calibrated/report.html" "2, 3" 0.98 -450
}

make_verdict() {
  /usr/bin/python3 "$root/tests/mismatch/plants/plants.py" case "$root/tests/mismatch/plants/truths/inclusion_102" --seed 1 --force yes \
    -o "$scratch/case"
  "$bin/mismatch" explain -r "$scratch/case" -o "$scratch/verdict"
  shoot verdict "file://$scratch/verdict/report.html" 1000,1400
}

make_results() {
  python3 "$root/benchmarks/draw.py" "$scratch/drawn"
  grep -e '<!doctype' -e 'run.sh tissue' -e 'run.sh train' "$scratch/drawn/results.html" >"$scratch/drawn/page.html"
  echo '<style>td { white-space: nowrap }</style>' >>"$scratch/drawn/page.html"
  shoot results "file://$scratch/drawn/page.html" 1180,495
}

for name in "${names[@]}"; do "make_$name"; done

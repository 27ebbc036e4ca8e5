#!/usr/bin/env bash
# Prints how long a build takes on this machine, one line "name value unit" each, on stdout; everything else goes to
# stderr. See --help. Compare figures of one machine only, with nothing else running.
set -uo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

usage() {
  cat <<'TEXT'
usage: benchmarks/build.sh [--jobs N]

Clones the last commit into a temporary folder and builds it there without a compiler cache:
  build.programs_s  from nothing to the programs (learner, sim_worker, report, mismatch, solid_mesher); aim 200, at most 300
  build.all_s       programs and tests, from nothing; aim 400, at most 540
  build.gate_s      the same and every test of tests/run.sh, from the clone to the last test; aim 1080, at most 1500
  build.touch_s     after a change in one source of a tissue model, to a sim_worker that runs; at most 25
  --jobs N          compiler processes at a time (default: cores)
Packages must be there (deploy/setup.sh --packages-only). Exit codes: 0 done, 1 the build or a test failed, 2 wrong option.
TEXT
}

wrong() {
  echo "build.sh: $1 (see --help)" >&2
  exit 2
}

jobs=$(nproc)
while (($#)); do
  case $1 in
    --jobs) [[ ${2-} =~ ^[1-9][0-9]*$ ]] || wrong "--jobs needs a number above 0"; jobs=$2; shift ;;
    -h | --help) usage; exit 0 ;;
    *) wrong "unknown option $1" ;;
  esac
  shift
done

scratch=$(mktemp -d) || exit 1
trap 'rm -rf "$scratch"' EXIT
export CCACHE_DISABLE=1
now() { date +%s.%N; }
since() { awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f", b - a }'; }
build() {
  cmake --build "$scratch/omentum/build/release" --parallel "$jobs" "$@" >>"$scratch/log" 2>&1 && return
  tail -n 40 "$scratch/log" >&2
  echo "build.sh: the build failed" >&2
  exit 1
}

git clone --quiet "$root" "$scratch/omentum" >&2 || exit 1
cd "$scratch/omentum" || exit 1
began=$(now)
cmake --preset release >"$scratch/log" 2>&1 || { cat "$scratch/log" >&2; exit 1; }
build --target learner sim_worker report mismatch solid_mesher
programs=$(since "$began")
echo "build.programs_s $programs s"
build
echo "build.all_s $(since "$began") s"
real=$root/../shared/data  # as in tests/run.sh, which is that of the clone here
[[ -n ${OMENTUM_REAL_DATA-} || ! -d $real ]] || export OMENTUM_REAL_DATA=$real
failed=0
tests/run.sh >"$scratch/tests" 2>&1 || failed=1
echo "build.gate_s $(since "$began") s"
tail -n 1 "$scratch/tests" >&2
began=$(now)
echo "// touched" >>sim_worker/shell/shell_tissue.cpp
build --target sim_worker
echo "build.touch_s $(since "$began") s"
build/release/bin/sim_worker --help >/dev/null || exit 1
((failed == 0)) || { grep '(Failed)\|(Timeout)' "$scratch/tests" >&2; exit 1; }

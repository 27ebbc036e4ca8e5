#!/usr/bin/env bash
# The test command: sets the machine up, builds, runs the tests that guard a commit. The last line is
# "N passed, N failed" (", N skipped" may follow). Arguments go to ctest: tests/run.sh -L unit, tests/run.sh -R Mcap.
# --all: also what takes long and guards no commit (docs/tests.md): tests whose label ends in _long.
# OMENTUM_REAL_DATA names the folder of the optional real recordings; tests that need it skip without.
set -uo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
results=$root/build/release/tests.xml

if [[ ${1-} == -h || ${1-} == --help ]]; then
  sed -n '2,5s/^# //p' "${BASH_SOURCE[0]}"
  exit 0
fi
arguments=() excluded='' all=0
while (($#)); do
  case $1 in
    --all) all=1 ;;
    -LE | --label-exclude) excluded=${2-}; (($# < 2)) || shift ;;  # of two, ctest leaves out only what both match
    *) arguments+=("$1") ;;
  esac
  shift
done
((all)) || excluded=${excluded:+$excluded|}'_long$'
[[ -z $excluded ]] || arguments+=(--label-exclude "$excluded")

give_up() {
  echo "run.sh: $1"
  echo "0 passed, 1 failed"
  exit 1
}

if [[ -z ${OMENTUM_REAL_DATA-} && -d $root/../shared/data ]]; then
  OMENTUM_REAL_DATA=$(cd "$root/../shared/data" && pwd)
  export OMENTUM_REAL_DATA
fi

"$root/deploy/setup.sh" || give_up "the set-up or the build failed"
rm -f "$results"
cd "$root" || give_up "no repository"
ctest --preset release --parallel "$(nproc)" --no-tests=error --output-junit "$results" "${arguments[@]}"
status=$?

[[ -s $results ]] || give_up "ctest left no results"
# <testsuite ... tests="N" failures="N" disabled="N" skipped="N" ...>, one attribute per line or not.
count() { tr '\n' ' ' <"$results" | sed -n "s/.*<testsuite [^>]*[[:space:]]$1=\"\([0-9]*\)\".*/\1/p"; }
tests=$(count tests) failed=$(count failures) skipped=$(($(count skipped) + $(count disabled)))
# A test whose program is missing counts as skipped there; it has failed.
lost=$(grep -c '<skipped message="Unable to find executable' "$results")
failed=$((failed + lost)) skipped=$((skipped - lost))
((status == 0 || failed > 0)) || failed=1
line="$((tests - failed - skipped)) passed, $failed failed"
((skipped == 0)) || line+=", $skipped skipped"
echo "$line"
((failed == 0))

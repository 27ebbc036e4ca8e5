#!/usr/bin/env bash
# clang-tidy 14 with the repository's .clang-tidy.
# usage: tests/lint/run_tidy.sh [--all | --since COMMIT | FILE...] [--build DIR]
# Default: sources changed since HEAD. DIR holds compile_commands.json (default build/release, in which sources of tests
# have no command, since they are compiled together; build/asan has one for each).
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
cd "$root" || exit 1
build=build/release files=() since=HEAD all=0
while (($#)); do
  case $1 in
    --all) all=1 ;;
    --since | --build)
      (($# > 1)) || { echo "run_tidy.sh: $1 needs a value" >&2; exit 2; }
      if [[ $1 == --since ]]; then since=$2; else build=$2; fi
      shift
      ;;
    -h | --help) sed -n '2,5s/^# //p' "${BASH_SOURCE[0]}"; exit 0 ;;
    -*) echo "run_tidy.sh: unknown option $1" >&2; exit 2 ;;
    *) files+=("$1") ;;
  esac
  shift
done
[[ -s $build/compile_commands.json ]] || { echo "run_tidy.sh: $build is not configured" >&2; exit 2; }
if ((all)); then
  mapfile -t files < <(git ls-files '*.cpp')
elif ((${#files[@]} == 0)); then
  mapfile -t files < <(git diff --name-only --diff-filter=d "$since" -- '*.cpp')
fi
# Only what the build compiles: fuzz targets of another compiler have no command.
listed=()
for file in "${files[@]}"; do
  if grep -qF "\"$root/${file#"$root"/}\"" "$build/compile_commands.json"; then listed+=("$file"); fi
done
echo "clang-tidy: ${#listed[@]} files"
((${#listed[@]})) || exit 0
# clang does not know these options of g++.
commands=$(mktemp -d)
trap 'rm -rf "$commands"' EXIT
sed -E 's/ -m(move|store)-max=[0-9]+//g; s/ -fpch-preprocess//g; s/ -Winvalid-pch//g; s/ -include [^ ]*cmake_pch\.hxx//g' "$build/compile_commands.json" >"$commands/compile_commands.json"
printf '%s\n' "${listed[@]}" | xargs -P "$(nproc)" -n 1 clang-tidy-14 -p "$commands" --quiet 2> >(grep -v 'warnings generated\|^Suppressed\|^Use -header' >&2)

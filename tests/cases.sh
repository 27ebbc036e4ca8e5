#!/bin/bash
# Tries every case of a folder and prints a line each: the case, what was run on it, the exit code, ok or what is wrong,
# and the first line that was said. A case is a folder, or a file by itself.
#   tests/cases.sh FOLDER            OMENTUM_BIN: folder of the programs, else build/release/bin
#   CASE_SECONDS=120 tests/cases.sh FOLDER   what is not done by then is wrong
# A script can tell that a program ended by itself (no crash, in time), that it refused in one line, and that what it
# wrote can be read again; whether that is what the case's README.md asks for is for people: it is printed below each line
# with --readme. The exit code is the number of cases with something wrong, at most 100.
set -u
readme=
if [ "${1-}" = --readme ]; then
  readme=1
  shift
fi
if [ $# -ne 1 ] || [ ! -d "$1" ]; then
  echo "usage: tests/cases.sh [--readme] FOLDER" >&2
  exit 2
fi
bin=$(realpath "${OMENTUM_BIN:-$(dirname "$0")/../build/release/bin}")
seconds=${CASE_SECONDS:-60}
if [ ! -x "$bin/mismatch" ]; then
  echo "$bin/mismatch: not there; ninja -C build/release mismatch makes it" >&2
  exit 2
fi
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
wrong=0 must=

# run LABEL COMMAND...: runs it within its time; sets code, first (line said) and fault (empty: none).
run() {
  local label=$1
  shift
  timeout --kill-after=5 "$seconds" "$@" >"$scratch/out" 2>"$scratch/err" </dev/null
  code=$?
  first=$(grep -v '^warning: ' "$scratch/err" | head -n 1)
  [ -n "$first" ] || first=$(cat "$scratch/err" "$scratch/out" | head -n 1)
  first=$(printf '%s' "$first" | tr -c '[:print:]' '?' | cut -c 1-200)
  fault=
  case $code in
    0) ;;
    124 | 137) fault="not done in $seconds s" ;;
    1 | 2)
      lines=$(grep -vc '^warning: ' "$scratch/err")
      [ "$lines" -eq 1 ] || fault="refused in $lines lines, needed one"
      ;;
    *) fault="ended by exit code $code" ;;
  esac
  [ -n "$fault" ] || [ "$code" -eq 0 ] || [ -z "$must" ] || fault="its own program wrote this file"
  if [ -n "$fault" ]; then
    wrong=$((wrong + 1))
    printf '%s: %s: exit %d: WRONG: %s: %s\n' "$name" "$label" "$code" "$fault" "$first"
  else
    printf '%s: %s: exit %d: ok: %s\n' "$name" "$label" "$code" "$first"
  fi
}

# What came out of an import: told of, and written as a folder.
look() {
  local made=$1 must=1
  [ -e "$made" ] || return
  for file in "$made" "$made"/*.mcap; do
    [ -f "$file" ] || continue
    run "info $(basename "$file")" "$bin/mismatch" info "$file"
    rm -rf "$scratch/folder"
    run "export $(basename "$file")" "$bin/mismatch" export "$file" -o "$scratch/folder"
  done
}

import() {
  rm -rf "$scratch/made"
  run "import $1" "$bin/mismatch" import "$2" "${@:3}" -o "$scratch/made"
  [ "$code" -eq 0 ] && look "$scratch/made"
}

one_case() {
  local path=$1 found=
  name=$(basename "$path")
  [ -n "$readme" ] && sed 's/^/  /' "$path"/README* 2>/dev/null
  # A mapping file says how its folder is read.
  for map in "$path"/*.txtpb; do
    [ -f "$map" ] && grep -qE '^ *(name|info|set|when|source|ros)\b' "$map" && grep -qE '\b(source|ros) *\{' "$map" || continue
    import "--map $(basename "$map")" "$path" --map "$map"
    found=1
  done
  [ -n "$found" ] && return
  for file in "$path"/* "$path"; do
    [ -f "$file" ] || continue
    case ${file,,} in
      *.tsv)
        [ -x "$bin/dvrk_gateway" ] || continue
        run "convert $(basename "$file")" "$bin/dvrk_gateway" convert "$file" -o "$scratch/log.mcap"
        found=1
        ;;
      *.ply | *.pcd)
        run "scene $(basename "$file")" "$bin/mismatch" scene "$file" -o "$scratch/scene.txtpb"
        found=1
        ;;
      *.bag | *.db3 | *.zstd | *.zst)
        import "$(basename "$file")" "$file"
        found=1
        ;;
      *.mcap) if [ -f "$path" ]; then
        import "$(basename "$file")" "$file"
        found=1
      fi ;;
    esac
  done
  if [ -d "$path" ] && { [ -n "$(find "$path" -maxdepth 1 \( -iname '*.csv' -o -iname '*.mcap' \) -print -quit)" ] || [ -z "$found" ]; }; then
    if [ -n "$(find "$path" -maxdepth 2 \( -iname '*.csv' -o -iname '*.mcap' \) -print -quit)" ]; then
      import "the folder" "$path"
      found=1
    fi
  fi
  [ -n "$found" ] || printf '%s: nothing that this script runs (a mesh, a scene or a program): see its README.md\n' "$name"
}

for path in "$1"/*; do
  [ -e "$path" ] || continue
  case $(basename "$path") in README*) continue ;; esac
  one_case "$path"
done
echo "$wrong wrong"
exit $((wrong > 100 ? 100 : wrong))

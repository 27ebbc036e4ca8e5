#!/usr/bin/env bash
# Takes a stored case of another engine, in which something is concealed, to its verdict. See --help.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

usage() {
  cat <<'TEXT'
usage: deploy/explain_demo.sh [--case NAME] [-o OUT] [--no-setup]

Makes camera recordings from a stored simulation of another engine, lets `mismatch explain` say what the believed scene leaves out,
and only then tells what was concealed.
  --case NAME    inclusion_102 (default), null_101, in which nothing is concealed, or another of tests/mismatch/plants/truths
  -o OUT         new folder for the case and the verdict (default: runs/explain_demo)
  --no-setup     take build/release as it is
Exit codes: 0 done, 1 failed, 2 wrong input.
TEXT
}

wrong() {
  echo "explain_demo.sh: $1 (see --help)" >&2
  exit 2
}

name=inclusion_102 out=$root/runs/explain_demo setup=1
while (($#)); do
  case $1 in
    --case) (($# > 1)) || wrong "--case needs a name"; name=$2; shift ;;
    -o) (($# > 1)) || wrong "-o needs a folder"; out=$2; shift ;;
    --no-setup) setup=0 ;;
    -h | --help) usage; exit 0 ;;
    *) wrong "unknown option $1" ;;
  esac
  shift
done
plants=$root/tests/mismatch/plants
truth=$plants/truths/$name
[[ $name != */* && -d $truth ]] || wrong "--case $name: one of $(cd "$plants/truths" && echo *)"
[[ ! -e $out ]] || wrong "-o $out: is there already"

if ((setup)); then
  "$root/deploy/setup.sh" --packages-only
  cmake --preset release -S "$root" >/dev/null
  cmake --build "$root/build/release" --target mismatch
fi
mkdir -p "$out"
/usr/bin/python3 "$plants/plants.py" case "$truth" --seed 1 --force no -o "$out/case" >/dev/null
"$root/build/release/bin/mismatch" explain -r "$out/case" -o "$out/verdict"
/usr/bin/python3 - "$truth/truth.json" <<'PYTHON'
import json, sys
truth = json.load(open(sys.argv[1]))
said = [f"{key} {value:.4g}" for key, value in truth["parameters"].items() if isinstance(value, (int, float))]
place = truth["where"].get("centre_m")
if place:
    said.append(f"at x {1e3 * place[0]:.1f}, y {1e3 * place[1]:.1f} mm")
print(f"concealed was: {truth['effect']}" + (": " + ", ".join(said) if said else ""))
PYTHON
echo "$out/verdict/report.html"

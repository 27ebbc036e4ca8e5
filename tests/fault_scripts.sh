#!/usr/bin/env bash
# Random scripts of faults against the gateway's safety function: tests/fault_scripts.sh [N=1000000] [FIRST=0]
# A script can be run again by its number. Last line scripts=N armed=A unsafe=U reasons=R/T; exit code 1 when U > 0,
# R < T or A < N / 20.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [[ ${1-} == -h || ${1-} == --help ]]; then
  sed -n '2,4s/^# //p' "${BASH_SOURCE[0]}"
  exit 0
fi
exec "${OMENTUM_BIN:-$root/build/release/bin}/fault_scripts" "${1:-1000000}" "${2:-0}"

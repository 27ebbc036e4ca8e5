#!/usr/bin/env bash
# Random sequences of what careless users and strangers do to a training, on the real programs:
#   tests/hostile.sh [SEQUENCES=200] [FIRST_SEED=1]
# A sequence can be run again by its seed. Exit code 1 when one of them broke a promise (tests/hostile/sequences.py).
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [[ ${1-} == -h || ${1-} == --help ]]; then
  sed -n '2,4s/^# //p' "${BASH_SOURCE[0]}"
  exit 0
fi
exec python3 "$root/tests/hostile/sequences.py" "${OMENTUM_BIN:-$root/build/release/bin}" "${1:-200}" "${2:-1}"

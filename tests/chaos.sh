#!/usr/bin/env bash
# Faults on real processes, one row each: tests/chaos.sh [--short] [NAME ...]; without names every row. Prints per row
# "name ok|failed|skipped detail"; exit code 1 when one failed. --short: fewer and shorter faults, no containers.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [[ ${1-} == -h || ${1-} == --help ]]; then
  sed -n '2,3s/^# //p' "${BASH_SOURCE[0]}"
  exit 0
fi
exec python3 "$root/tests/chaos/chaos.py" "${OMENTUM_BIN:-$root/build/release/bin}" "$@"

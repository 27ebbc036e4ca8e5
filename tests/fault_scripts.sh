#!/usr/bin/env bash
# Random scripts of faults against the gateway: tests/fault_scripts.sh [N=1000000] [FIRST=0]  its safety function alone
#   tests/fault_scripts.sh --gateway N [FIRST=0]    all of it, in simulated time
#   tests/fault_scripts.sh --processes N [FIRST=0]  the running programs, on this machine's clock
# A script can be run again by its number. Last line scripts=N armed=A unsafe=U reasons=R/T; exit code 1 when U > 0,
# R < T or A < N / 20.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bin=${OMENTUM_BIN:-$root/build/release/bin}
case ${1-} in
  -h | --help) sed -n '2,6s/^# //p' "${BASH_SOURCE[0]}" ;;
  --gateway) exec "$bin/gateway_scripts" "${2:-1000}" "${3:-0}" ;;
  --processes) exec python3 "$root/tests/dvrk_gateway/fault_processes.py" "$bin" "${2:-100}" "${3:-0}" ;;
  *) exec "$bin/fault_scripts" "${1:-1000000}" "${2:-0}" ;;
esac

#!/usr/bin/env bash
# The gateway's periods against the double beside busy cores: tests/gateway_soak.sh [SECONDS=600 [RUN]]
# RUN: folder of a trained run, else a policy of a few updates. PEER_PYTHON: a Python with mcap and mcap-protobuf-support, by
# which each late period is held against the moments at which the machine itself stood still.
# Prints figures as "name value unit". Exit code 1: a period was late by more than 5 ms or missed, the arm was stopped, the
# p99 of the latency is above 2 ms, or memory grew; 77, no verdict: no SCHED_FIFO, or the machine itself stood still.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
if [[ ${1-} == -h || ${1-} == --help ]]; then
  sed -n '2,6s/^# //p' "${BASH_SOURCE[0]}"
  exit 0
fi
exec "${PEER_PYTHON:-python3}" "$root/tests/dvrk_gateway/gateway_soak.py" "${OMENTUM_BIN:-$root/build/release/bin}" "${1:-600}" "${@:2:1}"

#!/usr/bin/env bash
# Where SCHED_FIFO is refused, as in a plain container, the soak ends at once and says why it cannot measure.
set -u
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
refuse=()
if ((EUID == 0)); then
  command -v setpriv >/dev/null || exit 77
  refuse=(setpriv --bounding-set=-sys_nice --inh-caps=-sys_nice)
fi
told=$(ulimit -r 0 && timeout 20 "${refuse[@]}" python3 "$here/gateway_soak.py" "${OMENTUM_BIN:?}" 5 2>&1)
code=$?
[[ $code == 77 && $told == *"SCHED_FIFO is refused here"* ]] && exit 0
echo "code $code: $told" >&2
exit 1

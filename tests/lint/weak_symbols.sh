#!/usr/bin/env bash
# Objects compiled for AVX-512 define no weak symbol: the linker keeps one copy of such a symbol, and a machine without
# AVX-512 might run it. Arguments: object files.
set -uo pipefail
failed=0
(($#)) || { echo "no object given"; exit 1; }
for object in "$@"; do
  symbols=$(nm -C --defined-only "$object") || exit 1
  [[ -n $symbols ]] || { echo "$object: no symbols at all"; failed=1; }
  # W, V: weak; u: unique; lower-case w and v are undefined ones and not listed here.
  weak=$(grep -E ' [WVu] ' <<<"$symbols")
  [[ -z $weak ]] || { printf '%s defines weak symbols:\n%s\n' "$object" "$weak"; failed=1; }
done
((failed)) || echo "$# objects define no weak symbol"
exit "$failed"

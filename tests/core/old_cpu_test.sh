#!/usr/bin/env bash
# Every program on a CPU without AVX2: one line, exit code 2, no illegal instruction. On one with it: it runs.
# Usage: old_cpu_test.sh <program>...; 77 where qemu-user is missing.
set -uo pipefail
emulator=$(command -v qemu-x86_64) || { echo "qemu-x86_64 is not installed"; exit 77; }
bad=0
for program in "$@"; do
  name=$(basename "$program")
  for cpu in Nehalem Opteron_G5; do  # the second has FMA and AVX, but no AVX2
    output=$("$emulator" -cpu "$cpu" "$program" --help 2>&1)
    code=$?
    lines=$(grep -v '^qemu-x86_64: warning' <<<"$output")
    if [[ $code != 2 || $(wc -l <<<"$lines") != 1 || $lines != "$name: this CPU lacks AVX"* ]]; then
      echo "$name on $cpu: exit code $code, said: $output"
      bad=1
    fi
  done
  if ! "$emulator" -cpu Haswell "$program" --help >/dev/null 2>&1; then
    echo "$name on Haswell: --help failed with $?"
    bad=1
  fi
done
exit $bad

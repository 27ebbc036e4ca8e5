#!/usr/bin/env bash
# Every tracked C++ file is as clang-format 14 writes it. Argument: repository root.
set -uo pipefail
cd "$1" || exit 1
command -v clang-format-14 >/dev/null || { echo "clang-format-14 is not installed"; exit 77; }
git rev-parse --git-dir >/dev/null 2>&1 || { echo "not a git checkout: nothing is tracked"; exit 77; }
mapfile -t files < <(git ls-files -- '*.h' '*.cpp' '*.inl' | while read -r file; do [[ ! -f $file ]] || echo "$file"; done)
((${#files[@]})) || { echo "no C++ file is tracked"; exit 1; }
printf '%s\n' "${files[@]}" | xargs -P "$(nproc)" -n 20 clang-format-14 --dry-run -Werror

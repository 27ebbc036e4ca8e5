#!/usr/bin/env bash
# Wrong input of the commands: exit code 2 and one line that names what is wrong. Argument: repository root.
set -uo pipefail
root=$1
failed=0
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
refuses() {  # $1 = what the line must contain, rest = command
  local want=$1 text status
  shift
  text=$("$@" 2>&1 >/dev/null)
  status=$?
  if ((status != 2)) || (($(wc -l <<<"$text") != 1)) || [[ $text != *"$want"* ]]; then
    echo "${*#"$root"/}: code $status, expected 2 and one line with \"$want\", got: $text"
    failed=1
  fi
}
train=$root/deploy/train.sh
refuses "unknown option --bogus" "$train" --bogus
refuses "--steps needs a value" "$train" --steps
refuses "--steps 0" "$train" --steps 0
refuses "--steps 1.5" "$train" --steps 1.5
refuses "--steps 1" "$train" --steps 1e99
refuses "there is no" "$train" --no-setup --steps 1e6 --run no_such_run --resume
refuses "--seeds -1" "$train" --seeds -1
refuses "--workers none" "$train" --workers none
for name in ../x -x .x 'a b' 'a*' a=b "$(printf 'a%.0s' {1..101})"; do
  refuses "--run $name: 1 to 100 of A-Z a-z 0-9 _ - . and neither - nor . first" "$train" --run "$name"
done
refuses "--set ppo.gamma" "$train" --set ppo.gamma
refuses "paper_swapped" "$train" --preset nothing
refuses "not --steps=3" "$train" --steps=3
refuses "ppo.gamma" "$train" --no-setup --set ppo.gamma=7
refuses "--resume: there is no" "$train" --no-setup --run no_such_run --resume
never=("$train" --no-setup --run never --set run.runs_dir="$scratch/runs")
refuses "run.domain: 900, allowed" "${never[@]}" --set run.domain=900
refuses "scene.target_m: coordinate x is 0.5 m, allowed" "${never[@]}" --set 'scene.target_m={ x: 0.5 }'
refuses "organ.stl" "${never[@]}" --set 'scene.rigid_body={ name: "organ" mesh { path: "/nowhere/organ.stl" } }'
[[ ! -e $scratch/runs ]] || { echo "a refused run left a folder"; failed=1; }
refuses "unknown option" "$root/deploy/setup.sh" --bogus
refuses "--jobs" "$root/deploy/setup.sh" --jobs many
refuses "unknown option or group" "$root/benchmarks/run.sh" everything
"$train" --version | grep -q "^omentum [0-9].*, revision .*, build [0-9a-f]\{16\}$" || { echo "train.sh --version"; failed=1; }
for program in deploy/train.sh deploy/setup.sh benchmarks/run.sh tests/run.sh; do
  "$root/$program" --help | grep -q . || { echo "$program --help is silent"; failed=1; }
done
((failed)) || echo "every wrong input is refused in one line"
exit "$failed"

#!/bin/bash
# tests/cases.sh on cases that are good, refused, hang and crash, with programs that do so.   cases_script_test.sh BIN
set -eu
script=$(realpath "$(dirname "$0")/../cases.sh")
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
mkdir -p "$folder/cases/good" "$folder/cases/refused" "$folder/cases/pipe"
printf 't_s,fx_N,fy_N,fz_N\n0,1,2,3\n1,1,2,3\n' >"$folder/cases/good/force.csv"
printf 't_s,fx_N\n0,1\n' >"$folder/cases/refused/force.csv"
mkfifo "$folder/cases/pipe/force.csv"
said=$(OMENTUM_BIN=$1 "$script" "$folder/cases") || true
grep -q '^good: import the folder: exit 0: ok: ' <<<"$said"
grep -q '^good: export ' <<<"$said"
grep -q '^refused: import the folder: exit 2: ok: mismatch: .*without fy_N' <<<"$said"
grep -q '^pipe: import the folder: exit 2: ok: mismatch: .*force.csv: cannot be opened: a pipe' <<<"$said"
grep -q '^0 wrong$' <<<"$said"
# Programs that hang, crash, or refuse in two lines.
mkdir "$folder/bin"
printf '#!/bin/bash\ncase $2 in *good*) sleep 100 ;; *) kill -SEGV $$ ;; esac\n' >"$folder/bin/mismatch"
chmod +x "$folder/bin/mismatch"
said=$(CASE_SECONDS=1 OMENTUM_BIN=$folder/bin "$script" "$folder/cases") && exit 1
grep -q '^good: .*WRONG: not done in 1 s' <<<"$said"
grep -q '^refused: .*WRONG: ended by exit code 139' <<<"$said"
grep -q '^3 wrong$' <<<"$said"
"$script" 2>/dev/null && exit 1
echo good

#!/usr/bin/env bash
# What containers are told: /tmp can be written under docker-compose and docker stack deploy alike, and a program that
# cannot show that it goes on does not count as healthy. usage: containers_test.sh SOURCE_DIR
set -uo pipefail
root=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
failed=0
expect() { # code, what, heartbeat
  OMENTUM_HEARTBEAT=$3 "$root/docker/health.sh" >/dev/null
  local code=$?
  ((code == $1)) || { echo "$2: code $code, expected $1"; failed=1; }
}
expect 0 "not begun yet" "$folder/heartbeat"
touch "$folder/heartbeat"
expect 0 "beats" "$folder/heartbeat"
touch -d '1 minute ago' "$folder/heartbeat"
expect 1 "hangs" "$folder/heartbeat"
expect 1 "no folder for it" "$folder/none/heartbeat"
for file in "$root"/deploy/*.yaml; do
  ! grep -nE '^ *tmpfs:' "$file" || { echo "$file: docker stack deploy ignores tmpfs: in its short form"; failed=1; }
  # An anchor's list is not joined with a service's own.
  while read -r line; do
    [[ $line == *"target: /tmp"* ]] || { echo "$file: $line has no /tmp"; failed=1; }
  done < <(grep -E '^ +volumes:' "$file")
done
exit $failed

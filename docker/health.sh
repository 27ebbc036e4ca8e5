#!/bin/bash
# Health of a container: the program touches $OMENTUM_HEARTBEAT from its main loop. Until it does so for the first time
# it counts as healthy while it runs, where it can do so at all.
set -u
folder=$(dirname "$OMENTUM_HEARTBEAT")
[[ -w $folder ]] || { echo "$folder cannot be written: no heartbeat would show whether the program hangs"; exit 1; }
[[ -e $OMENTUM_HEARTBEAT ]] || exit 0
age=$(($(date +%s) - $(stat -c %Y "$OMENTUM_HEARTBEAT")))
((age < 30)) || { echo "no heartbeat for $age s"; exit 1; }

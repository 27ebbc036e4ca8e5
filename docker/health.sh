#!/bin/bash
# Health of a container: the program touches $OMENTUM_HEARTBEAT from its main loop. Until it does so for the first time
# it counts as healthy while it runs.
set -u
[[ -e $OMENTUM_HEARTBEAT ]] || exit 0
age=$(($(date +%s) - $(stat -c %Y "$OMENTUM_HEARTBEAT")))
((age < 30)) || { echo "no heartbeat for $age s"; exit 1; }

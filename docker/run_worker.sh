#!/bin/bash
# A worker's container. Options are sim_worker's. A worker that ends in another way than told is started again here:
# docker-compose --exit-code-from ends everything with the first container that ends. For the same reason a worker whose
# run is over stays until the learner's container, which writes the report, is gone.
set -u
stopped=0 pid=''
trap 'stopped=1; [[ -z $pid ]] || kill -TERM "$pid" 2>/dev/null' TERM INT
pause=1
while ((!stopped)); do
  born=$SECONDS
  sim_worker "$@" &
  pid=$!
  wait "$pid"
  status=$?
  while kill -0 "$pid" 2>/dev/null; do wait "$pid"; status=$?; done
  pid=''
  rm -f "${OMENTUM_HEARTBEAT-}"
  ((!stopped)) || exit 0
  if ((status == 0)); then
    while ((!stopped)) && getent hosts "${OMENTUM_HUB:-none}" >/dev/null; do sleep 1 & wait $!; done
    exit 0
  fi
  if ((status == 2)); then exit 2; fi  # the same again would end the same way
  if ((SECONDS - born >= 60)); then pause=1; fi
  echo "sim_worker: ended with code $status, again in $pause s" >&2
  sleep "$pause" & wait $!
  pause=$((pause < 30 ? 2 * pause : 30))
done

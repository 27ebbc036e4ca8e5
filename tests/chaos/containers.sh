# Chaos rows of containers, to be sourced: compose and swarm. A row gets $BIN (folder of the programs) and $SCRATCH (a
# folder of its own), prints one line and returns 0, 1 (failed) or 77 (skipped).
# shellcheck shell=bash

containers_root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
# shellcheck source=tests/chaos/security.sh
. "$containers_root/tests/chaos/security.sh"

# What both rows need: folder, image, keys and the variables of compose.yaml. Sets calm, the hash of an undisturbed run
# without containers. Ends the row where something is missing.
containers_begin() {  # $1 = row, $2 = steps
  local options='' set
  docker info >/dev/null 2>&1 || { echo "no Docker daemon answers"; exit 77; }
  ((EUID == 0)) || { echo "needs root: the keys are given to the group of the containers"; exit 77; }
  security_folder=$SCRATCH/$1
  mkdir -p "$security_folder" && security_take_domain || { echo "no folder or no free domain"; exit 1; }
  calm=$(security_calm_hash "$2")
  "$containers_root/docker/from_build.sh" --bin "$BIN" --tag omentum-chaos >"$security_folder/image" 2>&1 ||
    { echo "no image: $(tail -n 1 "$security_folder/image")"; exit 77; }
  "$containers_root/deploy/security/make.sh" --out "$security_folder/security" --group 10001 \
    >"$security_folder/keys" 2>&1 || { tail -n 1 "$security_folder/keys"; exit 1; }
  for set in "${security_task[@]}" "rollout.max_steps=$2" run.checkpoint_interval_s=1; do options+=" --set $set"; done
  export OMENTUM_IMAGE=omentum-chaos OMENTUM_SECURITY=$security_folder/security OMENTUM_OPTIONS=$options
}
# Waits up to $1 seconds until the output of `docker $2...` holds the last argument.
containers_wait_for() {
  local tries=$1 text=${*: -1}
  set -- "${@:2:$#-2}"
  # `docker service logs` of a task that has ended may not return.
  until grep -q -- "$text" <(timeout 10 docker "$@" 2>&1); do
    ((tries-- > 0)) || return 1
    sleep 1
  done
}
# End of a row: what the container $1 left on the volume is the undisturbed result; $2 = what to say then.
containers_judge() {
  local hash
  docker cp "$1:/runs/omentum" "$security_folder/omentum" >/dev/null && [[ -s $security_folder/omentum/report.html ]] ||
    { echo "no report on the volume"; return 1; }
  docker logs "$1" >"$security_folder/omentum.learner" 2>&1
  security_balanced omentum || { echo "ledger: $(grep -o 'ledger .*' "$security_folder/omentum.learner")"; return 1; }
  hash=$(sed -n 's/.*"weights_hash": "\(.*\)".*/\1/p' "$security_folder/omentum/summary.json")
  [[ -n $calm && $hash == "$calm" ]] || { echo "weights $hash instead of $calm"; return 1; }
  echo "$2, report on the volume, ledger balanced, weights ${hash:0:8} as undisturbed"
}
compose() { docker-compose -p "$project" -f "$containers_root/deploy/compose.yaml" "$@" 2>>"$security_folder/log"; }

# A training in containers with security on: a worker is killed, another one added; the learner ends with code 0, its
# workers leave, the report is on the volume.
row_compose() (
  command -v docker-compose >/dev/null || { echo "no docker-compose"; exit 77; }
  containers_begin compose 400000
  project=omentumchaos$$
  trap 'compose down -v -t 1 >/dev/null' EXIT
  compose up -d --scale sim_worker=2 >/dev/null || { echo "compose up: $(tail -n 1 "$security_folder/log")"; exit 1; }
  learner=$(compose ps -q learner)
  containers_wait_for 60 logs "$learner" 'update 20/' ||
    { echo "no training: $(docker logs "$learner" 2>&1 | tail -n 1)"; exit 1; }
  docker kill "$(compose ps -q sim_worker | head -n 1)" >/dev/null || { echo "no worker to kill"; exit 1; }
  containers_wait_for 30 logs "$learner" event=worker_lost || { echo "the killed worker was not noticed"; exit 1; }
  compose up -d --no-recreate --scale sim_worker=3 >/dev/null || { echo "no worker could be added"; exit 1; }
  code=$(timeout 300 docker wait "$learner")
  [[ $code == 0 ]] || { echo "learner ended with ${code:-nothing}: $(docker logs "$learner" 2>&1 | tail -n 1)"; exit 1; }
  # One that was added too late to meet the learner goes on waiting for it.
  left=0
  for worker in $(compose ps -q sim_worker); do
    if [[ $(timeout 20 docker wait "$worker") == 0 ]]; then ((++left)); fi
  done
  ((left >= 2)) || { echo "$left workers left in peace"; exit 1; }
  containers_judge "$learner" "one of two workers killed, others added, $left left"
)

# A stack on a swarm of this machine: the learner's container is killed, its task replaced at another address.
row_swarm() (
  [[ $(docker info --format '{{.Swarm.LocalNodeState}}' 2>/dev/null) == inactive ]] ||
    { echo "no Docker daemon that is in no swarm yet"; exit 77; }
  containers_begin swarm 300000
  docker swarm init --advertise-addr 127.0.0.1 >/dev/null 2>"$security_folder/log" ||
    { echo "no swarm: $(tail -n 1 "$security_folder/log")"; exit 77; }
  stack=omentumchaos$$
  end_swarm() {
    docker stack rm "$stack"
    while [[ -n $(docker ps -q -f "name=${stack}_") ]]; do sleep 1; done
    docker swarm leave --force
    docker ps -aq -f "name=${stack}_" | xargs -r docker rm
    docker volume rm "${stack}_runs"
  }
  trap 'end_swarm >/dev/null 2>&1' EXIT
  docker node update --label-add omentum.learner=yes "$(docker node ls -q)" >/dev/null
  docker stack deploy -c "$containers_root/deploy/compose.yaml" "$stack" >"$security_folder/log" 2>&1 ||
    { echo "stack deploy: $(tail -n 1 "$security_folder/log")"; exit 1; }
  containers_wait_for 90 service logs "${stack}_learner" 'update 20/' || { echo "no training"; exit 1; }
  docker kill "$(docker ps -q -f "name=${stack}_learner")" >/dev/null || { echo "no learner to kill"; exit 1; }
  containers_wait_for 120 service logs "${stack}_learner" report.html ||
    { echo "not finished: $(docker service logs "${stack}_learner" 2>&1 | tail -n 1)"; exit 1; }
  learner=$(docker ps -aq -f "name=${stack}_learner" -f exited=0 | head -n 1)
  [[ -n $learner ]] || { echo "no learner ended with code 0"; exit 1; }
  containers_judge "$learner" "learner killed, its task replaced"
)

#!/usr/bin/env bash
# Makes the image from programs that are built already. See --help.
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bin=$root/build/release/bin tag=omentum
usage() {
  cat <<'TEXT'
usage: docker/from_build.sh [--bin FOLDER] [--tag NAME]

Makes the image of docker/Dockerfile from programs built on this machine (Debian 12), without compiling.
  --bin FOLDER   default: build/release/bin
  --tag NAME     default: omentum
TEXT
}
while (($#)); do
  case $1 in
    --bin) bin=${2:?--bin needs a folder}; shift ;;
    --tag) tag=${2:?--tag needs a name}; shift ;;
    -h | --help) usage; exit 0 ;;
    *) echo "from_build.sh: unknown option $1 (see --help)" >&2; exit 2 ;;
  esac
  shift
done
for program in learner sim_worker solid_mesher report; do
  [[ -x $bin/$program ]] || { echo "from_build.sh: $bin/$program is missing: run deploy/setup.sh" >&2; exit 2; }
done
export DOCKER_BUILDKIT=0
if ! docker image inspect debian:bookworm-slim >/dev/null 2>&1; then
  docker pull -q debian:bookworm-slim || "$root/docker/base.sh"
fi
context=$(mktemp -d)
trap 'rm -rf "$context"' EXIT
mkdir "$context/docker"
cp "$root/docker/packages.txt" "$context/docker/"
docker build -q -t "$tag:runtime" --target runtime -f "$root/docker/Dockerfile" "$context"
"$root/docker/collect.sh" "$bin" "$context/omentum"
printf 'FROM %s:runtime\nCOPY omentum /opt/omentum\nCMD ["learner", "--help"]\n' "$tag" >"$context/Dockerfile"
docker build -q -t "$tag" "$context"
echo "made image $tag"

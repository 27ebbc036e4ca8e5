#!/usr/bin/env bash
# Puts what an image holds into a folder: docker/collect.sh BIN FOLDER
set -euo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
bin=$1 out=$2
mkdir -p "$out/bin"
for program in learner sim_worker solid_mesher report; do
  install -m 755 "$bin/$program" "$out/bin/"
done
for program in mismatch omentum dvrk_gateway dvrk_double; do  # where they were built
  if [[ -x $bin/$program ]]; then install -m 755 "$bin/$program" "$out/bin/"; fi
done
strip --strip-debug "$out"/bin/*
cp -r "$root/docker" "$out/docker"
mkdir "$out/deploy"
cp -r "$root"/deploy/{presets,scenes,common.txtpb} "$out/deploy/"
chmod -R a+rX "$out"

#!/usr/bin/env bash
# Makes the image debian:bookworm-slim with debootstrap, for machines that reach a Debian mirror and no registry.
# Needs root and the package debootstrap. MIRROR=URL names another mirror than debootstrap's own.
set -euo pipefail
if ((EUID != 0)); then echo "base.sh: needs root: sudo docker/base.sh" >&2; exit 2; fi
command -v debootstrap >/dev/null || { echo "base.sh: debootstrap is missing: apt-get install debootstrap" >&2; exit 2; }
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
debootstrap --variant=minbase bookworm "$folder/root" ${MIRROR:+"$MIRROR"} >"$folder/log" 2>&1 ||
  { tail -n 3 "$folder/log" >&2; echo "base.sh: debootstrap failed" >&2; exit 1; }
# What the official image leaves out.
rm -rf "$folder/root"/var/cache/apt/archives/*.deb "$folder/root"/var/lib/apt/lists/* \
  "$folder/root"/usr/share/{doc,man,locale,info}/*
tar -C "$folder/root" -c . | docker import -c 'CMD ["bash"]' - debian:bookworm-slim

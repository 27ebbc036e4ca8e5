#!/usr/bin/env bash
# Makes a Debian 12 machine ready: installs the packages that are missing, then configures and builds the release
# preset. Idempotent, and silent about apt when nothing is missing. See --help.
set -euo pipefail

root=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)

# What the programs need to build and run.
program_packages=(build-essential cmake ninja-build pkg-config git ccache libeigen3-dev cyclonedds-dev
  cyclonedds-tools libprotobuf-dev protobuf-compiler libspdlog-dev libfmt-dev libosmesa6-dev libcli11-dev
  libcpp-httplib-dev libpng-dev liblz4-dev libzstd-dev zlib1g-dev libssl-dev openssl libonnx-dev
  libnglib-dev nlohmann-json3-dev libzip-dev)
# What the tests need on top: their framework, the checkers, and the peers that read our files.
test_packages=(libgtest-dev libgmock-dev procps clang-format-14 clang-tidy-14 python3 python3-numpy python3-onnx
  chromium iproute2 qemu-user prometheus)

usage() {
  cat <<'TEXT'
usage: deploy/setup.sh [--no-tests] [--packages-only] [--jobs N]

Installs what a Debian 12 machine lacks (needs root or sudo only then) and builds Omentum into build/release.
  --no-tests        only what learner, sim_worker, report and omentum need, and only these four programs
  --packages-only   install, do not build
  --jobs N          compiler processes at a time (default: cores, less where memory is short)
  --times FILE      also write setup_s=... and build_s=... to FILE
Exit codes: 0 done, 1 packages or build failed, 2 wrong option.
TEXT
}

wrong() {
  echo "setup.sh: $1 (see --help)" >&2
  exit 2
}
say() { echo "setup: $*"; }

tests=1 build=1 jobs='' times=''
while (($#)); do
  case $1 in
    --no-tests) tests=0 ;;
    --packages-only) build=0 ;;
    --jobs) [[ ${2-} =~ ^[1-9][0-9]*$ ]] || wrong "--jobs needs a number above 0"; jobs=$2; shift ;;
    --times) [[ -n ${2-} ]] || wrong "--times needs a file"; times=$2; shift ;;
    -h | --help) usage; exit 0 ;;
    *) wrong "unknown option $1" ;;
  esac
  shift
done

now() { date +%s.%N; }
since() { awk -v a="$1" -v b="$(now)" 'BEGIN { printf "%.1f", b - a }'; }

# Packages of the list that are not installed.
missing_packages() {
  local package
  for package in "$@"; do
    [[ $(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null) == installed ]] || echo "$package"
  done
}

install_packages() {
  local wanted=("${program_packages[@]}") missing=() as_root=()
  ((tests)) && wanted+=("${test_packages[@]}")
  if ! command -v dpkg-query >/dev/null; then
    say "this is not Debian: install the equivalents of ${wanted[*]} yourself; going on"
    return
  fi
  mapfile -t missing < <(missing_packages "${wanted[@]}")
  if ((${#missing[@]} == 0)); then
    say "every package is there"
    return
  fi
  say "installing ${#missing[@]} packages: ${missing[*]}"
  if ((EUID != 0)); then
    if ! command -v sudo >/dev/null; then
      echo "setup.sh: neither root nor sudo; as root: apt-get install ${missing[*]}" >&2
      exit 1
    fi
    as_root=(sudo)
  fi
  local apt=(env DEBIAN_FRONTEND=noninteractive apt-get -q -y -o Dpkg::Use-Pty=0)
  "${as_root[@]}" "${apt[@]}" update || say "apt-get update failed; trying with the lists there are"
  if ! "${as_root[@]}" "${apt[@]}" install --no-install-recommends "${missing[@]}"; then
    echo "setup.sh: apt-get could not install: ${missing[*]}" >&2
    exit 1
  fi
}

# Cores, but no more than one job per 1.2 GB of memory.
default_jobs() {
  local cores memory
  cores=$(nproc)
  memory=$(awk '/MemAvailable/ { print int($2 / 1200000) }' /proc/meminfo)
  ((memory < 1)) && memory=1
  echo $((cores < memory ? cores : memory))
}

build_release() {
  local targets=()
  ((tests)) || targets=(--target learner sim_worker report omentum)
  export NINJA_STATUS='[%f/%t, %es] '
  cd "$root"
  say "building into $root/build/release with ${jobs:=$(default_jobs)} jobs"
  local log
  log=$(mktemp)
  if ! cmake --preset release >"$log" 2>&1; then
    cat "$log" >&2
    rm -f "$log"
    echo "setup.sh: cmake could not configure" >&2
    exit 1
  fi
  rm -f "$log"
  if ! cmake --build build/release --parallel "$jobs" "${targets[@]}"; then
    echo "setup.sh: the build failed" >&2
    exit 1
  fi
}

began=$(now)
install_packages
setup_s=$(since "$began")
build_s=0
if ((build)); then
  began=$(now)
  build_release
  build_s=$(since "$began")
fi
[[ -z $times ]] || printf 'setup_s=%s\nbuild_s=%s\n' "$setup_s" "$build_s" >"$times"
say "set-up $setup_s s, build $build_s s"

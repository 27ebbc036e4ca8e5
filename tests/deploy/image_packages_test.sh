#!/usr/bin/env bash
# docker/packages.txt names the package of every library that a program of the image links: a program that lacks one does not
# start there. Usage: image_packages_test.sh BIN_DIR PROGRAM...
set -uo pipefail
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)
bin=$1
shift
missing=0 seen=0
for program in "$@"; do
  places=$(ldd "$bin/$program")
  for library in $(readelf -d "$bin/$program" | sed -n 's/.*(NEEDED).*\[\(.*\)\]/\1/p'); do
    path=$(awk -v name="$library" '$1 == name { print $3 }' <<<"$places")
    [[ -n $path ]] || continue  # the loader itself
    package=$({ dpkg -S "$path" || dpkg -S "/usr$path" || dpkg -S "$(readlink -f "$path")"; } 2>/dev/null | sed -n '1s/:.*//p')
    [[ -n $package ]] || { echo "$program: no package has $library"; exit 1; }
    seen=$((seen + 1))
    case $package in libc6 | libgcc-s1) continue ;; esac  # of every Debian
    grep -qx "$package" "$root/docker/packages.txt" || { echo "$program needs $library of $package"; missing=1; }
  done
done
((seen > 0)) || { echo "no libraries"; exit 1; }
exit $missing

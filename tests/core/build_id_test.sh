#!/usr/bin/env bash
# core/build_id.cmake on a tree of its own: what changes the id and what does not. Usage: build_id_test.sh <script> <cmake>
set -euo pipefail
script=$1 cmake=$2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
export GIT_CEILING_DIRECTORIES=$folder  # no repository but the one made below
root=$folder/tree
mkdir -p "$root"/{core,idl,learner,proto,sim_worker/shell/deep,notes,tests}
echo 'double k = 1;' >"$root/sim_worker/shell/deep/law.cpp"
echo 'struct A;' >"$root/core/types.h"
echo 'add_library(a)' >"$root/core/CMakeLists.txt"
echo 'read me' >"$root/notes/a.txt"

bad=0
say() { echo "$1"; bad=1; }
write() { "$cmake" "-DROOT=$root" "-DFLAGS=${1:-g++ -O3}" "-DOUTPUT=$folder/id.cpp" -P "$script"; }
id() { write "${1-}"; grep -o '0x[0-9a-f]*ULL' "$folder/id.cpp"; }
revision() { write; sed -n 's/.*git_revision() { return "\(.*\)";.*/\1/p' "$folder/id.cpp"; }
same() { [[ $(id) == "$first" ]] || say "$1 changed the id"; }
other() { [[ $(id) != "$first" ]] || say "$1 did not change the id"; }

first=$(id)
[[ $first =~ ^0x[0-9a-f]{16}ULL$ ]] || say "no id: $first"
touch -d '2001-01-01' "$folder/id.cpp"
same "nothing"
[[ $(date -r "$folder/id.cpp" +%Y) == 2001 ]] || say "an unchanged tree wrote the file again"
[[ $(id "g++ -O2") != "$first" ]] || say "other flags did not change the id"
[[ $(revision) == unknown ]] || say "a tree without a repository has revision $(revision)"

echo 'more' >>"$root/notes/a.txt"; same "a document"
echo 'x' >"$root/tests/a.cpp"; same "a test"
echo 'double k = 2;' >"$root/sim_worker/shell/deep/law.cpp"; other "a source in a subfolder"
echo 'double k = 1;' >"$root/sim_worker/shell/deep/law.cpp"; same "a source put back"
mv "$root/sim_worker/shell/deep/law.cpp" "$root/sim_worker/shell/law.cpp"; other "a moved source"
mv "$root/sim_worker/shell/law.cpp" "$root/sim_worker/shell/deep/law.cpp"
echo 'message M {}' >"$root/proto/scene.proto"; other "a new proto file"
rm "$root/proto/scene.proto"
echo '-mfma' >>"$root/core/CMakeLists.txt"; other "a CMake list with flags"
echo 'add_library(a)' >"$root/core/CMakeLists.txt"; same "everything put back"

git -C "$root" init -q
git -C "$root" add -A
git -C "$root" -c user.name=a -c user.email=a@b -c commit.gpgsign=false commit -q -m first
same "a commit"
commit=$(git -C "$root" rev-parse --short=12 HEAD)
[[ $(revision) == "$commit" ]] || say "revision $(revision) of commit $commit"
echo 'double k = 3;' >"$root/sim_worker/shell/deep/law.cpp"; other "a change that is not committed"
[[ $(revision) == "$commit-dirty" ]] || say "revision $(revision) of a dirty tree at $commit"
exit $bad

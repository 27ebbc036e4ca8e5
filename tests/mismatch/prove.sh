#!/bin/bash
# A batch of concealed cases from truth to table:
#   tests/mismatch/prove.sh --plant fenics|calculix|mujoco|own --batch smoke|dev --seed N -o OUT
# Truths are kept in $OMENTUM_TRUTHS (else OUT/truths) and used again; a truth costs some 8 minutes of a core, by mujoco one. No label
# is on disk before the last verdict is; a manifest holds the hashes of recordings and labels before the first.
# OMENTUM_MISMATCH names the program, else `mismatch` of the path; OMENTUM_PLANT_PYTHON a Python that has the plant's
# engine, else /usr/bin/python3. What is done is not done twice.
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
plant= batch= seed= out=
while [ $# -gt 0 ]; do
  case "$1" in
    --plant) plant=$2; shift 2;;
    --batch) batch=$2; shift 2;;
    --seed) seed=$2; shift 2;;
    -o) out=$2; shift 2;;
    -h|--help) sed -n '2,8s/^# //p' "$0"; exit 0;;
    *) sed -n '2,8s/^# //p' "$0"; exit 2;;
  esac
done
if [ -z "$batch" ] || [ -z "$seed" ] || [ -z "$out" ]; then sed -n '2,8s/^# //p' "$0"; exit 2; fi
case "$plant" in
  fenics) truth_of() { echo "$truths/${1}_$2"; };;
  mujoco) truth_of() { echo "$truths/mujoco_${1}_$2"; };;
  calculix|own) truth_of() { echo "$truths/${plant}_${1}_$2"; };;
  *) echo "there is no plant '$plant', only fenics, calculix, mujoco and own"; exit 2;;
esac
mismatch=${OMENTUM_MISMATCH:-mismatch}
plants=("${OMENTUM_PLANT_PYTHON:-/usr/bin/python3}" "$here/plants/plants.py")
truths=${OMENTUM_TRUTHS:-$out/truths}
mkdir -p "$out/cases" "$out/verdicts" "$truths"
rows=$("${plants[@]}" plan --plant "$plant" --batch "$batch" --seed "$seed")

while read -r name effect truth sensor; do
  [ -e "$(truth_of "$effect" "$truth")/r08.npz" ] ||
    "${plants[@]}" truth --plant "$plant" --effect "$effect" --seed "$truth" -o "$(truth_of "$effect" "$truth")" > "$out/truth.log"
done <<< "$rows"

while read -r name effect truth sensor; do
  [ -d "$out/cases/$name" ] ||
    "${plants[@]}" case "$(truth_of "$effect" "$truth")" --seed "$sensor" -o "$out/cases/$name" >> "$out/manifest.sha256"
done <<< "$rows"

rm -rf "$out/labels"
while read -r name effect truth sensor; do
  [ -e "$out/verdicts/$name/verdict.json" ] && continue
  # A case that cannot be explained has no verdict and is scored so.
  "$mismatch" explain -r "$out/cases/$name" -o "$out/verdicts/$name" > "$out/verdicts/$name.log" 2>&1 ||
    echo "$name: explain ended with $?, see $out/verdicts/$name.log"
done <<< "$rows"
(cd "$out/verdicts" && find . -name verdict.json -exec sha256sum {} + | sort -k2) > "$out/verdicts.sha256"

while read -r name effect truth sensor; do
  "${plants[@]}" label "$(truth_of "$effect" "$truth")" --seed "$sensor" -o "$out/cases/$name" --labels "$out/labels" > /dev/null
done <<< "$rows"
# The manifest still holds: neither recordings nor labels have changed.
grep -v '\.json$' "$out/manifest.sha256" | (cd "$out/cases" && sha256sum --quiet -c -)
grep '\.json$' "$out/manifest.sha256" | (cd "$out/labels" && sha256sum --quiet -c -)
"$here/score.py" "$out/labels" "$out/verdicts" | tee "$out/score.txt"

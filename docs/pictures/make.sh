#!/usr/bin/env bash
# A picture of two lifts out of a report, side by side: docs/pictures/make.sh REPORT.html OUT.png [ENTRIES] [SHARE] [SIZE] [WHEEL]
# ENTRIES counts those of its list of lifts from 0 ("0, 1"), SHARE is of their duration (0.8), SIZE in pixels ("1000,385"),
# WHEEL the turn of the wheel that brings them nearer (-450).
# Needs chromium. docs/pictures/README.md says which pictures were made how.
set -euo pipefail
report=$(realpath "$1") out=$(realpath -m "$2") entries=${3:-0, 1} share=${4:-0.8} size=${5:-1000,385} wheel=${6:--450}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cp "$report" "$scratch/page.html"
cat >>"$scratch/page.html" <<HTML
<script>
addEventListener("load", () => {
  const panes = Array.from(document.querySelectorAll(".pane")), box = panes[0].parentElement;
  panes.forEach((pane, k) => {
    const choice = pane.querySelector("select");
    choice.value = [$entries][k];
    choice.dispatchEvent(new Event("change"));
  });
  document.body.replaceChildren(box, document.getElementById("replay-time"));
  Object.assign(document.body.style, { margin: "0", padding: "8px", maxWidth: "none" });
  const slider = document.getElementById("replay-time");
  slider.value = $share * slider.max;
  slider.style.display = "none";
  dispatchEvent(new Event("resize"));
  slider.dispatchEvent(new Event("input"));
  panes[0].querySelector("canvas").dispatchEvent(new WheelEvent("wheel", { deltaY: $wheel, bubbles: true, cancelable: true }));
});
</script>
HTML
chromium --headless=new --no-sandbox --hide-scrollbars --user-data-dir="$scratch/profile" --use-angle=swiftshader --enable-unsafe-swiftshader \
  --virtual-time-budget=8000 --window-size="$size" --screenshot="$out" "file://$scratch/page.html" 2>/dev/null
ls -l "$out"

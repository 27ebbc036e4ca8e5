#!/usr/bin/env python3
"""`mismatch explain` on a case of another engine (plants/truths), as people have it: a folder with scene_believed.txt, never edited.
Where nothing was left out it is silent; else it names what was, alone, and a place within 10 mm. What would have to be simulated once
more is ruled out by name. With --long nothing is ruled out, and meshes are finer.

usage: foreign_case_test.py MISMATCH TRUTH [--long]
"""
import argparse
import json
import math
import pathlib
import subprocess
import sys
import tempfile

HERE = pathlib.Path(__file__).parent
PLANTS = HERE / "plants" / "plants.py"
SHORT = ["r00", "r01", "r02", "r04", "r07"]  # recordings of the short form


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("truth", type=pathlib.Path)
    parser.add_argument("--long", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        run(sys.executable, PLANTS, "case", args.truth, "--seed", 7, "-o", folder / "3f2a91c0", "--force", "no")
        recordings = [folder / "3f2a91c0" / r for r in SHORT]
        fit = ["--tolerance-mm", 2, "--coarse-mm", 5]
        for effect in ("obstacle", "grasp_slip", "jaw_orientation", "anchor_detachment"):
            fit += ["--rule-out", effect]
        if args.long:
            recordings, fit = [folder / "3f2a91c0"], []
        out = run(args.program, "explain", "-r", *recordings, "-o", folder / "out", *fit)
        print("#", out.splitlines()[-2])
        verdict = json.loads((folder / "out" / "verdict.json").read_text())
        # What is concealed is looked at now.
        label = json.loads((args.truth / "truth.json").read_text())
    assert set(verdict.get("ruled_out", [])) == set(fit[5::2]), verdict.get("ruled_out")
    named = [member["name"] for effect in verdict.get("effects", []) for member in effect["class"]["members"]]
    best = max(verdict["scores"], key=lambda row: row.get("gain", 0))
    print(f"# {verdict['status']}: {named}; {best['key']}: z {best['z']:.1f}, gain {best['gain']:.1f} nats")
    if label["effect"] == "null":
        assert verdict["status"] == "no_mismatch_detectable" and not named, (verdict["status"], named)
        return
    assert named == [label["effect"]], (verdict["status"], named, best)
    numbers = {row["name"]: row for row in verdict["effects"][0]["parameters"]}
    for name, value in label["parameters"].items():
        if name in numbers:
            print(f"# {name}: {numbers[name]['value']:.3g} ({numbers[name]['low90']:.3g} - {numbers[name]['high90']:.3g}), true {value:.3g}")
    if "centre_m" in label["where"]:
        off_mm = 1e3 * math.dist(verdict["effects"][0]["where"]["centre_m"], label["where"]["centre_m"])
        assert off_mm < 10, (verdict["effects"][0], off_mm)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""`mismatch explain` on small lifts of the own engine (explained_lifts.py), whole: where nothing was left out it names nothing
and prints a limit for every effect; with an effect left out it ranks it first, claims it and confirms it. The page refers to
nothing outside, the repaired scene is simulated, and numpy reads the predictions.

usage: explain_program_test.py MISMATCH EFFECT [--long]    --long: finer meshes
"""
import argparse
import json
import pathlib
import re
import subprocess
import tempfile

import numpy as np

import explained_lifts as lifts

PLACES = {"inclusion": (0.002, 0.004)}  # x_B, y_B [m]


def explain(program, folder, out, more):
    command = [program, "explain", "--scene", folder / "believed.txtpb", "-r", folder / "lifts", "-o", folder / out, *more]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    print("#", done.stdout.splitlines()[-2], flush=True)
    return json.loads((folder / out / "verdict.json").read_text())


def check_files(program, folder, out):
    page = (folder / out / "report.html").read_text()
    assert "What the simulation left out" in page and not re.search(r"(src|href)=\"https?://", page)
    for k in range(len(lifts.PINCHES)):
        with np.load(folder / out / "predictions" / f"lift{k}.npz") as file:
            n, m = file["uv_B"].shape[:2]
            assert file["base"].shape == file["model"].shape == (len(file["t_s"]), n, m, 3)
            assert np.isfinite(file["model"]).all()
    command = [program, "simulate", "--scene", folder / out / "scene.repaired.txtpb", "--commands", folder / "lifts" / "lift0", "-o",
               folder / "again", "--cloud-rate", 0]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def check_limits(verdict):
    limits = {row["effect"]: row for row in verdict["detection_limits"]}
    for name in ("inclusion.k", "tool_backlash.b_z", "adhesion.k", "grasp_offset.x", "strain_stiffening.c2_over_mu"):
        row = limits[name]
        assert row["testable"] and 0 < row["floor_amplitude"] < row["amplitude"] <= row["amplitude_named"], row


def check_ranked(verdict, effect):
    best = max(verdict["scores"], key=lambda row: row.get("gain", 0))
    print(f"# {best['key']}: z {best['z']:.1f}, gain {best['gain']:.1f} nats")
    assert best["effect"] == effect, best
    if effect in PLACES:
        off = np.hypot(*(np.array(best["place_m"]) - PLACES[effect]))
        assert off < 0.010, (best, off)
    names = {member["name"] for found in verdict.get("effects", []) for member in found["class"]["members"]}
    assert not names or effect in names, names


def check_claimed(verdict, effect):
    found = verdict["effects"][0]
    assert verdict["status"] in ("explained", "explained_as_class"), (verdict["status"], verdict.get("reason"))
    assert effect in [member["name"] for member in found["class"]["members"]] and found["confirmed"], found
    assert verdict["explained_share"] > 0, verdict["fit"]
    if effect in PLACES:
        assert np.hypot(*(np.array(found["where"]["centre_m"]) - PLACES[effect])) < 0.010, found["where"]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("effect")
    parser.add_argument("--long", action="store_true")
    args = parser.parse_args()
    fit = ("--tolerance-mm", 0.6, "--coarse-mm", 2) if args.long else ("--tolerance-mm", 2, "--coarse-mm", 4)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        lifts.write_case(args.program, folder, args.effect, mesh_mm=0.6 if args.long else 2, rate=10 if args.long else 5)
        verdict = explain(args.program, folder, "out", fit)
        check_files(args.program, folder, "out")
        check_limits(verdict)
        if args.effect == "null":
            assert verdict["status"] == "no_mismatch_detectable" and not verdict.get("effects"), verdict["status"]
        else:
            check_ranked(verdict, args.effect)
            check_claimed(verdict, args.effect)


if __name__ == "__main__":
    main()

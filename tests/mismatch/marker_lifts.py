#!/usr/bin/env python3
"""Three lifts of a small sheet by the own engine, seen by markers alone: what `mismatch calibrate` finds.

/usr/bin/python3 marker_lifts.py MISMATCH SCRATCH [--noise-mm 0.02] [--tolerance-mm 6]    (Debian: python3-numpy)

Nine markers on nodes of the upper face, 50 Hz; damping, thickness and bending are as believed, E, friction and the pinches are
not.
"""
import argparse
import json
import shutil
from pathlib import Path

import numpy as np

import small_lifts as small

TRUTH = {"scene.tissue.material.young_modulus_pa": 42e3, "scene.tissue.effects.friction_change": 0.2}
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007))
AS_BELIEVED = {"scene.tissue.material.damping_per_s": 5, "scene.tissue.thickness_m": small.THICKNESS,
               "scene.tissue.effects.bending_change": 0, "scene.tissue.material.poisson_ratio": 0.45}
SHARES = (0.15, 0.5, 0.85), (0.35, 0.65, 0.95)  # of the sheet along x and y


def write_markers(simulated, folder, noise, random):
    data = np.loadtxt(simulated / "markers.csv", delimiter=",", skiprows=1)
    faces = data[:, 1:].reshape(len(data), 2, -1, 3)
    side = round(faces.shape[2] ** 0.5)
    upper = faces[:, faces[0, :, :, 2].mean(axis=1).argmax()].reshape(len(data), side, side, 3)
    columns = {"t_s": data[:, 0]}
    for x in SHARES[0]:
        for y in SHARES[1]:
            place = upper[:, round(x * (side - 1)), round(y * (side - 1))]
            for axis in range(3):
                columns[f"m{x}_{y}_{'xyz'[axis]}_m"] = place[:, axis] + random.normal(0, noise, len(data))
    np.savetxt(folder / "markers.csv", np.column_stack(list(columns.values())), delimiter=",", header=",".join(columns),
               comments="", fmt="%.9f")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--noise-mm", type=float, default=0.02)
    parser.add_argument("--tolerance-mm", type=float, default=6)
    args = parser.parse_args()
    random = np.random.default_rng(1)
    small.write_case(args.program, args.scratch, TRUTH, OFFSETS, seed=1, mesh=("--tolerance-mm", "1.5"), keep=True)
    for lift in sorted((args.scratch / "lifts").iterdir()):
        write_markers(args.scratch / "true" / lift.name, lift, 1e-3 * args.noise_mm, random)
        shutil.rmtree(lift / "clouds")
        (lift / "clouds.csv").unlink()
        words = (lift / "recording.txtpb").read_text()
        (lift / "recording.txtpb").write_text(words.replace("cloud_rate_hz: 10", "markers_rate_hz: 50"))
    small.calibrate(args.program, args.scratch, args.scratch / "out", ["--tolerance-mm", args.tolerance_mm, "--no-leave-out"])
    found = json.loads((args.scratch / "out" / "calibration.json").read_text())
    for name, true in {**TRUTH, **AS_BELIEVED}.items():
        n = small.number(found, name)
        inside = "" if n["low90"] <= true <= n["high90"] else ", outside"
        print(f"{name}: {n['value']:.4g} ({n['low90']:.4g} - {n['high90']:.4g}) for {true:g}{inside}")


if __name__ == "__main__":
    main()

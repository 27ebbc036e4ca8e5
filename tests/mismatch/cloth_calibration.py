#!/usr/bin/env python3
"""The fabrics of the set `cloth_lift`, which lie free and are lifted by a corner, by `mismatch import` and `mismatch calibrate` alone:
the shell is fitted to the clouds of one repeat and foretells those of the other. Prints what calibrate writes beside how far
the repeats are apart.

OMENTUM_REAL_DATA=... /usr/bin/python3 cloth_calibration.py MISMATCH SCRATCH [--fabrics paper tan ...]    (Debian: python3-scipy)

Nobody wrote down the size of the squares, how they lay, when a frame was taken, nor how the robot's frame stands to the clouds,
which its authors tuned by hand: believed is what PRIORS says. The clouds begin as scraps of what the cameras told from the
table, so the first ten are skipped, and what is lower than 8 mm above the table is compared with nothing.
"""
import argparse
import json
import os
import subprocess
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

HERE = Path(__file__).parent
FIRST, BELOW, FAR = 10, 8, 0.03  # frame; [mm]; [m]
COUNT, SIDE = 21, 0.26           # places along a side; [m] believed
THICKNESS = 1e-3                 # of a light fabric; only E t^2 / (rho g) and the way down count
PERIOD = "0.3:0.1"
SCENE = """format_version: 1
gravity_m_per_s2: 9.80665
tissue {{
  pose {{ translation_m {{ x: {x} y: {y} z: {z} }} x_axis {{ x: {h} y: -{h} z: 0 }} y_axis {{ x: {h} y: {h} z: 0 }} }}
  grid {{ count_x: {count} count_y: {count} pitch_m: {pitch} }}
  density_kg_per_m3: 300
  thickness_m: {thickness}
  anchor_max_y_m: -10
  static_friction: 0.3
  dynamic_friction: 0.3
  model: TISSUE_ELASTIC
  material {{ young_modulus_pa: 4e5 poisson_ratio: 0.3 damping_per_s: 5 law: LAW_COROTATED }}
  elastic {{ substeps: 5 iterations: 2 }}
  effects {{ grasp_turn_rad_per_n_m: 1e5 }}
}}
tool {{ contact: false grip {{ half_x_m: {grip} }} }}
rigid_body {{ name: "table" role: ROLE_BOARD pose {{ translation_m {{ z: {table} }} }} half_space: true }}
"""
PRIORS = """prior { path: "scene.tissue.material.young_modulus_pa" factor: 6 source: "some fabric" }
prior { path: "scene.tissue.grid.pitch_m" factor: 1.3 source: "by eye" }
prior { path: "scene.tissue.pose.turn_deg" sd: 20 source: "by eye" }
prior { path: "scene.tissue.thickness_m" factor: 1.001 source: "traded for the stiffness" }
prior { path: "scene.tissue.effects.bending_change" factor: 1.001 source: "traded for the stiffness" }
prior { path: "scene.tissue.material.poisson_ratio" sd: 0.0005 source: "traded for the stiffness" }
prior { path: "scene.depth_sensor.registration_m" sd: 0.01 source: "tuned by hand" }
prior { path: "scene.depth_sensor.registration_deg" sd: 0.01 source: "would take up what the fabric does" }
prior { path: "scene.depth_sensor.time_offset_s" sd: 0.2 source: "a frame or so" }
"""


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout


def read_recording(folder):
    """Clouds by frame, and where the gripper begins."""
    clouds = []
    for row in (folder / "clouds.csv").read_text().splitlines()[1:]:
        header, body = (folder / row.split(",")[1]).read_bytes().split(b"end_header\n", 1)
        kind = "<f8" if b"property double x" in header else "<f4"
        count = int(header.split(b"element vertex ")[1].split()[0])
        per_point = len(body) // count // np.dtype(kind).itemsize
        clouds.append(np.frombuffer(body, kind).reshape(count, per_point)[:, :3].astype(float))
    tool = np.genfromtxt(folder / "tool.csv", delimiter=",", names=True)
    return clouds, np.array([tool[f"tip_commanded_{a}_m"][0] for a in "xyz"])


def write_scene(path, jaws, table):
    """A square on the table, its diagonal the way that the jaws go, which hold its corner half a cell inside. The grip is a disc
    around the point of the jaws, which stand above the table, and reaches a cell and some more there."""
    pitch = SIDE / (COUNT - 1)
    lower = table + 0.5 * THICKNESS
    grip = np.hypot(jaws[2] - lower, 1.2 * pitch)
    half = (0.5 * SIDE - 0.5 * pitch) * np.sqrt(2)
    path.write_text(SCENE.format(x=jaws[0] + half, y=jaws[1], z=lower, h=np.sqrt(0.5), count=COUNT, pitch=pitch, thickness=THICKNESS,
                                 grip=grip, table=table))
    path.with_suffix(".prior.txtpb").write_text(PRIORS)


def apart(a, b, table):
    """Mean distance of the points of b from those of a by frame, of what is not taken for table [m]."""
    high = lambda cloud: cloud[cloud[:, 2] > table + 1e-3 * BELOW]
    return [np.minimum(cKDTree(high(x)).query(high(y))[0], FAR).mean() for x, y in zip(a[FIRST:], b[FIRST:])]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--fabrics", nargs="+", default=["paper", "tan", "navy", "polka", "redblack"])
    args = parser.parse_args()
    data = os.environ.get("OMENTUM_REAL_DATA")
    if not data or not (Path(data) / "cloth_lift").is_dir():
        raise SystemExit("OMENTUM_REAL_DATA: no set cloth_lift there: skipped")
    args.scratch.mkdir(parents=True)
    run(args.program, "import", Path(data) / "cloth_lift", "--map", HERE / "maps" / "cloth_lift.txtpb", "-o", args.scratch / "in")
    for fabric in args.fabrics:
        recordings = [args.scratch / "in" / f"{fabric}{repeat}.mcap" for repeat in ("", "2")]
        seen = []
        for recording in recordings:
            folder = args.scratch / "seen" / recording.stem
            run(args.program, "export", recording, "-o", folder)
            seen.append(read_recording(folder))
        table = float(np.percentile(np.concatenate([c[:, 2] for c in seen[0][0][FIRST:]]), 0.5))
        write_scene(args.scratch / f"{fabric}.txtpb", seen[0][1], table)
        out = args.scratch / fabric
        print(run(args.program, "calibrate", "--scene", args.scratch / f"{fabric}.txtpb", "-r", *recordings, "-o", out,
                  "--frame-period-s", PERIOD, "--skip-clouds", FIRST, "--above-board-mm", BELOW))
        found = json.loads((out / "calibration.json").read_text())
        number = lambda name: next(n for n in found["parameters"] + found["nuisances"] if n["name"] == name)
        words = {"scene.tissue.grid.pitch_m": ("side", 1e3 * (COUNT - 1), "mm"), "scene.tissue.pose.turn_deg": ("turn", 1, "deg"),
                 "scene.tissue.material.young_modulus_pa": ("E", 1e-3, "kPa"), "frame_period_s": ("a frame", 1, "s")}
        print(f"{fabric}: " + ", ".join(f"{w} {f * number(k)['value']:.3g} {u} ({f * number(k)['low90']:.3g} - {f * number(k)['high90']:.3g})"
                                        for k, (w, f, u) in words.items()))
        for row in found["fit"]:
            mean = (1 - row["far"]) * row["mean_model"] + row["far"] * FAR
            print(f"  {row['role']}: points {1e3 * mean:.1f} mm from the sheet (30 mm where farther, {100 * row['far']:.1f} % are)")
        between = apart(seen[0][0], seen[1][0], table)
        print(f"  repeats: {1e3 * np.mean(between):.1f} mm apart ({1e3 * min(between):.1f} - {1e3 * max(between):.1f})", flush=True)


if __name__ == "__main__":
    main()

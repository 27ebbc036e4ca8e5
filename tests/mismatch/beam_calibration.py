#!/usr/bin/env python3
"""The clamped silicone beam of the set `silicone_beam`: the reference solid is fitted to how it swings and rests under its own
weight and foretells both with 52 g at its tip. `mismatch calibrate` reads clouds, not markers, so the fit stands here; what is
imported and simulated is `mismatch`.

OMENTUM_REAL_DATA=... /usr/bin/python3 beam_calibration.py MISMATCH SCRATCH [--elements 3 12 3]

Fitted to the frequency and the decay of the swing, mean of both repeats: E and damping. Where the hand held the beam is not known,
so how far it sank from there tells nothing. The lab is not aligned with gravity, which points where the load pulls the tip.
"""
import argparse
import os
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
DENSITY, LOAD = 1070.0, 0.052  # kg/m^3, kg: of the set
UNTIL = 0.1  # [s] the simulated beam is held so long
SWING = 1.8  # [s] of the swing that is looked at
COUNTED = 5  # periods
SCENE = """format_version: 1
tissue {{
  grid {{ count_x: 7 count_y: 22 pitch_m: 0.005 }}
  density_kg_per_m3: {density}
  thickness_m: 0.03
  anchor_max_y_m: -0.0474
  model: TISSUE_REFERENCE
  material {{ young_modulus_pa: {young} poisson_ratio: 0.49 damping_per_s: {damping} law: LAW_NEO_HOOKE }}
  effects {{ added_mass {{ mass_kg: {load} y_m: 0.0495 radius_m: 0.003 }} }}
  reference {{ elements_x: {n[0]} elements_y: {n[1]} elements_z: {n[2]} substeps: 8 }}
}}
tool {{ contact: false }}
{held}
"""
HELD = "held_start {{ y_m: 0.0525 radius_m: 0.018 position_m {{ x: 0 y: {y} z: {z} }} until_s: {until} }}"


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)


class Beam:
    """Where the middle of its end is, and how it is turned, over time."""

    def __init__(self, program, scratch, elements):
        self.program, self.scratch, self.elements, self.count = program, scratch, elements, 0

    def simulate(self, young, damping, load, held, duration):
        self.count += 1
        folder = self.scratch / f"beam{self.count}"
        folder.mkdir(parents=True)
        words = "" if held is None else HELD.format(y=held[0], z=held[1], until=UNTIL)
        (folder / "scene.txtpb").write_text(SCENE.format(density=DENSITY, young=young, damping=damping, load=load,
                                                         n=self.elements, held=words))
        rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
        rows += [f"{0.01 * k:.2f},0.4,0,0.1,1" for k in range(2 + int(round(duration / 0.01)))]
        (folder / "commands").mkdir()
        (folder / "commands" / "tool.csv").write_text("\n".join(rows) + "\n")
        run(self.program, "simulate", "--scene", folder / "scene.txtpb", "--commands", folder / "commands", "-o",
            folder / "out", "--rate", 100, "--cloud-rate", 0)
        data = np.loadtxt(folder / "out" / "markers.csv", delimiter=",", skiprows=1)
        faces = data[:, 1:].reshape(len(data), 2, 7, 22, 3)  # upper, lower; places along x, y
        middle = faces[:, :, :, -1].mean(axis=(1, 2))
        up = faces[:, 0, :, -1].mean(axis=1) - faces[:, 1, :, -1].mean(axis=1)
        return data[:, 0], middle[:, 1], middle[:, 2], np.arctan2(up[:, 1], up[:, 2])

    def rest(self, young, load):
        """Height of the end against the clamp [m], its turn downwards [rad], its place along the beam [m]."""
        _, along, height, turn = self.simulate(young, 5, load, None, 0.01)
        return height[0], turn[0], along[0]

    def swing(self, young, damping, load, rise):
        """Height above rest over time from the release on, of an end that was held `rise` above rest."""
        down, _, along = self.rest(young, load)
        t, _, height, _ = self.simulate(young, damping, load, (along + 0.5 * rise * abs(down) / 0.1, down + rise), UNTIL + SWING)
        return t - UNTIL, height - down


def fitted_motion(points, to):
    """Rotation and shift that bring points nearest to others (Arun 1987)."""
    centre, other = points.mean(axis=0), to.mean(axis=0)
    u, _, vt = np.linalg.svd((points - centre).T @ (to - other))
    R = vt.T @ np.diag([1, 1, np.sign(np.linalg.det(vt.T @ u.T))]) @ u.T
    return R, other - R @ centre


def measured(folder):
    """By recording: time [s], height of the mean of the tip's markers over where it comes to rest [m], height of that place [m];
    against the clamp, whose own markers turn by 1.7 degrees under the load."""
    found, base = {}, None
    for name in ("gravity_V2_a", "gravity_V2_b", "load52_V2_a", "load52_V2_b"):
        rows = np.genfromtxt(folder / f"beam_{name}" / "markers.csv", delimiter=",", names=True)
        columns = [c for c in rows.dtype.names if c != "t_s"]
        points = np.stack([rows[c] for c in columns], 1).reshape(len(rows), 6, 3)
        if base is None:
            base = points[0, 3:]
        tip = np.empty((len(rows), 3))
        for k, p in enumerate(points):
            R, shift = fitted_motion(p[3:], base)
            tip[k] = R @ p[:3].mean(axis=0) + shift
        found[name] = rows["t_s"], tip, tip[-100:].mean(axis=0)
    down = np.mean([found[f"load52_V2_{k}"][2] - found[f"gravity_V2_{k}"][2] for k in "ab"], axis=0)
    up = -down / np.linalg.norm(down)
    return {name: (t, (p - rest) @ up, rest @ up) for name, (t, p, rest) in found.items()}


def frequency(t, height):
    """Of the first periods after the release [Hz]."""
    up = [a + (b - a) * p / (p - q) for a, b, p, q in zip(t, t[1:], height, height[1:]) if p < 0 <= q]
    return COUNTED / (up[COUNTED] - up[0])


def decay(t, height):
    """Of the amplitude, from the highest places of these periods [1/s]."""
    tops = [k for k in range(1, len(t) - 1) if height[k - 1] < height[k] >= height[k + 1] and height[k] > 5e-4]
    tops = [k for k in tops if height[k] == height[max(0, k - 5) : k + 6].max()][:COUNTED]
    return -np.polyfit(t[tops], np.log(height[tops]), 1)[0]


def swinging(recording):
    """From the release on."""
    t, height, _ = recording
    begin = np.flatnonzero(height < 0.5 * height[:20].mean())[0]
    return t[begin:], height[begin:]


def fit(beam, own, rise):
    """E and damping whose swing has the frequency and the decay of both repeats in the mean."""
    young, damping = 2.75e5, 4.0
    wanted = np.mean([frequency(*swinging(r)) for r in own])
    fading = np.mean([decay(*swinging(r)) for r in own])
    for _ in range(4):
        t, height = beam.swing(young, damping, 0, rise)
        young *= (wanted / frequency(t, height)) ** 2
        damping = max(0.1, damping + 2 * (fading - decay(t, height)))
    return young, damping


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--elements", type=int, nargs=3, default=(3, 12, 3))
    args = parser.parse_args()
    data = os.environ.get("OMENTUM_REAL_DATA")
    if not data or not (Path(data) / "silicone_beam").is_dir():
        raise SystemExit("OMENTUM_REAL_DATA: no set silicone_beam there: skipped")
    args.scratch.mkdir(parents=True)
    run(args.program, "import", Path(data) / "silicone_beam", "--map", HERE / "maps" / "silicone_beam.txtpb", "-o", args.scratch / "in")
    for file in sorted((args.scratch / "in").glob("*.mcap")):
        run(args.program, "export", file, "-o", args.scratch / "seen" / file.stem)
    seen = measured(args.scratch / "seen")
    own = [seen[f"gravity_V2_{k}"] for k in "ab"]
    loaded = [seen[f"load52_V2_{k}"] for k in "ab"]
    rise = np.mean([h[:20].mean() for _, h, _ in own])
    beam = Beam(args.program, args.scratch, args.elements)
    young, damping = fit(beam, own, rise)
    print(f"E {young / 1e3:.1f} kPa, damping {damping:.2f} /s", flush=True)
    down, _, _ = beam.rest(young, 0)
    deeper, _, _ = beam.rest(young, LOAD)
    print(f"own weight, rest: {-1e3 * down:.2f} mm below straight; the hand held it " +
          " and ".join(f"{1e3 * h[:20].mean():.2f}" for _, h, _ in own) + " mm above rest")
    shown = [1e3 * (a[2] - b[2]) for a, b in zip(own, loaded)]
    print(f"load 52 g, rest: foretold {1e3 * (down - deeper):.2f} mm lower, measured {shown[0]:.2f} and {shown[1]:.2f}", flush=True)
    for words, recordings, load in (("own weight", own, 0), ("load 52 g", loaded, LOAD)):
        t, height = beam.swing(young, damping, load, np.mean([h[:20].mean() for _, h, _ in recordings]))
        real = [frequency(*swinging(r)) for r in recordings]
        fades = [decay(*swinging(r)) for r in recordings]
        print(f"{words}, swing: simulated {frequency(t, height):.3f} Hz, fading with {decay(t, height):.2f} /s; measured "
              f"{real[0]:.3f} and {real[1]:.3f} Hz, {fades[0]:.2f} and {fades[1]:.2f} /s", flush=True)


if __name__ == "__main__":
    main()

"""Lifts off a board with DOLFINx (Debian: python3-dolfinx), as a calibration records them: five pinch
points; 0 - 4 go 10, 20 and 30 mm high with a hold at each, and back; 5 - 9 go 10 mm high and back, 10 - 14
20 mm. What tests/mismatch/lift_recordings.py makes recordings of.

/usr/bin/python3 run_lifts.py [NUMBER ...] [--elements 16] [--out FOLDER]    FOLDER/lift<NUMBER>.npz

Neo-Hooke, 27-node bricks whose lines are graded at the clamp only: another element and another mesh
than those of the reference model, whose mesh follows the jaws. A file holds the path of the jaws and, ten times a
second, the nodes of both faces, corners and middles of the sides alike, to 5 um.
"""
import argparse
import time
from pathlib import Path

import numpy as np

from cases import CLAMP, SIDE, THICKNESS, graded_lines
from dolfinx_solid import Solid

YOUNG, POISSON, DENSITY, GRAVITY = 52e3, 0.45, 1000.0, 9.80665
DAMPING, FRICTION, SLIP, STEP, RADIUS = 5.0, 0.35, 1e-4, 0.02, 0.005
# Where the jaws close: x_B, y_B of the centre [m]; three on the free edge, one on each side.
PINCHES = [(-0.0335, 0.0385), (0.0042, 0.0395), (0.0362, 0.0371), (-0.0393, 0.0048), (0.0387, 0.0151)]
# Height of the jaws [m] at times [s], of each five lifts; they also move towards the clamp by a fifth of it.
HEIGHTS = [[(0, 0), (0.1, 0), (0.5, 0.01), (0.9, 0.01), (1.3, 0.02), (1.7, 0.02), (2.1, 0.03), (2.7, 0.03),
            (3.5, 0.01), (4.0, 0.01)],
           [(0, 0), (0.1, 0), (0.5, 0.01), (1.3, 0.01), (1.6, 0.004), (2.0, 0.004)],
           [(0, 0), (0.1, 0), (0.9, 0.02), (1.7, 0.02), (2.2, 0.008), (2.5, 0.008)]]
EVERY = 5  # steps from frame to frame
UNIT = 5e-6  # of what is stored [m]


def lift(number, elements, out):
    begin = time.time()
    centre = np.array(PINCHES[number % len(PINCHES)])
    lines = [np.linspace(-SIDE, SIDE, elements + 1), graded_lines(CLAMP, SIDE, elements, [(CLAMP, 0.008)]),
             np.array([-THICKNESS / 2, THICKNESS / 2])]
    solid = Solid(lines, "q2", "neo_hooke", YOUNG, POISSON, DENSITY, [0, 0, -GRAVITY])
    solid.start_motion()
    rest = 5
    for _ in range(rest):
        solid.step(STEP, DAMPING, lines[2][0], FRICTION, SLIP)
    solid.hold(centre, RADIUS)
    start = solid.target[0].copy()
    times, frames, path, force = [], [], [], []
    faces = [np.flatnonzero(np.isclose(solid.nodes[:, 2], z)) for z in (THICKNESS / 2, -THICKNESS / 2)]
    order = np.concatenate([face[np.lexsort((solid.nodes[face, 1], solid.nodes[face, 0]))]
                            for face in faces])
    knots = np.array(HEIGHTS[number // len(PINCHES)])
    for step in range(int(round(knots[-1, 0] / STEP)) + 1):
        t = step * STEP
        if step > 0:
            height = np.interp(t, knots[:, 0], knots[:, 1])
            solid.target[0] = start + np.array([0, -0.2 * height, height])
            solid.step(STEP, DAMPING, lines[2][0], FRICTION, SLIP)
        path.append(solid.target[0].copy())
        force.append(solid.held_force())
        if step % EVERY == 0:
            times.append(t)
            frames.append(solid.positions()[order])
            print(number, f"{t:.2f} s", solid.newton, f"{time.time() - begin:.0f} s", flush=True)
    out.mkdir(parents=True, exist_ok=True)
    differences = np.diff(np.rint(np.array(frames) / UNIT).astype(np.int16), axis=0, prepend=np.int16(0))
    np.savez_compressed(out / f"lift{number}.npz", times_s=np.array(times), step_s=STEP,
                        unit_m=UNIT, frames_differences=differences, path_m=np.array(path), force_N=np.array(force),
                        rest_m=solid.nodes[order], centre_m=centre, radius_m=RADIUS, young_Pa=YOUNG,
                        poisson=POISSON, density_kg_per_m3=DENSITY, friction=FRICTION,
                        damping_per_s=DAMPING, compliance_m_per_N=solid.compliance)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("numbers", type=int, nargs="*", default=range(len(HEIGHTS) * len(PINCHES)))
    parser.add_argument("--elements", type=int, default=16)  # along x and y
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "lifts")
    args = parser.parse_args()
    for wanted in args.numbers:
        lift(wanted, args.elements, args.out)

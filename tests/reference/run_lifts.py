"""Lifts off a board with DOLFINx (Debian: python3-dolfinx), as a calibration records them: five pinch
points; 0 - 4 go 10, 20 and 30 mm high with a hold at each, and back; 5 - 9 go 10 mm high and back, 10 - 14
20 mm. What tests/mismatch/lift_recordings.py makes recordings of.

/usr/bin/python3 run_lifts.py [NUMBER ...] [--elements 16] [--out FOLDER]    FOLDER/lift<NUMBER>.npz

27-node bricks whose lines are graded at the clamp only: another element and another mesh
than those of the reference model, whose mesh follows the jaws. A file holds the path of the jaws and, ten times a
second, the nodes of both faces, corners and middles of the sides alike, to 5 um.
"""
import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cases import CLAMP, GRAVITY, HEIGHTS, PINCHES, SIDE, THICKNESS, graded_lines
from dolfinx_solid import Solid

SLIP, RADIUS = 1e-4, 0.005
FRAME = 0.1  # [s] from frame to frame
UNIT = 5e-6  # of what is stored [m]


@dataclass
class Lift:
    centre: tuple  # of the jaws, x_B, y_B [m]
    heights: list  # of the jaws, (time [s], height [m])
    young: float = 52e3
    poisson: float = 0.45
    thickness: float = THICKNESS
    density: float = 1000.0
    damping: float = 5.0
    friction: float = 0.35
    law: str = "neo_hooke"
    skins: float = 0.0  # dolfinx_solid.Solid
    side: float = SIDE  # half of the sheet's, and where the clamp ends along y [m]
    clamp: float = CLAMP
    step: float = 0.02  # [s]
    rest: int = 5  # steps before the jaws close


def simulate(lift, elements, out, **more):
    """Into the file `out`, with `more` numbers."""
    begin = time.time()
    bottom = -lift.thickness / 2
    lines = [np.linspace(-lift.side, lift.side, elements + 1),
             graded_lines(lift.clamp, lift.side, elements, [(lift.clamp, 0.008)]), np.array([bottom, -bottom])]
    solid = Solid(lines, "q2", lift.law, lift.young, lift.poisson, lift.density, [0, 0, -GRAVITY], skins=lift.skins)
    solid.start_motion()
    for _ in range(lift.rest):
        solid.step(lift.step, lift.damping, bottom, lift.friction, SLIP)
    solid.hold(np.array(lift.centre), RADIUS)
    start = solid.target[0].copy()
    times, frames, path, force = [], [], [], []
    faces = [np.flatnonzero(np.isclose(solid.nodes[:, 2], z)) for z in (-bottom, bottom)]
    order = np.concatenate([face[np.lexsort((solid.nodes[face, 1], solid.nodes[face, 0]))]
                            for face in faces])
    knots = np.array(lift.heights)
    every = int(round(FRAME / lift.step))
    for step in range(int(round(knots[-1, 0] / lift.step)) + 1):
        t = step * lift.step
        if step > 0:
            height = np.interp(t, knots[:, 0], knots[:, 1])
            solid.target[0] = start + np.array([0, -0.2 * height, height])
            solid.step(lift.step, lift.damping, bottom, lift.friction, SLIP)
        path.append(solid.target[0].copy())
        force.append(solid.held_force())
        if step % every == 0:
            times.append(t)
            frames.append(solid.positions()[order])
            print(out.stem, f"{t:.2f} s", solid.newton, f"{time.time() - begin:.0f} s", flush=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    differences = np.diff(np.rint(np.array(frames) / UNIT).astype(np.int16), axis=0, prepend=np.int16(0))
    np.savez_compressed(out, times_s=np.array(times), step_s=lift.step, unit_m=UNIT, frames_differences=differences,
                        path_m=np.array(path), force_N=np.array(force), rest_m=solid.nodes[order],
                        centre_m=np.array(lift.centre), radius_m=RADIUS, young_Pa=lift.young, poisson=lift.poisson,
                        thickness_m=lift.thickness, density_kg_per_m3=lift.density, friction=lift.friction,
                        damping_per_s=lift.damping, law=lift.law, skins=lift.skins,
                        compliance_m_per_N=solid.compliance, **more)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("numbers", type=int, nargs="*", default=range(len(HEIGHTS) * len(PINCHES)))
    parser.add_argument("--elements", type=int, default=16)  # along x and y
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "lifts")
    args = parser.parse_args()
    for wanted in args.numbers:
        simulate(Lift(PINCHES[wanted % len(PINCHES)], HEIGHTS[wanted // len(PINCHES)]), args.elements,
                 args.out / f"lift{wanted}.npz")

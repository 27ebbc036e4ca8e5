"""Solves the cases with DOLFINx (Debian: python3-dolfinx) and stores the results.

/usr/bin/python3 run_dolfinx.py dynamic                lift off a board with friction, 12 x 12 x 1
/usr/bin/python3 run_dolfinx.py beam                   stubby beam at Poisson 0.49
"""
import sys
import time

import numpy as np

from cases import (Case, DAMPING, DENSITY, FRAMES, FRICTION, LIFT, POISSON, REST, SLIP, STEP,
                   dynamic_case, reference_lines, write_result)
from dolfinx_solid import Solid


def remarks(solid, case):
    """What the patch gives way by, m/N; the model's is not that."""
    return [f"compliance {solid.compliance!r}"] if case.patch else []


def move(case):
    """The dynamic case, 12 x 12 x 1."""
    begin = time.time()
    lines = reference_lines(case, 12, 1)
    solid = Solid(lines, "q1e9", case.law, case.young, POISSON, DENSITY, [0, 0, -case.gravity])
    solid.start_motion()
    points = []
    for step in range(REST + LIFT):
        if step == REST:
            solid.hold(case.patch[:2], case.patch[2])
        if step >= REST:
            solid.target[0] += np.array(case.lift) / LIFT
        solid.step(STEP, DAMPING, lines[2][0], FRICTION, SLIP)
        if step + 1 in FRAMES:
            rest = [(x, y, lines[2][0]) for x in lines[0][::2] for y in lines[1][2::2]]
            points += [tuple(p) + tuple(solid.point(p)) for p in rest]
        print(step, solid.newton, f"{time.time() - begin:.0f} s", flush=True)
    write_result(f"dolfinx_{case.name}", case, {"force": solid.held_force(), "frames": FRAMES},
                 points, remarks(solid, case))


def beam():
    """Cantilever of 30 x 30 x 100 mm at Poisson 0.49, 100 kPa, under its weight: 27-node bricks,
    6 x 16 x 6; the points of its centre line."""
    lines = [np.linspace(-0.015, 0.015, 7), np.linspace(-0.05, 0.05, 17),
             np.linspace(-0.015, 0.015, 7)]
    case = Case("beam", 1e5)
    solid = Solid(lines, "q2", case.law, case.young, 0.49, DENSITY, [0, 0, -case.gravity])
    solid.relax()
    rest = [(0.0, y, 0.0) for y in np.linspace(-0.04, 0.05, 10)]
    write_result("dolfinx_beam", case, {}, [tuple(p) + tuple(solid.point(p)) for p in rest])
    print(solid.point(rest[-1]), solid.newton)


if __name__ == "__main__":
    if sys.argv[1:] == ["beam"]:
        beam()
    elif sys.argv[1:] == ["dynamic"]:
        move(dynamic_case())
    else:
        sys.exit(__doc__)

"""Solves the cases with DOLFINx (Debian: python3-dolfinx) and stores the results.

/usr/bin/python3 run_dolfinx.py same [CASE ...]        same element, same mesh, 16 x 16 x 1
/usr/bin/python3 run_dolfinx.py converged [CASE ...]   27-node bricks, 24 x 24 x 2
"""
import sys
import time

import numpy as np

from cases import (DENSITY, GRAVITY, POISSON, mid_surface_points, reference_lines, static_cases,
                   write_result)
from dolfinx_solid import Solid

STEPS = 10  # of the patch's way


def solve(case, lines, element):
    solid = Solid(lines, element, case.law, case.young, POISSON, DENSITY, [0, 0, -case.gravity],
                  case.inclusion or None)
    if not case.patch:
        solid.relax()
        return solid
    solid.hold(case.patch[:2], case.patch[2])
    for _ in range(STEPS):
        solid.target[0] += np.array(case.lift) / STEPS
        solid.relax()
    return solid


def refine(coarse, case, lines):
    """The same case with 27-node bricks, from the coarse solution."""
    solid = Solid(lines, "q2", case.law, case.young, POISSON, DENSITY, [0, 0, -case.gravity],
                  case.inclusion or None)
    if case.patch:
        solid.hold(case.patch[:2], case.patch[2])
        solid.target[0] += case.lift
    start = np.array([coarse.point(p) - p for p in solid.nodes])
    start[solid.nodes[:, 1] < lines[1][0] + 1e-9] = 0
    solid.w.x.array[solid.dofs] = start
    solid.relax(start=1e2)
    return solid


def run(kind, case, elements=24, layers=2):
    begin = time.time()
    same = kind == "same"
    lines = reference_lines(case, 16, 1)
    solid = solve(case, lines, "q1e9")
    if not same:
        lines = reference_lines(case, elements, layers)
        solid = refine(solid, case, lines)
    force = solid.held_force() if case.patch else np.zeros(3)
    extra = {"force": force}
    if same:
        extra |= {"lines_x": lines[0], "lines_y": lines[1], "lines_z": lines[2]}
        rest = [(x, y, lines[2][0]) for x in lines[0][::2] for y in lines[1][2::2]]
    else:
        extra["elements"] = [elements, elements, layers]
        rest = mid_surface_points()
    write_result(f"dolfinx_{kind}_{case.name}", case, extra,
                 [tuple(p) + tuple(solid.point(p)) for p in rest])
    print(f"{kind} {case.name}: force {1e3 * force} mN, {solid.newton} Newton iterations, "
          f"{time.time() - begin:.1f} s", flush=True)


if __name__ == "__main__":
    for each in static_cases():
        if len(sys.argv) < 3 or each.name in sys.argv[2:]:
            run(sys.argv[1], each)

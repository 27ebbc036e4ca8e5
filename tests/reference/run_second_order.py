"""Static states by 27-node bricks (DOLFINx) on graded grids, for the tests of the reference model.

/usr/bin/python3 run_second_order.py              the names of the cases
/usr/bin/python3 run_second_order.py CASE ...     solves these and stores them

A result, results/second_order/CASE.txt, holds the finest and the second-finest grid: lines "# key
values", then one line per point: x y z at rest, deformed on the finest, on the second-finest [m].
`own_error` is the rms and the largest distance between the two [m] and the relative one of force.
"""
import os
import sys
import time
from dataclasses import astuple, dataclass, replace

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import ufl

from cases import CLAMP, DENSITY, GRAVITY, POISSON, RESULTS, SIDE
from second_order_grips import Disc, Pad
from second_order_solid import Solid

BODIES = {"sheet": (0.045, 0.003), "beam": (0.003, 0.003), "stubby": (0.015, 0.027)}  # half width, thickness


@dataclass
class Case:
    name: str
    young: float
    law: str = "neo_hooke"
    body: str = "sheet"
    disc: tuple = ()  # x, y, radius of the grip [m]
    pad: tuple = ()  # x, y, half sizes of the grip [m]
    lift: tuple = (0.0, 0.0, 0.0)  # [m]
    compliance: float = 0.0  # of the grip [m/N]
    turn_compliance: float = 0.0  # of the pad [rad/(N m)]
    inclusion: tuple = ()  # x, y, radius, change of E by EffectValues::stiffness_at
    anchor_compliance: float = 0.0  # of the clamp, per length of its edge [m^2/N]
    whole: bool = False  # not by half

    @property
    def share(self):
        """Of the weight, under which the body is like one that is found without steps of it."""
        return min(1.0, self.young / 6e4) if self.young < 2e4 else 1.0

    @property
    def mirrored(self):
        if self.whole:
            return False
        places = [p[0] for p in (self.disc, self.pad, self.inclusion) if p]
        return self.lift[0] == 0 and not any(places)

    def header(self):
        lines = [f"# law {self.law}", f"# body {self.body}", f"# young {self.young!r}",
                 f"# gravity {GRAVITY!r}"]
        for key in ("disc", "pad", "inclusion"):
            if getattr(self, key):
                lines.append(f"# {key} " + " ".join(map(repr, getattr(self, key))))
        if self.disc or self.pad:
            lines.append("# lift " + " ".join(map(repr, self.lift)))
        for key in ("compliance", "turn_compliance", "anchor_compliance"):
            if getattr(self, key):
                lines.append(f"# {key} {getattr(self, key)!r}")
        return lines


PLACES = {"middle": ((0.0, 0.01), (0.0, -0.006, 0.02)), "edge": ((0.0, 0.038), (0.0, -0.008, 0.03)),
          "corner": ((0.035, 0.035), (-0.003, -0.006, 0.03))}
RADIUS, HALF = 0.005, (0.005, 0.003)


def cases():
    def kpa(young):
        return f"{round(young / 1e3)}kPa"

    every = [Case(f"droop_{kpa(e)}", e) for e in (5e3, 1e4, 3e4, 6e4, 2e5)]
    every += [Case(f"droop_{short}_{kpa(e)}", e, law) for short, law in
              (("svk", "st_venant_kirchhoff"), ("corotated", "corotated")) for e in (6e4, 2e5)]
    every += [Case(f"{body}_{kpa(e)}", e, body=body) for body in ("beam", "stubby")
              for e in (1e4, 6e4, 2e5)]
    for place, (at, lift) in PLACES.items():
        every.append(Case(f"{place}_disc_5kPa", 5e3, disc=(*at, RADIUS), lift=lift))
        for e in (1e4, 6e4, 2e5):
            every.append(Case(f"{place}_disc_{kpa(e)}", e, disc=(*at, RADIUS), lift=lift))
            every.append(Case(f"{place}_pad_{kpa(e)}", e, pad=(*at, *HALF), lift=lift))
    at, lift = PLACES["edge"]
    inclusion = (0.0, 0.005, 0.02, 4.0)
    every += [
        Case("inclusion_droop_60kPa", 6e4, inclusion=inclusion),
        Case("inclusion_edge_60kPa", 6e4, disc=(*at, RADIUS), lift=lift, inclusion=inclusion),
        Case("edge_disc_spring_60kPa", 6e4, disc=(*at, RADIUS), lift=lift, compliance=0.01),
        Case("edge_pad_spring_60kPa", 6e4, pad=(*at, *HALF), lift=lift, compliance=0.01,
             turn_compliance=2000.0),
        Case("bed_droop_60kPa", 6e4, anchor_compliance=2e-4),
    ]
    return every


# ---- grids ------------------------------------------------------------------------------------

def graded(low, high, size, kinks, growth):
    """Lines with one on each kink (place, size of the cells there); cells grow by `growth` of the
    distance up to `size`."""
    ends = sorted({low, high, *[at for at, _ in kinks if low < at < high]})
    lines = [low]
    for a, b in zip(ends[:-1], ends[1:]):
        edges = np.linspace(a, b, 4001)
        middle = (edges[1:] + edges[:-1]) / 2
        cell = np.full(4000, size)
        for at, there in kinks:
            cell = np.minimum(cell, there + growth * np.abs(middle - at))
        number = np.concatenate([[0], np.cumsum((b - a) / 4000 / cell)])
        n = max(1, int(np.ceil(number[-1] - 1e-6)))
        lines += list(np.interp(np.arange(1, n + 1) * number[-1] / n, number, edges))
    return np.array(lines)


@dataclass
class Level:
    """Cells [m]: largest, at the clamp, at the grip, at a free side, at a face; growth. Along x and
    through the thickness the largest are `across` and `through`."""
    size: float
    clamp: float
    grip: float
    side: float
    face: float
    growth: float
    across: float
    through: float


PATH = Level(0.009, 0.0015, 0.002, 0.004, 0.003, 0.7, 0.009, 0.003)


def grid(case, level):
    width, thickness = BODIES[case.body]
    x = [(width, level.side)] if case.mirrored else [(-width, level.side), (width, level.side)]
    y = [(CLAMP, level.clamp)]
    if case.disc or case.pad:
        grip = case.disc or case.pad
        half = (grip[2], grip[-1])
        for axis, kinks in ((0, x), (1, y)):
            kinks += [(grip[axis] + sign * half[axis], level.grip) for sign in (-1, 1)]
    if case.mirrored:
        x = [k for k in x if k[0] > 0]
    z = [(sign * thickness / 2, level.face) for sign in (-1, 1)]
    low = -SIDE if case.anchor_compliance else CLAMP
    return [graded(0.0 if case.mirrored else -width, width, level.across, x, level.growth),
            graded(low, SIDE, level.size, y, level.growth),
            graded(-thickness / 2, thickness / 2, level.through, z, level.growth)]


def make_solid(case, level):
    stiffness = None
    if case.inclusion:
        at_x, at_y, radius, change = case.inclusion

        def stiffness(x):
            u = ufl.sqrt((x[0] - at_x) ** 2 + (x[1] - at_y) ** 2 + 1e-12) / radius
            t = ufl.max_value(0, ufl.min_value(1, 2 * (1.25 - u)))
            return 1 + change * t * t * (3 - 2 * t)

    bed = 0.0
    if case.anchor_compliance:  # uniform over the clamped strip and its thickness
        bed = 1 / (case.anchor_compliance * (CLAMP + SIDE) * BODIES[case.body][1])
    solid = Solid(grid(case, level), case.law, case.young, POISSON, DENSITY, GRAVITY, CLAMP,
                  case.mirrored, stiffness, bed)
    if case.disc:
        solid.grip = Disc(solid, case.disc[:2], case.disc[2], case.compliance)
    if case.pad:
        solid.grip = Pad(solid, case.pad[:2], case.pad[2:], case.compliance, case.turn_compliance)
    return solid


# ---- states -----------------------------------------------------------------------------------

def reach(case, steps=6):
    """The state on a coarse grid, along the way of the grip."""
    solid = make_solid(case, PATH)
    solid.carry(case.share)
    if not solid.grip:
        solid.relax()
        return solid
    for k in range(steps):
        solid.grip.aim(np.array(case.lift) * (k + 1) / steps)
        solid.relax(1e2, 30.0)
    return solid


def leave_unstable(case, half):
    """Case and coarse state that a half comes to which is not stable: pushed to a side on a whole
    grid and let go. What it comes to may be symmetric again and is then computed by half."""
    solid = make_solid(replace(case, whole=True), PATH)
    solid.start_from(half)
    solid.grip.aim(case.lift)
    if case.pad:
        solid.grip.move(solid, half.grip.state(), 0, None)
    aside = 1e-3 * solid.nodes[:, 0] / SIDE * (solid.nodes[:, 1] - CLAMP) / (SIDE - CLAMP)
    solid.displacement()[:, 2] += np.where(solid.fixed[2::3], 0, aside)
    solid.relax(1e2, 4.0)
    left, right = (np.array([solid.point((sign * x, y, z)) for x, y, z in points_of(case)])
                   for sign in (-1, 1))
    skew = np.abs(left * [-1, 1, 1] - right).max()
    print(f"  left an unstable state; sides {1e3 * skew:.4f} mm apart", flush=True)
    if skew > 1e-5:
        return replace(case, whole=True), solid
    back = make_solid(case, PATH)
    back.start_from(solid)
    back.grip.aim(case.lift)
    if case.pad:
        back.grip.move(back, solid.grip.state(), 0, None)
    back.relax(1e2)
    return case, back


def refine(case, level, coarse, before, depth=0):
    """The state on the grid of `level` from that of `before`, under the same share of the weight;
    where Newton's method does not get there, by grids between the two."""
    solid = make_solid(case, level)
    solid.carry(coarse.share)
    solid.start_from(coarse)
    if solid.grip:
        solid.grip.aim(case.lift)
        solid.grip.move(solid, coarse.grip.state(), 0, None)
    if solid.solve():
        return solid
    print(f"  {case.name}: a step between", flush=True)
    if depth < 3:
        between = Level(*np.sqrt(np.multiply(astuple(level), astuple(before))))
        coarse = refine(case, between, coarse, before, depth + 1)
        return refine(case, level, coarse, between, depth + 1)
    solid.relax(1.0)
    return solid


def points_of(case):
    width = BODIES[case.body][0]
    across = np.linspace(-width, width, 7 if case.body == "sheet" else 3)
    return [(x, y, 0.0) for x in across for y in np.linspace(-SIDE, SIDE, 7) if y > CLAMP]


def levels_of(case):
    """From coarse to fine; the last two are stored."""
    if case.body != "sheet":
        t = BODIES[case.body][1]
        finest = Level(t, t / 60, 1, t / 12, t / 30, 0.35, t / 3, t / 3)
        if case.young < 2e4:  # smaller ones at the clamp do not bear the weight
            finest = Level(0.8 * t, t / 40, 1, t / 8, t / 20, 0.42, t / 2.5, t / 2.5)
        return [Level(t, t / 15, 1, 1, t / 8, 0.6, t / 2, t / 2),
                Level(t, t / 30, 1, t / 6, t / 15, 0.5, t / 2, t / 2), finest]
    # Crease at the clamp where cells are smaller (decision 0028 for St. Venant-Kirchhoff).
    soft = case.young < 2e4 or case.law == "st_venant_kirchhoff"
    if not (case.disc or case.pad):
        return [Level(0.006, 5e-4, 1, 2e-3, 7e-4, 0.6, 0.009, 0.0015),
                Level(0.004, 2e-4 if soft else 1e-4, 1, 1.5e-3, 3e-4 if soft else 2e-4, 0.5, 0.007, 0.001),
                Level(0.0027, 1.4e-4 if soft else 5e-5, 1, 1e-3, 2e-4 if soft else 1e-4, 0.35, 0.006, 0.001)]
    grids = [Level(0.007, 6e-4, 7e-4, 4e-3, 1e-3, 0.8, 0.007, 0.0015),
             Level(0.006, 3e-4, 4e-4, 3e-3, 6e-4, 0.7, 0.006, 0.0015),
             Level(0.0045, 2e-4, 2.5e-4, 2.5e-3, 4e-4, 0.6, 0.005, 0.0015)]
    if case.disc[:2] == PLACES["middle"][0] and case.young < 2e4:  # the last two are 0.03 mm apart
        grids.append(Level(0.0035, 1.5e-4, 1.8e-4, 2e-3, 3e-4, 0.5, 0.004, 0.0015))
    return grids


def run(case):
    begin = time.time()
    solid = reach(case)
    light = solid.state()
    solid.take_weight()
    print(f"{case.name}: path {solid.newton} iterations, {time.time() - begin:.0f} s", flush=True)
    if case.mirrored and not solid.is_stable():
        case, solid = leave_unstable(case, solid)
    else:
        solid.return_to(light)
    rest = points_of(case)
    states = []
    before = PATH
    levels = levels_of(case)
    for level in levels:
        solid = refine(case, level, solid, before)
        before = level
        light = solid.state()
        solid.take_weight()
        cells = [len(line) - 1 for line in solid.lines]
        points = np.array([solid.point(p) for p in rest])
        force = solid.grip.force() if solid.grip else np.zeros(3)
        states.append((cells, points, force))
        if len(states) > 1:
            apart = np.linalg.norm(points - states[-2][1], axis=1)
            error = (np.sqrt(np.mean(apart**2)), apart.max(),
                     np.linalg.norm(force - states[-2][2]) / max(1e-12, np.linalg.norm(force)))
        else:
            error = (0, 0, 0)
        print(f"  {cells} tip {1e3 * points[-1]} mm, force {1e3 * force} mN, moved "
              f"{1e3 * error[0]:.4f} rms {1e3 * error[1]:.4f} mm, {100 * error[2]:.3f} %, "
              f"{solid.newton} iterations, {time.time() - begin:.0f} s", flush=True)
        if level is not levels[-1]:
            solid.return_to(light)
    stable = solid.is_stable()
    print(f"  stable {stable}", flush=True)
    extra = {"cells": states[-1][0], "cells_coarse": states[-2][0], "own_error": error,
             "stable": [int(stable)]}
    if solid.grip:
        extra |= {"force": states[-1][2], "force_coarse": states[-2][2]}
    if case.pad:
        extra["moment"] = solid.grip.moment()
        extra["turn"] = solid.grip.q[3:]
    folder = RESULTS / "second_order"
    folder.mkdir(exist_ok=True)
    lines = case.header() + ["# engine DOLFINx 0.5.2", "# element 27-node bricks"]
    lines += [f"# {key} " + " ".join(f"{v:.7g}" for v in values) for key, values in extra.items()]
    table = np.hstack([rest, states[-1][1], states[-2][1]])
    lines += [" ".join(f"{round(v, 8):.8g}" for v in row) for row in table]
    (folder / f"{case.name}.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    named = {case.name: case for case in cases()}
    if len(sys.argv) == 1:
        print("\n".join(named))
    for name in sys.argv[1:]:
        try:
            run(named[name])
        except (RuntimeError, KeyError) as error:
            print(f"{name}: {error!r}", flush=True)

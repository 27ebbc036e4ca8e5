"""Sheets on springs by CalculiX: jaws that give way and turn, a clamp on a bed. Stored as those of run_second_order.py,
results/second_order/calculix_CASE.txt, of a fine and a coarse mesh of 20-node bricks.

/usr/bin/python3 run_calculix_springs.py [CASE ...]

The law is that of St. Venant-Kirchhoff (run_calculix.py says why). A pad is a *RIGID BODY over both faces; its
reference node hangs on a spring of each axis (SPRING2) from a node that is led along the lift, its rotation node on one to ground
(SPRING1). Of a disc the node that leads its rows hangs on these springs. The bed of the clamp is even over the clamped
strip and the thickness.
"""
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import cases
import run_calculix as calculix
from cases import CLAMP, DENSITY, GRAVITY, POISSON, RESULTS, SIDE, THICKNESS

YOUNG = 6e4
COMPLIANCE, TURN, BED = 0.01, 2000.0, 2e-4  # m/N, rad/(N m), m^2/N along the edge
AT, LIFT = (0.0, 0.038), (0.0, -0.008, 0.03)
GRIDS = ((14, 20, 2), (20, 30, 2))  # cells across, along, through: coarse, fine


@dataclass
class Spring:
    name: str
    disc: tuple = ()
    pad: tuple = ()
    bed: float = 0.0
    young: float = YOUNG
    law: str = "st_venant_kirchhoff"
    inclusion: tuple = ()
    lift: tuple = LIFT

    @property
    def held(self):
        return self.disc or self.pad

    def header(self):
        lines = [f"# law {self.law}", "# body sheet", f"# young {self.young!r}", f"# gravity {GRAVITY!r}"]
        for key in ("disc", "pad"):
            if getattr(self, key):
                lines.append(f"# {key} " + " ".join(map(repr, getattr(self, key))))
        if self.held:
            lines += ["# lift " + " ".join(map(repr, self.lift)), f"# compliance {COMPLIANCE!r}"]
        if self.pad:
            lines.append(f"# turn_compliance {TURN!r}")
        if self.bed:
            lines.append(f"# anchor_compliance {self.bed!r}")
        return lines


SPRINGS = [Spring("edge_disc_spring", disc=(*AT, 0.005)), Spring("edge_pad_spring", pad=(*AT, 0.005, 0.003)),
           Spring("bed_droop", bed=BED)]


def lines_of(case, grid):
    kinks = [[], [(CLAMP, 0.1 * (SIDE - CLAMP))]]
    if case.held:
        for axis, half in ((0, case.held[2]), (1, case.held[-1])):
            kinks[axis] += [(case.held[axis] + sign * half, half) for sign in (-1, 1)]
    lines = [cases.graded_lines(-SIDE, SIDE, grid[0], kinks[0]), cases.graded_lines(CLAMP, SIDE, grid[1], kinks[1]),
             list(np.linspace(-THICKNESS / 2, THICKNESS / 2, grid[2] + 1))]
    if case.bed:
        lines[1] = [-SIDE] + lines[1]
    return lines


class Deck:
    def __init__(self, mesh, case):
        self.mesh, self.case = mesh, case
        self.nodes = len(mesh.nodes)
        self.element = len(mesh.elements)
        self.out = ["*NODE, NSET=ALL"]
        self.out += [f"{i + 1}, {p[0]:.12e}, {p[1]:.12e}, {p[2]:.12e}" for i, p in enumerate(mesh.nodes.tolist())]

    def add_node(self, at, name):
        self.nodes += 1
        self.out += [f"*NODE, NSET={name}", f"{self.nodes}, {at[0]:.12e}, {at[1]:.12e}, {at[2]:.12e}"]
        return self.nodes

    def add_spring(self, nodes, axis, stiffness):
        self.element += 1
        name = f"SPRING{self.element}"
        kind = "SPRING1" if len(nodes) == 1 else "SPRING2"
        self.out += [f"*ELEMENT, TYPE={kind}, ELSET={name}", ", ".join(map(str, [self.element, *nodes])),
                     f"*SPRING, ELSET={name}", ", ".join([str(axis)] * len(nodes)), f"{stiffness:.12e}"]

    def add_sheet(self):
        self.out.append("*ELEMENT, TYPE=C3D20R, ELSET=SHEET")
        for e, element in enumerate(self.mesh.elements):
            names = [str(i) for i in [e + 1] + [node + 1 for node in element]]
            self.out += [", ".join(names[:11]) + ",", ", ".join(names[11:])]
        self.out += calculix.sections(self.mesh, self.case)

    def add_disc(self, control):
        """The rows of the mean follow the node `control`, those of the slopes stay."""
        rows = calculix.patch_rows(self.mesh, self.case.disc[:2], self.case.disc[2])
        used = np.flatnonzero(np.abs(rows).sum(axis=0) > 0)
        pivots, left = [], rows[:, used].copy()
        for _ in range(4):
            r, k = np.unravel_index(np.argmax(np.abs(left)), left.shape)
            pivots.append(used[k])
            left = left - np.outer(left[:, k] / left[r, k], left[r])
            left[r] = 0
        solved = np.linalg.inv(rows[:, pivots])
        others = [k for k in used if k not in pivots]
        coefficients = solved @ rows[:, others]
        for q, pivot in enumerate(pivots):
            for axis in (1, 2, 3):
                terms = [(pivot + 1, 1.0)]
                terms += [(k + 1, c) for k, c in zip(others, coefficients[q]) if abs(c) > 1e-14]
                terms.append((control, -solved[q, 0]))
                self.out += ["*EQUATION", str(len(terms))]
                for k in range(0, len(terms), 4):
                    self.out.append(", ".join(f"{node}, {axis}, {c:.12e}" for node, c in terms[k:k + 4]))

    def add_grip(self):
        case, centre = self.case, (*self.case.held[:2], 0.0)
        led = self.add_node(centre, "LED")
        control = self.add_node(centre, "CONTROL")
        for axis in (1, 2, 3):
            self.add_spring((control, led), axis, 1 / COMPLIANCE)
        if case.disc:
            return self.add_disc(control)
        turn = self.add_node(centre, "TURN")
        near = np.abs(self.mesh.nodes - centre)
        faces = np.abs(near[:, 2] - THICKNESS / 2) < 1e-9
        pad = np.flatnonzero(faces & (near[:, 0] < case.pad[2] + 1e-9) & (near[:, 1] < case.pad[3] + 1e-9))
        self.out.append("*NSET, NSET=PAD")
        calculix.write_list(self.out, [i + 1 for i in pad])
        self.out.append(f"*RIGID BODY, NSET=PAD, REF NODE={control}, ROT NODE={turn}")
        for axis in (1, 2, 3):
            self.add_spring((turn,), axis, 1 / TURN)

    def add_bed(self):
        """Springs to ground at the Gauss points of the clamped strip's bricks: nodes that its nodes lead."""
        lines = self.mesh.lines
        at = (1 - 3**-0.5) / 2
        volume = (CLAMP + SIDE) * THICKNESS
        for cell in np.ndindex(len(lines[0]) - 1, 1, len(lines[2]) - 1):
            low, high = (np.array([lines[k][cell[k] + side] for k in range(3)]) for side in (0, 1))
            stiffness = np.prod(high - low) / 8 / (self.case.bed * volume)
            for corner in np.ndindex(2, 2, 2):
                p = low + np.where(corner, 1 - at, at) * (high - low)
                nodes, N = self.mesh.weights_at(p)
                place = self.add_node(p, f"BED{self.nodes + 1}")
                for axis in (1, 2, 3):
                    terms = [(place, -1.0)] + [(node + 1, n) for node, n in zip(nodes, N)]
                    self.out += ["*EQUATION", str(len(terms))]
                    for k in range(0, len(terms), 4):
                        self.out.append(", ".join(f"{node}, {axis}, {c:.12e}" for node, c in terms[k:k + 4]))
                    self.add_spring((place,), axis, stiffness)

    def write(self, path):
        self.add_sheet()
        if self.case.held:
            self.add_grip()
        if self.case.bed:
            self.add_bed()
        else:
            self.out.append("*NSET, NSET=CLAMP")
            calculix.write_list(self.out, [i + 1 for i in np.flatnonzero(self.mesh.nodes[:, 1] < CLAMP + 1e-9)])
            self.out += ["*BOUNDARY", "CLAMP, 1, 3"]
        self.out += ["*STEP, NLGEOM, INC=2000", "*STATIC", "0.05, 1., 1e-7, 0.1", "*CONTROLS, PARAMETERS=FIELD",
                     "1e-7, 1e-5, , , 1e-7", "*CONTROLS, PARAMETERS=TIME INCREMENTATION", "8, 16, 9, 32, 10, 4, , 10",
                     "*DLOAD", f"SHEET, GRAV, {GRAVITY}, 0., 0., -1."]
        if self.case.held:
            self.out.append("*BOUNDARY")
            self.out += [f"LED, {axis + 1}, {axis + 1}, {self.case.lift[axis]}" for axis in range(3)]
        self.out += ["*NODE PRINT, NSET=ALL, FREQUENCY=100000", "U"]
        if self.case.held:
            self.out += ["*NODE PRINT, NSET=LED, FREQUENCY=100000", "RF"]
        if self.case.pad:
            self.out += ["*NODE PRINT, NSET=TURN, FREQUENCY=100000", "U"]
        self.out.append("*END STEP")
        path.write_text("\n".join(self.out) + "\n")


def solve(case, grid):
    """Points of the mid-surface at rest and deformed [m], force of the tissue on the tool [N]."""
    mesh = calculix.Mesh(lines_of(case, grid))
    with tempfile.TemporaryDirectory() as folder:
        Deck(mesh, case).write(Path(folder) / "case.inp")
        calculix.ccx(folder, "case")
        moved, force = {}, np.zeros(3)
        quantity = ""
        for line in (Path(folder) / "case.dat").read_text().splitlines():
            words = line.split()
            if words and not words[0].isdigit():
                quantity = words[0]
            elif words and quantity == "displacements":
                moved[int(words[0])] = [float(w) for w in words[1:4]]
            elif words and quantity == "forces":
                force = -np.array([float(w) for w in words[1:4]])  # of the springs' end on them
    u = np.array([moved[i + 1] for i in range(len(mesh.nodes))])
    rest = [(x, y, 0.0) for x in np.linspace(-SIDE, SIDE, 7) for y in np.linspace(-SIDE, SIDE, 7) if y > CLAMP]
    deformed = []
    for p in rest:
        nodes, N = mesh.weights_at(p)
        deformed.append(np.array(p) + N @ u[nodes])
    return np.array(rest), np.array(deformed), force


def run(case):
    states = []
    for grid in GRIDS:
        begin = time.time()
        states.append(solve(case, grid))
        rest, deformed, force = states[-1]
        print(f"{case.name} {grid}: tip {1e3 * deformed[-1]} mm, force {1e3 * force} mN, {time.time() - begin:.0f} s",
              flush=True)
    (_, coarse, force_coarse), (rest, fine, force) = states
    apart = np.linalg.norm(fine - coarse, axis=1)
    error = (np.sqrt(np.mean(apart**2)), apart.max(),
             np.linalg.norm(force - force_coarse) / max(1e-12, np.linalg.norm(force)))
    extra = {"cells": GRIDS[1], "cells_coarse": GRIDS[0], "own_error": error}
    if case.held:
        extra |= {"force": force, "force_coarse": force_coarse}
    lines = case.header() + [f"# engine CalculiX {calculix.version()}", "# element C3D20R"]
    lines += [f"# {key} " + " ".join(f"{v:.7g}" for v in values) for key, values in extra.items()]
    lines += [" ".join(f"{round(v, 8):.8g}" for v in row) for row in np.hstack([rest, fine, coarse])]
    (RESULTS / "second_order" / f"calculix_{case.name}_60kPa.txt").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    for each in SPRINGS:
        if not sys.argv[1:] or each.name in sys.argv[1:]:
            run(each)

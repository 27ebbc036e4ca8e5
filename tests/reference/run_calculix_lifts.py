"""Lifts 0 - 4 of run_lifts.py up to their third hold, by CalculiX: five pinch points at three levels off a board with
friction, step by step at rest. What tests/mismatch/lift_recordings.py --calculix makes recordings of.

/usr/bin/python3 run_calculix_lifts.py [NUMBER ...] [--elements 12] [--layers 1] [--out FOLDER]    FOLDER/lift<NUMBER>.npz

20-node bricks C3D20R and CalculiX's own neo-Hooke law, which is not that of the model (run_calculix.py). The board is one
fixed brick; contact is between surfaces, its pressure 1e8 Pa/m of overclosure, friction sticks with 1e6 Pa/m up to Coulomb's limit.
Files as those of run_lifts.py, of the states at the holds; places on the faces are those of the 20-node bricks.
"""
import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

import run_calculix as calculix
from cases import CLAMP, GRAVITY, HEIGHTS, PINCHES, SIDE, THICKNESS, graded_lines
from run_calculix_springs import Deck, Spring

YOUNG, FRICTION, RADIUS, UNIT = 52e3, 0.35, 0.005, 5e-6
PRESSURE, STICK = 1e8, 1e6  # [Pa/m]
LEVELS, RAISED, HOLDS, STEP = 3, 0.03, (0.8, 1.6, 2.6), 0.02  # highest [m], of run_lifts.py [s], [s]


class OnBoard(Deck):
    def add_board(self):
        z, far, deep = -THICKNESS / 2, 0.1, 0.01
        corners = [self.add_node((far * x, far * y, z + deep * (h - 1) / 2), "BOARDNODES")
                   for x, y, h in calculix.CORNERS]
        self.element += 1
        self.out += ["*ELEMENT, TYPE=C3D8, ELSET=BOARD", ", ".join(map(str, [self.element, *corners])),
                     "*MATERIAL, NAME=BOARD", "*ELASTIC", "1e9, 0.3", "*SOLID SECTION, ELSET=BOARD, MATERIAL=BOARD",
                     "*SURFACE, NAME=TOP, TYPE=ELEMENT", f"{self.element}, S2", "*SURFACE, NAME=UNDER, TYPE=ELEMENT"]
        below = self.mesh.n[0] * self.mesh.n[1]
        self.out += [f"{e + 1}, S1" for e in range(below)]
        self.out += ["*SURFACE INTERACTION, NAME=SLIDE", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR",
                     f"{PRESSURE:.6e}", "*FRICTION", f"{FRICTION}, {STICK:.6e}",
                     "*CONTACT PAIR, INTERACTION=SLIDE, TYPE=SURFACE TO SURFACE", "UNDER, TOP"]

    def add_step(self, control, lift, levels, increment):
        """Of time 1 for each level; states are printed at each."""
        self.out += ["*STEP, NLGEOM, INC=3000", "*STATIC", f"{increment}, {levels}., 1e-7, {increment}",
                     "*CONTROLS, PARAMETERS=FIELD", "1e-3, 1e-2, , , 1e-3",
                     "*CONTROLS, PARAMETERS=TIME INCREMENTATION", "16, 32, 9, 64, 10, 4, , 20",
                     "*DLOAD", f"SHEET, GRAV, {GRAVITY}, 0., 0., -1.", "*BOUNDARY"]
        self.out += [f"{control}, {axis + 1}, {axis + 1}, {lift[axis]}" for axis in range(3)]
        self.out += [f"*NODE PRINT, NSET=ALL, TIME POINTS=LEVELS{levels}", "U", "*END STEP"]

    def write(self, path):
        self.add_sheet()
        control = self.add_node((*self.case.disc[:2], 0.0), "CONTROL")
        self.add_disc(control)
        self.add_board()
        self.out.append("*NSET, NSET=CLAMP")
        calculix.write_list(self.out, [i + 1 for i in np.flatnonzero(self.mesh.nodes[:, 1] < CLAMP + 1e-9)])
        self.out += ["*BOUNDARY", "CLAMP, 1, 3", "BOARDNODES, 1, 3"]
        self.out += ["*TIME POINTS, NAME=LEVELS1", "1.", f"*TIME POINTS, NAME=LEVELS{LEVELS}",
                     ", ".join(f"{k + 1}." for k in range(LEVELS))]
        self.add_step(control, (0, 0, 0), 1, 1.0)
        self.add_step(control, (0, -0.2 * RAISED, RAISED), LEVELS, 0.1)
        path.write_text("\n".join(self.out) + "\n")


def states_of(path, count):
    """Displacements of the nodes, each time they are printed [m]."""
    states, quantity = [], ""
    for line in path.read_text().splitlines():
        words = line.split()
        if words and not words[0].isdigit():
            quantity = words[0]
            if quantity == "displacements":
                states.append(np.full((count, 3), np.nan))
        elif words and quantity == "displacements" and int(words[0]) <= count:
            states[-1][int(words[0]) - 1] = [float(w) for w in words[1:4]]
    return states


def face_points(mesh, z):
    """Corners, middles of the sides and of the faces of the bricks, by x, then y: nodes and weights of each."""
    fine = [np.interp(np.arange(2 * n + 1) / 2, np.arange(n + 1), line) for n, line in zip(mesh.n, mesh.lines)]
    points = [(x, y, z) for x in fine[0] for y in fine[1]]
    return np.array(points), [mesh.weights_at(p) for p in points]


def lift(number, elements, layers, out):
    begin = time.time()
    mesh = calculix.Mesh([np.linspace(-SIDE, SIDE, elements + 1), graded_lines(CLAMP, SIDE, elements, [(CLAMP, 0.008)]),
                          np.linspace(-THICKNESS / 2, THICKNESS / 2, layers + 1)])
    case = Spring(f"lift{number}", disc=(*PINCHES[number], RADIUS), young=YOUNG, law="calculix_neo_hooke")
    with tempfile.TemporaryDirectory() as folder:
        OnBoard(mesh, case).write(Path(folder) / "case.inp")
        calculix.ccx(folder, "case")
        states = states_of(Path(folder) / "case.dat", len(mesh.nodes))
    assert len(states) == 1 + LEVELS
    rest, frames = [], [[] for _ in states]
    for z in (THICKNESS / 2, -THICKNESS / 2):
        points, weights = face_points(mesh, z)
        rest.append(points)
        for frame, u in zip(frames, states):
            frame.append(points + np.array([N @ u[nodes] for nodes, N in weights]))
    frames = np.array([np.concatenate(frame) for frame in frames])
    times = STEP * np.arange(int(round(HOLDS[-1] / STEP)) + 1)
    height = np.interp(times, *np.array(HEIGHTS[0]).T)
    path = np.array([*PINCHES[number], 0]) + np.outer(height, (0, -0.2, 1))
    out.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(out / f"lift{number}.npz", times_s=np.array([0, *HOLDS]), step_s=STEP, unit_m=UNIT,
                        frames_differences=np.diff(np.rint(frames / UNIT).astype(np.int16), axis=0, prepend=np.int16(0)),
                        path_m=path, rest_m=np.concatenate(rest), centre_m=PINCHES[number], radius_m=RADIUS,
                        young_Pa=YOUNG, poisson=0.45, density_kg_per_m3=1000.0, friction=FRICTION)
    print(f"lift {number}: {time.time() - begin:.0f} s", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("numbers", type=int, nargs="*", default=range(len(PINCHES)))
    parser.add_argument("--elements", type=int, default=12)  # along x and y
    parser.add_argument("--layers", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "lifts_calculix")
    args = parser.parse_args()
    for wanted in args.numbers:
        lift(wanted, args.elements, args.layers, args.out)

"""A clamped soft sheet under gravity on a board, moved by jaws, at rest at every time: 20-node bricks with reduced integration
(C3D20R) in CalculiX's `ccx`, to which a deck is written and whose tables are read back.

Decks are in mm, kg, s, so forces are in mN and stresses in kPa. Box coordinates: x across from 0, y from the clamped
edge, z up from the board.
"""
import os
import shutil
import subprocess
import tempfile

import numpy as np

MM = 1e3  # per metre
BOARD = 50.0  # [kPa/mm] pressure over penetration
BRISTLE_MM = 0.015  # the slip over which friction grows to its full size at the sheet's own weight
BUMP_PITCH = 0.001  # [m] of the board's grid where it rises
SETTLED = 1.0  # time of a deck at which the sheet rests and the jaws close
SMALLEST = 1e-4  # part of an increment to which it is halved at most


class Diverged(RuntimeError):
    """ccx gave up; `time` is that of the deck, less SETTLED."""

    def __init__(self, time, text):
        super().__init__(text)
        self.time = time


def program():
    return shutil.which("ccx")


def lines(breaks, n):
    """Lines from the first to the last of `breaks` and through all of them, with about n cells of one size."""
    breaks = np.asarray(breaks, float)
    size = (breaks[-1] - breaks[0]) / n
    parts = [np.linspace(a, b, max(1, int(round((b - a) / size))) + 1) for a, b in zip(breaks[:-1], breaks[1:])]
    return np.concatenate([parts[0]] + [part[1:] for part in parts[1:]])


def halves(cells):
    return np.sort(np.concatenate([cells, (cells[1:] + cells[:-1]) / 2]))


def listed(values):
    """At most eight to a line, as ccx reads them."""
    values = [str(v) for v in values]
    return ",\n".join(", ".join(values[k:k + 8]) for k in range(0, len(values), 8))


class Material:
    """Numbers of the body. Laws: neo-Hooke, Mooney-Rivlin (a fifth of the shear modulus by the second invariant), Yeoh (with
    stiffening (I1 - 3)^2, in Pa)."""
    young, poisson, density, law, stiffening = 40e3, 0.46, 1050.0, "neo-Hooke", 0.0

    def deck(self, name, factor):
        shear = factor * self.young / (2 * (1 + self.poisson)) / 1e3
        d1 = 2 / (factor * self.young / (3 * (1 - 2 * self.poisson)) / 1e3)
        if self.law == "Yeoh":
            law = f"*HYPERELASTIC, YEOH\n{shear / 2:.9g}, {factor * self.stiffening / 1e3:.9g}, 0, {d1:.9g}, {d1:.9g}, {d1:.9g}"
        elif self.law == "Mooney-Rivlin":
            law = f"*HYPERELASTIC, MOONEY-RIVLIN\n{.8 * shear / 2:.9g}, {.2 * shear / 2:.9g}, {d1:.9g}"
        else:
            law = f"*HYPERELASTIC, NEO HOOKE\n{shear / 2:.9g}, {d1:.9g}"
        return f"*MATERIAL, NAME={name}\n{law}\n*DENSITY\n{self.density / MM**3:.9g}\n"


class Sheet:
    def __init__(self, xs, ys, thickness, material, factor=None, gravity=9.81):
        """factor(x, y): of Young's modulus at a place; a cell has its mean."""
        self.xs, self.ys, self.thickness, self.material, self.gravity = xs, ys, thickness, material, gravity
        self.shape = 2 * len(xs) - 1, 2 * len(ys) - 1, 3
        self.rest = np.stack(np.meshgrid(halves(xs), halves(ys), [0, thickness / 2, thickness], indexing="ij"), -1)
        odd = sum(np.indices(self.shape) % 2)
        self.number = np.where(odd < 2, np.cumsum(odd.ravel() < 2).reshape(self.shape), 0)  # 0: there is no node
        self.cells = np.stack([self.brick(i, j) for i in range(len(xs) - 1) for j in range(len(ys) - 1)])
        self.factors = np.array([self._mean(factor, i, j) for i in range(len(xs) - 1) for j in range(len(ys) - 1)])
        self.springs, self.pad, self.board, self.rising = [], np.zeros(self.shape, bool), "", []

    def brick(self, i, j):
        """Its nodes in the order of ccx."""
        n = self.number[2 * i:2 * i + 3, 2 * j:2 * j + 3]
        corner = [(0, 0), (2, 0), (2, 2), (0, 2)]
        middle = [(1, 0), (2, 1), (1, 2), (0, 1)]
        return [n[a][k] for k, places in ((0, corner), (2, corner), (0, middle), (2, middle), (1, corner)) for a in places]

    def _mean(self, factor, i, j):
        if factor is None:
            return 1.0
        within = (np.arange(12) + .5) / 12
        x, y = (v[k] + within * (v[k + 1] - v[k]) for v, k in ((self.xs, i), (self.ys, j)))
        return float(factor(*np.meshgrid(x, y, indexing="ij")).mean())

    # ---- what holds it --------------------------------------------------------------------------

    def clamp(self, stiffness, strip, holds=lambda x: True):
        """Springs of that many N/m3 under both faces from y = 0 to `strip`, a line of the grid, of the cells in whose
        middle holds(x). A node's share of a face is that of its mass, which is positive."""
        area = np.zeros(self.shape[:2])
        share = np.array([[3, 16, 3], [16, 0, 16], [3, 16, 3]]) / 76
        for i in range(len(self.xs) - 1):
            for j in range(int((self.ys[1:] < strip + 1e-9).sum())):
                if holds((self.xs[i] + self.xs[i + 1]) / 2):
                    area[2 * i:2 * i + 3, 2 * j:2 * j + 3] += share * (self.xs[i + 1] - self.xs[i]) * (self.ys[j + 1] - self.ys[j])
        self.springs += [(self.number[i, j, k], stiffness * area[i, j]) for i, j in np.argwhere(area > 0) for k in (0, 2)]

    def weights(self):
        """Of the nodes [N], as shape functions give them: corners are pulled up."""
        w = np.zeros(self.number.max() + 1)
        volume = np.outer(np.diff(self.xs), np.diff(self.ys)).ravel() * self.thickness
        share = np.array([-1 / 8] * 8 + [1 / 6] * 12)
        np.add.at(w, self.cells, volume[:, None] * share * self.material.density * self.gravity)
        return w

    def lie_on(self, friction, bump=None):
        """A board under the sheet, a brick or, with bump (x, y, radius, protrusion), a grid of them whose top rises to the
        cap of a ball while the sheet settles. The jaws' cells do not touch it."""
        margin = 0.02
        first = self.number.max() + 1
        spans = [np.array([-margin, v[-1] + margin]) for v in (self.xs, self.ys)]
        height = lambda x, y: 0 * x
        if bump:
            *centre, radius, protrusion = bump
            reach = np.sqrt(2 * radius * protrusion - protrusion**2)
            fine = np.linspace(-reach, reach, 2 * int(np.ceil(reach / BUMP_PITCH)) + 1)
            spans = [np.sort(np.append(s, c + fine)) for s, c in zip(spans, centre)]
            height = lambda x, y: np.maximum(0, protrusion - radius + np.sqrt(
                np.maximum(0, radius**2 - (x - centre[0])**2 - (y - centre[1])**2)))
        x, y = np.meshgrid(*spans, indexing="ij")
        count = first + np.arange(2 * x.size).reshape(2, *x.shape)
        low, top = count
        nodes = [f"{n}, {MM * a:.9g}, {MM * b:.9g}, {z}" for layer, z in ((low, -5), (top, 0))
                 for n, a, b in zip(layer.ravel(), x.ravel(), y.ravel())]
        square = lambda v: np.stack([v[:-1, :-1], v[1:, :-1], v[1:, 1:], v[:-1, 1:]], -1).reshape(-1, 4)
        bricks = np.concatenate([square(low), square(top)], 1)
        start = len(self.cells) + 3 * len(self.springs) + 1
        elements = [f"{start + k}, {', '.join(map(str, b))}" for k, b in enumerate(bricks)]
        held = self.pad[1::2, 1::2, 0].ravel()
        under = [f"{k + 1}, S1" for k in np.flatnonzero(~held)]
        stick = friction * self.material.density * self.gravity * self.thickness / 1e3 / BRISTLE_MM
        self.board = "\n".join(
            ["*NODE, NSET=BOARD", *nodes, "*ELEMENT, TYPE=C3D8, ELSET=BOARD", *elements,
             "*MATERIAL, NAME=BOARD", "*ELASTIC", "1e3, .3", "*SOLID SECTION, ELSET=BOARD, MATERIAL=BOARD",
             "*SURFACE, NAME=UNDER", *under, "*SURFACE, NAME=TOP", "BOARD, S2",
             "*SURFACE INTERACTION, NAME=TOUCH", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{BOARD}",
             "*FRICTION", f"{friction}, {stick:.9g}",
             "*CONTACT PAIR, INTERACTION=TOUCH, TYPE=SURFACE TO SURFACE", "UNDER, TOP",
             "*BOUNDARY", "BOARD, 1, 3", ""])
        rise = height(x, y)
        self.rising = [f"{n}, 3, 3, {MM * r:.9g}" for n, r in zip(top.ravel(), rise.ravel()) if r > 0]

    # ---- decks ----------------------------------------------------------------------------------

    def model(self):
        exists = self.number > 0
        out = ["*NODE, NSET=SHEET"]
        out += [f"{n}, {', '.join(f'{MM * c:.9g}' for c in x)}" for n, x in zip(self.number[exists], self.rest[exists])]
        out += ["*ELEMENT, TYPE=C3D20R, ELSET=SHEET"]
        out += [listed([k + 1, *b]) for k, b in enumerate(self.cells)]
        for m, factor in enumerate(np.unique(self.factors)):
            of = np.flatnonzero(self.factors == factor) + 1
            out += [self.material.deck(f"M{m}", factor), f"*ELSET, ELSET=E{m}", listed(of), f"*SOLID SECTION, ELSET=E{m}, MATERIAL=M{m}"]
        element = len(self.cells)  # without gaps: ccx keeps arrays up to the largest number
        for n, k in self.springs:
            for axis in (1, 2, 3):
                element += 1
                out += [f"*ELEMENT, TYPE=SPRING1, ELSET=S{element}", f"{element}, {n}", f"*SPRING, ELSET=S{element}", f"{axis}", f"{k:.9g}"]
        out += ["*NSET, NSET=FACES", listed(self.number[:, :, [0, 2]][exists[:, :, [0, 2]]])]
        if self.pad.any():
            out += ["*NSET, NSET=PAD", listed(self.number[self.pad & exists])]
        return "\n".join(out) + "\n" + self.board

    def settle(self):
        """The first step of every deck, to SETTLED."""
        out = ["*STEP, NLGEOM, INC=1000", "*STATIC", f"{.05 if self.rising else .5}, {SETTLED}, 1e-5, {.1 if self.rising else .5}"]
        out += ["*DLOAD", f"SHEET, GRAV, {MM * self.gravity:.9g}, 0, 0, -1"]
        if self.rising:
            out += ["*BOUNDARY", *self.rising]
        return "\n".join(out) + "\n"

    def held(self):
        """Numbers of the jaws' nodes."""
        return self.number[self.pad & (self.number > 0)]

    def settled(self):
        """-> displacement of every node [x][y][z][xyz] once it rests."""
        moved, _ = run(self.model() + self.settle() + "*NODE PRINT, NSET=SHEET, FREQUENCY=1000\nU\n*END STEP\n")
        return self.grid(moved[-1][1])

    def carried(self, places, way, wanted):
        """The jaws' nodes go to displacements `places` [increment][node][xyz], straight between; the first is where they are
        once the sheet has settled. way: how far they have gone, which is the deck's time: ccx first guesses that all goes on at
        its speed; longest increments are of 1. -> of the increments `wanted`: displacements of both faces
        [n][x][y][z][xyz], force of the tissue on the tool [n][xyz]."""
        nodes = self.held()
        deck = [self.model()]
        for n, node in zip(nodes, np.transpose(places, (1, 2, 0))):
            for axis, values in enumerate(node, 1):
                deck += [f"*AMPLITUDE, NAME=A{n}_{axis}", listed(f"{number:.9g}" for pair in zip(way, MM * values) for number in pair)]
        deck += ["*TIME POINTS, NAME=FRAMES", listed(f"{w:.9g}" for w in way[1:]), self.settle() + "*END STEP",
                 f"*STEP, NLGEOM, INC=100000\n*STATIC\n1., {way[-1]:.9g}, {SMALLEST}, 1."]
        for n in nodes:
            for axis in (1, 2, 3):
                deck += [f"*BOUNDARY, AMPLITUDE=A{n}_{axis}", f"{n}, {axis}, {axis}, 1."]
        deck += ["*NODE PRINT, NSET=FACES, TIME POINTS=FRAMES\nU", "*NODE PRINT, NSET=PAD, TOTALS=ONLY, TIME POINTS=FRAMES\nRF", "*END STEP\n"]
        moved, forces = run("\n".join(deck))
        pick = lambda rows: [rows[np.abs(np.array([t for t, _ in rows]) - SETTLED - way[k]).argmin()][1] for k in wanted]
        weight = np.array([0, 0, self.weights()[nodes].sum()])
        # What ccx prints is the jaws' pull and the weight of the nodes they hold, together.
        return np.array([self.grid(m) for m in pick(moved)]), np.array([-f / 1e3 - weight for f in pick(forces)])

    def grid(self, moved):
        """Displacements by node number, in mm, on the grid in m; in the middle of faces by the shape functions."""
        table = np.full((self.number.max() + 1, 3), np.nan)
        known = moved[:, 0].astype(int) <= self.number.max()
        table[moved[known, 0].astype(int)] = moved[known, 1:] / MM
        out = np.where((self.number > 0)[..., None], table[self.number], np.nan)
        f = out[:, :, [0, 2]]
        corners = f[:-2:2, :-2:2] + f[2::2, :-2:2] + f[:-2:2, 2::2] + f[2::2, 2::2]
        middles = f[1::2, :-2:2] + f[1::2, 2::2] + f[:-2:2, 1::2] + f[2::2, 1::2]
        f[1::2, 1::2] = middles / 2 - corners / 4
        out[:, :, [0, 2]] = f
        return out


def run(deck):
    """-> [(time, table of displacements)], [(time, total force)]"""
    folder = tempfile.mkdtemp(prefix="ccx")
    try:
        with open(os.path.join(folder, "sheet.inp"), "w", encoding="ascii") as f:
            f.write(deck)
        env = dict(os.environ, OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")
        done = subprocess.run([program(), "-i", "sheet"], cwd=folder, env=env, capture_output=True, text=True, check=False)
        if "Job finished" not in done.stdout or done.returncode:
            said = [line.strip() for line in done.stdout.splitlines() if "ERROR" in line]
            raise Diverged(last_time(os.path.join(folder, "sheet.sta")) - SETTLED, f"ccx: {said[0] if said else done.stdout[-300:]}")
        with open(os.path.join(folder, "sheet.dat"), encoding="ascii") as f:
            return tables(f.read())
    finally:
        shutil.rmtree(folder)


def last_time(path):
    """Total time of the last increment that ended well."""
    if not os.path.exists(path):
        return 0.0
    with open(path, encoding="ascii") as f:
        rows = [line.split() for line in f]
    return max([float(row[4]) for row in rows if len(row) == 7 and row[0].isdigit()], default=0.0)


def tables(text):
    moved, forces = [], []
    rows, into = [], None
    for line in text.splitlines() + ["time 0"]:
        if "time" in line:
            if into is not None and rows:
                into.append((time, np.array(rows) if into is moved else np.array(rows[0])))
            time, rows = float(line.split()[-1]), []
            into = moved if "displacements" in line else forces
        elif line.strip():
            rows.append([float(word) for word in line.split()])
    return moved, forces

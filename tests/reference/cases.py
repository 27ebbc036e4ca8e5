"""The cases that engines of others solve for comparison with the reference model, and the file format
of their results.

A sheet of 90 x 90 x 3 mm, density 1000 kg/m3, E at small strain, Poisson ratio 0.45, clamped where
y <= -42 mm, gravity along -z unless said. A result is a text file: lines "# key values", then one
line per point: x y z at rest, x y z deformed [m].
"""
from dataclasses import dataclass
from pathlib import Path

import numpy as np

RESULTS = Path(__file__).parent / "results"
GRAVITY = 9.80665
SIDE, CLAMP, THICKNESS, DENSITY, POISSON = 0.045, -0.042, 0.003, 1000.0, 0.45
STIFFNESSES = (2e4, 6e4, 2e5)


@dataclass
class Case:
    name: str
    young: float
    law: str = "neo_hooke"
    gravity: float = GRAVITY
    patch: tuple = ()  # x, y, radius [m]
    lift: tuple = (0.0, 0.0, 0.0)  # way of the patch [m]
    inclusion: tuple = ()  # x, y, radius [m], factor: see dolfinx_solid.Solid

    def header(self):
        lines = [f"# law {self.law}", f"# young {self.young!r}", f"# gravity {self.gravity!r}"]
        if self.patch:
            lines.append("# patch " + " ".join(map(repr, self.patch)))
            lines.append("# lift " + " ".join(map(repr, self.lift)))
        if self.inclusion:
            lines.append("# inclusion " + " ".join(map(repr, self.inclusion)))
        return lines


def static_cases(law="neo_hooke"):
    corner = dict(patch=(0.035, 0.035, 0.005), lift=(-0.003, -0.006, 0.03))
    kinds = {
        "hang": {},
        "corner": corner,
        "edge": dict(patch=(0.0, 0.038, 0.005), lift=(0.0, -0.008, 0.03)),
        "stretch": dict(patch=(0.0, 0.035, 0.005), lift=(0.0, 0.012, 0.0)),
        "inclusion": dict(inclusion=(0.0, 0.005, 0.02, 5.0), **corner),
    }
    return [Case(f"{kind}_{round(young / 1e3)}kPa", young, law, **options)
            for kind, options in kinds.items() for young in STIFFNESSES]


def dynamic_case():
    """Rests 0.1 s on a board at z = -1.5 mm, is pinched and lifted at 25 mm/s for 0.8 s."""
    return Case("board_60kPa", 6e4, patch=(0.035, 0.035, 0.005), lift=(-0.003, -0.005, 0.02))


# Of the dynamic case: step [s], steps before the grasp and of the lift, damping [1/s], friction and
# the speed below which it is smooth [m/s].
STEP, REST, LIFT, DAMPING, FRICTION, SLIP = 0.02, 5, 40, 5.0, 0.3, 1e-3
FRAMES = (15, 25, 35, 45)  # steps after which the surface is stored

# Of the lifts off a board, where the jaws close: x_B, y_B of the centre [m]; three on the free edge, one on each side.
PINCHES = [(-0.0335, 0.0385), (0.0042, 0.0395), (0.0362, 0.0371), (-0.0393, 0.0048), (0.0387, 0.0151)]
# Height of the jaws [m] at times [s], of each five lifts; they also move towards the clamp by a fifth of it.
HEIGHTS = [[(0, 0), (0.1, 0), (0.5, 0.01), (0.9, 0.01), (1.3, 0.02), (1.7, 0.02), (2.1, 0.03), (2.7, 0.03),
            (3.5, 0.01), (4.0, 0.01)],
           [(0, 0), (0.1, 0), (0.5, 0.01), (1.3, 0.01), (1.6, 0.004), (2.0, 0.004)],
           [(0, 0), (0.1, 0), (0.9, 0.02), (1.7, 0.02), (2.2, 0.008), (2.5, 0.008)]]


def write_result(name, case, extra, points, remarks=()):
    RESULTS.mkdir(exist_ok=True)
    lines = case.header() + [f"# {remark}" for remark in remarks]
    lines += [f"# {key} " + " ".join(f"{v:.9g}" for v in values) for key, values in extra.items()]
    lines += [" ".join(f"{v:.9g}" for v in row) for row in points]
    (RESULTS / f"{name}.txt").write_text("\n".join(lines) + "\n")


def graded_lines(low, high, count, kinks):
    """Lines between low and high, one on each of the kinks (place, reach) and denser there."""
    samples = 4000
    step = (high - low) / samples
    middle = low + (np.arange(samples) + 0.5) * step
    density = np.ones(samples)
    for at, reach in kinks:
        density = np.maximum(density, 1 + 2 / (1 + ((middle - at) / reach) ** 2))
    edges = low + np.arange(samples + 1) * step
    number = np.concatenate([[0], np.cumsum(density)])
    number *= count / number[-1]
    fixed = {0: low, count: high}
    for at, _ in kinks:
        if low + 1e-9 < at < high - 1e-9:
            fixed.setdefault(int(np.floor(np.interp(at, edges, number) + 0.5)), at)
    lines = []
    keys = sorted(fixed)
    for a, b in zip(keys[:-1], keys[1:]):
        from_, to = np.interp(fixed[a], edges, number), np.interp(fixed[b], edges, number)
        for k in range(b - a):
            lines.append(fixed[a] if k == 0 else
                         float(np.interp(from_ + (to - from_) * k / (b - a), number, edges)))
    return lines + [high]


def reference_lines(case, elements, layers):
    """Grid lines of the free sheet, graded at the clamp and at the patch."""
    kinks = [[], [(CLAMP, 0.1 * (SIDE - CLAMP))]]
    if case.patch:
        for axis in range(2):
            for sign in (-1, 1):
                kinks[axis].append((case.patch[axis] + sign * case.patch[2], case.patch[2]))
    return [graded_lines(-SIDE, SIDE, elements, kinks[0]),
            graded_lines(CLAMP, SIDE, elements, kinks[1]),
            list(np.linspace(-THICKNESS / 2, THICKNESS / 2, layers + 1))]


def disc_points(centre, radius, low, high):
    """Points and weights over the disc as far as it lies in [low, high]: 64 rays in four parts with
    five Gauss points each, which is the definition of the grasp patch (patch_points)."""
    at, weight = np.polynomial.legendre.leggauss(5)
    at = np.concatenate([(part + (at + 1) / 2) / 4 for part in range(4)])
    weight = np.tile(weight, 4)
    points, weights = [], []
    for ray in range(64):
        angle = 2 * np.pi * (ray + 0.5) / 64
        d = np.array([np.cos(angle), np.sin(angle)])
        length = radius
        for axis in range(2):
            if d[axis] > 1e-12:
                length = min(length, (high[axis] - centre[axis]) / d[axis])
            if d[axis] < -1e-12:
                length = min(length, (low[axis] - centre[axis]) / d[axis])
        for a, w in zip(at, weight):
            points.append(centre + a * length * d)
            weights.append(w * length * a * length)
    return np.array(points), np.array(weights) / np.sum(weights)


def mid_surface_points():
    """Every fifth particle of the 31 x 31 grid, clamped ones left out."""
    grid = np.linspace(-SIDE, SIDE, 7)
    return [(x, y, 0.0) for x in grid for y in grid if y > CLAMP]

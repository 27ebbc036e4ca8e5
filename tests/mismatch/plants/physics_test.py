#!/usr/bin/python3
"""The plant's sheet keeps to laws that are known without it. Ends with 77 where DOLFINx is missing."""
import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, "/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real/lib/python3/dist-packages")
try:
    import dolfinx  # noqa: F401
except ImportError:
    print("no DOLFINx here")
    sys.exit(77)

import numpy as np

import fenics_sheet
import fenics_surface as faces

NOBODY = lambda share: np.zeros((0, 3))


def clamped(young, poisson, length=.05, strip=.006, cells=5, bed=1e11):
    m = fenics_sheet.Material()
    m.young, m.poisson, m.rate_time, m.mass_rate = young, poisson, 0.0, 0.0
    s = fenics_sheet.Sheet(np.linspace(0, .03, 4), fenics_sheet.lines([0, strip, strip + length], cells + 1), .003, m)
    s.terms = [faces.Bed(face, bed, (face.rest[..., 1] < strip) * 1.0) for face in (s.lower, s.upper)]
    s.start()
    return s


def free_edge(s):
    return (s.positions() - s.rest)[s.grid[:, -1, 1], 2].mean()


def a_sheet_in_the_air_bends_as_a_beam():
    """w = q L^4 / (8 D) with Poisson's ratio 0."""
    s = clamped(2e7, 0.0)
    s.material.mass_rate = 1000.0
    for h in (1, 10, 100):
        s.step(h, NOBODY)
        s.halt()
    q, D = 1050 * 9.81 * .003, 2e7 * .003**3 / 12
    ratio = free_edge(s) / (-q * .05**4 / (8 * D))
    print(f"hanging beam: {ratio:.4f} of theory")
    return abs(ratio - 1) < .02  # shear and the give of the clamp's edge are in it


def jaws_feel_what_a_beam_answers():
    """An end that is held level and lifted by d answers with 12 D b d / L^3, L up to the jaws."""
    s = clamped(2e7, 0.0)
    s.pad = s.grid[:, -3:, :].ravel()
    p, d = s.positions()[s.pad], 2e-4
    force = []
    for lift in (0, d):
        for h in (10, 100):
            s.step(h, lambda share: p + [0, 0, lift])
            s.halt()
        force.append(s.force[2])
    D, length = 2e7 * .003**3 / 12, s.rest[s.grid[0, -3, 0], 1] - .006
    ratio = (force[0] - force[1]) / (12 * D * .03 * d / length**3)
    print(f"lifted end: {ratio:.4f} of theory")
    return abs(ratio - 1) < .04


def a_sheet_let_go_comes_to_rest_below_the_energy_it_had():
    s = clamped(5e4, .4, bed=1e8)
    s.terms.append(faces.Board(s.lower, .3, np.ones(s.lower.area.shape)))
    s.material.rate_time, s.material.mass_rate = .008, .5
    s.start()
    s.velocity[:, 2] = .3 * s.rest[:, 1] / .056
    s.velocity[s.rest[:, 1] < .007] = 0
    energies = []
    for step in range(31):
        if step:
            s.step(.01, NOBODY)
        for number in (s.inertia, s.drag, s.rate):
            number.value = 0.0
        energies.append(s.potential() + .5 * (s.mass.reshape(-1, 3) * s.velocity**2).sum())
    print(f"energy at first {energies[0] * 1e6:.1f} uJ, largest later {max(energies[1:]) * 1e6:.1f}, at last {energies[-1] * 1e6:.1f}")
    return max(energies[1:]) < energies[0] and abs(energies[-1]) < .05 * energies[0]


if __name__ == "__main__":
    laws = [a_sheet_in_the_air_bends_as_a_beam, jaws_feel_what_a_beam_answers, a_sheet_let_go_comes_to_rest_below_the_energy_it_had]
    broken = [law.__name__ for law in laws if not law()]
    sys.exit(f"broken: {', '.join(broken)}" if broken else 0)

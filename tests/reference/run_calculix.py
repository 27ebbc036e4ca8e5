"""Solves the cases with CalculiX (Debian: calculix-ccx) and stores the results.

/usr/bin/python3 run_calculix.py ELEMENTS LAYERS [CASE ...]
                                      20-node bricks C3D20R, stored results: 16 2
/usr/bin/python3 run_calculix.py law  which laws CalculiX means, from one element

*ELASTIC with NLGEOM is the law of St. Venant-Kirchhoff: S = lambda tr(E) I + 2 mu E. *HYPERELASTIC,
NEO HOOKE is C10 (J^(-2/3) tr C - 3) + (J - 1)^2 / D1, which is not the neo-Hooke law of
sim_worker/reference/hyperelastic_law.h: `law` shows both.
"""
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from cases import (Case, DENSITY, POISSON, THICKNESS, disc_points, mid_surface_points,
                   reference_lines, static_cases, write_result)

# Local coordinates of the 20 nodes in CalculiX's order.
CORNERS = [(-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1),
           (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1)]
EDGES = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4),
         (0, 4), (1, 5), (2, 6), (3, 7)]
LOCAL = np.array(CORNERS + [tuple((np.array(CORNERS[a]) + CORNERS[b]) // 2) for a, b in EDGES])


def shape_functions(xi):
    N = np.empty(20)
    for a, node in enumerate(LOCAL):
        terms = 1 + xi * node
        if a < 8:
            N[a] = np.prod(terms) * (xi @ node - 2) / 8
        else:
            axis = int(np.flatnonzero(node == 0)[0])
            N[a] = (1 - xi[axis] ** 2) * np.prod(np.delete(terms, axis)) / 4
    return N


class Mesh:
    def __init__(self, lines):
        """Bricks of 20 nodes between the lines."""
        self.lines = [np.asarray(line) for line in lines]
        index, self.nodes, self.elements = {}, [], []
        n = [len(line) - 1 for line in lines]
        # Half-cell lattice: odd indices are the middles of edges.
        fine = [np.interp(np.arange(2 * k + 1) / 2, np.arange(k + 1), line)
                for k, line in zip(n, self.lines)]
        for iz in range(n[2]):
            for iy in range(n[1]):
                for ix in range(n[0]):
                    element = []
                    for local in LOCAL:
                        at = tuple(2 * np.array([ix, iy, iz]) + 1 + local)
                        if at not in index:
                            index[at] = len(self.nodes)
                            self.nodes.append([fine[axis][at[axis]] for axis in range(3)])
                        element.append(index[at])
                    self.elements.append(element)
        self.nodes = np.array(self.nodes)
        self.n = n

    def weights_at(self, point):
        cell, xi = [], []
        for axis in range(3):
            line = self.lines[axis]
            k = int(np.clip(np.searchsorted(line, point[axis], side="right") - 1, 0,
                            len(line) - 2))
            cell.append(k)
            xi.append(2 * (point[axis] - line[k]) / (line[k + 1] - line[k]) - 1)
        element = (cell[2] * self.n[1] + cell[1]) * self.n[0] + cell[0]
        return self.elements[element], shape_functions(np.array(xi))


def patch_rows(mesh, centre, radius):
    low = np.array([mesh.lines[0][0], mesh.lines[1][0]])
    high = np.array([mesh.lines[0][-1], mesh.lines[1][-1]])
    points, weights = disc_points(np.array(centre), radius, low, high)
    mean = weights @ points
    rows = np.zeros((4, len(mesh.nodes)))
    half = THICKNESS / 2
    gauss, share = np.polynomial.legendre.leggauss(3)
    for p, weight in zip(points, weights):
        for a, b in zip(mesh.lines[2][:-1], mesh.lines[2][1:]):
            for zeta, part in zip(gauss, share / 2):
                z = (a + b) / 2 + zeta * (b - a) / 2
                nodes, N = mesh.weights_at((p[0], p[1], z))
                slopes = [1, (p[0] - mean[0]) / radius, (p[1] - mean[1]) / radius, z / half]
                rows[:, nodes] += weight * part * (b - a) / (2 * half) * np.outer(slopes, N)
    return rows


def write_list(out, items, per_line=12):
    for k in range(0, len(items), per_line):
        out.append(", ".join(str(i) for i in items[k:k + per_line]) + ",")


def inclusion_at(case, nodes):
    """E relative to that of the sheet, from 1 to the factor; dolfinx_solid.Solid has the same."""
    x, y, radius, factor = case.inclusion
    far2 = ((nodes[:, 0] - x) ** 2 + (nodes[:, 1] - y) ** 2) / radius**2
    return 1 + (factor - 1) * np.maximum(0, 1 - far2) ** 2


def material(case, factor=1.0):
    mu = case.young / (2 * (1 + POISSON))
    bulk = case.young / (3 * (1 - 2 * POISSON))
    if case.law == "st_venant_kirchhoff":
        return ["*ELASTIC", f"{factor * case.young:.12e}, {POISSON}"]
    return ["*HYPERELASTIC, NEO HOOKE", f"{mu / 2:.12e}, {2 / bulk:.12e}"]


def sections(mesh, case):
    """Materials and which elements have them. Of an inclusion every stiffness is one of its own,
    that at the centre of the element, as in the reference model."""
    factors = np.ones(len(mesh.elements))
    if case.inclusion:
        centres = np.array([mesh.nodes[element[:8]].mean(axis=0) for element in mesh.elements])
        factors = np.round(inclusion_at(case, centres), 12)
    out = []
    for m, factor in enumerate(np.unique(factors)):
        out.append(f"*ELSET, ELSET=PART{m}")
        write_list(out, [e + 1 for e in np.flatnonzero(factors == factor)])
        out += [f"*MATERIAL, NAME=TISSUE{m}"] + material(case, factor)
        out += ["*DENSITY", str(DENSITY), f"*SOLID SECTION, ELSET=PART{m}, MATERIAL=TISSUE{m}"]
    return out


def write_deck(mesh, case, path):
    """Numbers of 20 characters at most: CalculiX cuts off the rest."""
    out = ["*NODE, NSET=ALL"]
    out += [f"{i + 1}, {p[0]:.12e}, {p[1]:.12e}, {p[2]:.12e}" for i, p in enumerate(mesh.nodes.tolist())]
    control = len(mesh.nodes) + 1
    if case.patch:
        out += ["*NODE, NSET=CONTROL", f"{control}, 0, 0, 0.1"]
    out.append("*ELEMENT, TYPE=C3D20R, ELSET=SHEET")
    for e, element in enumerate(mesh.elements):
        names = [str(i) for i in [e + 1] + [node + 1 for node in element]]
        if len(names) > 11:
            out.append(", ".join(names[:11]) + ",")
            names = names[11:]
        out.append(", ".join(names))
    out.append("*NSET, NSET=CLAMP")
    write_list(out, [i + 1 for i in np.flatnonzero(mesh.nodes[:, 1] < mesh.lines[1][0] + 1e-9)])
    if case.patch:
        # Row r of the patch: sum_k rows[r, k] u_k = lift (r = 0) or 0. Solved for four nodes, so
        # that no node depends on one that depends itself.
        rows = patch_rows(mesh, case.patch[:2], case.patch[2])
        used = np.flatnonzero(np.abs(rows).sum(axis=0) > 0)
        pivots, left = [], rows[:, used].copy()
        for _ in range(4):  # pivoted elimination
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
                out += ["*EQUATION", str(len(terms))]
                for k in range(0, len(terms), 4):
                    out.append(", ".join(f"{node}, {axis}, {c:.12e}"
                                         for node, c in terms[k:k + 4]))
    out += sections(mesh, case) + ["*BOUNDARY", "CLAMP, 1, 3"]
    # Residual force relative to the mean force, of which the patch has most: by default 0.5 %.
    out += ["*STEP, NLGEOM, INC=2000", "*STATIC", "0.1, 1., 1e-7, 0.25",
            "*CONTROLS, PARAMETERS=FIELD", "1e-7, 1e-5, , , 1e-7",
            "*CONTROLS, PARAMETERS=TIME INCREMENTATION", "8, 16, 9, 32, 10, 4, , 10",
            "*DLOAD", f"SHEET, GRAV, {case.gravity}, 0., 0., -1."]
    if case.patch:
        out.append("*BOUNDARY")
        out += [f"{control}, {axis + 1}, {axis + 1}, {case.lift[axis]}" for axis in range(3)]
    out += ["*NODE PRINT, NSET=ALL, FREQUENCY=100000", "U"]
    out += ["*NODE PRINT, NSET=CLAMP, FREQUENCY=100000", "RF", "*END STEP"]
    path.write_text("\n".join(out) + "\n")


def read_blocks(path):
    """Last block of each quantity in a .dat file: {name: {node: values}}."""
    blocks, current = {}, None
    for line in path.read_text().splitlines():
        words = line.split()
        if not words:
            continue
        if not words[0].isdigit():
            current = blocks[words[0]] = {}
        else:
            current[int(words[0])] = [float(w) for w in words[1:4]]
    return blocks


def held_force(mesh, case, clamp_forces):
    """Of the tissue on the tool [N]: CalculiX prints no force of an *EQUATION, but what stresses
    carry into the clamp and the weight leave only this."""
    weight = np.zeros(len(mesh.nodes))
    for element in mesh.elements:
        volume = np.prod(mesh.nodes[element[6]] - mesh.nodes[element[0]])
        share = [-1 / 8] * 8 + [1 / 6] * 12
        weight[element] += DENSITY * case.gravity * volume * np.array(share)
    clamped = mesh.nodes[:, 1] < mesh.lines[1][0] + 1e-9
    total = np.sum([values for values in clamp_forces.values()], axis=0)
    return total - np.array([0, 0, weight[~clamped].sum()])


def ccx(folder, name):
    done = subprocess.run(["ccx", name], cwd=folder, capture_output=True, text=True)
    if "Job finished" not in done.stdout:
        raise RuntimeError(done.stdout[-1500:])


def version():
    """Of CalculiX, as it says itself."""
    said = subprocess.run(["ccx", "-v"], capture_output=True, text=True).stdout
    return said.split("Version")[1].split()[0]


def solve(mesh, case):
    """Displacements of the nodes [m] and the force on the tool [N]."""
    with tempfile.TemporaryDirectory() as folder:
        write_deck(mesh, case, Path(folder) / "case.inp")
        ccx(folder, "case")
        blocks = read_blocks(Path(folder) / "case.dat")
    u = np.array([blocks["displacements"][i + 1] for i in range(len(mesh.nodes))])
    force = held_force(mesh, case, blocks["forces"]) if case.patch else np.zeros(3)
    return u, force


def run(case, elements, layers):
    begin = time.time()
    mesh = Mesh(reference_lines(case, elements, layers))
    u, force = solve(mesh, case)
    points = []
    for p in mid_surface_points():
        nodes, N = mesh.weights_at(p)
        points.append(tuple(p) + tuple(np.array(p) + N @ u[nodes]))
    write_result(f"calculix_{case.name}", case,
                 {"force": force, "elements": [elements, elements, layers]}, points,
                 [f"engine CalculiX {version()}", "element C3D20R"])
    print(f"{case.name}: force {1e3 * force} mN, {time.time() - begin:.1f} s", flush=True)


def check_laws():
    """Stretches one brick by given amounts and compares CalculiX's Cauchy stress with the laws as
    the module says they are."""
    stretch = np.array([1.3, 0.9, 0.85])
    young = 1e4
    mu, lam = young / (2 * (1 + POISSON)), young * POISSON / ((1 + POISSON) * (1 - 2 * POISSON))
    bulk = lam + 2 * mu / 3
    J, C = stretch.prod(), stretch**2
    green = (C - 1) / 2
    expected = {
        "st_venant_kirchhoff": C / J * (lam * green.sum() + 2 * mu * green),
        "calculix_neo_hooke": mu * J ** (-5 / 3) * (C - C.mean()) + bulk * (J - 1),
        "neo_hooke": (mu * (C - 1) + lam * np.log(J)) / J,
    }
    for law in ("st_venant_kirchhoff", "calculix_neo_hooke"):
        out = ["*NODE, NSET=ALL"]
        corners = (np.array(CORNERS) + 1) / 2
        out += [f"{i + 1}, {p[0]}, {p[1]}, {p[2]}" for i, p in enumerate(corners)]
        out += ["*ELEMENT, TYPE=C3D8, ELSET=BRICK", "1, 1, 2, 3, 4, 5, 6, 7, 8"]
        out += ["*MATERIAL, NAME=TISSUE"] + material(Case("", young, law))
        out += ["*SOLID SECTION, ELSET=BRICK, MATERIAL=TISSUE", "*STEP, NLGEOM", "*STATIC", "0.1, 1.",
                "*BOUNDARY"]
        out += [f"{i + 1}, {axis + 1}, {axis + 1}, {(stretch[axis] - 1) * p[axis]:.12e}"
                for i, p in enumerate(corners) for axis in range(3)]
        out += ["*EL PRINT, ELSET=BRICK, FREQUENCY=100000", "S", "*END STEP"]
        with tempfile.TemporaryDirectory() as folder:
            (Path(folder) / "law.inp").write_text("\n".join(out) + "\n")
            ccx(folder, "law")
            rows = [line.split() for line in (Path(folder) / "law.dat").read_text().splitlines()]
        found = np.array([float(w) for w in [row for row in rows if len(row) == 8][-1][2:5]])
        print(f"{law}: CalculiX {found} Pa, formula {expected[law]} Pa")
        assert np.allclose(found, expected[law], rtol=1e-5)
    print(f"neo_hooke of hyperelastic_law.h would be {expected['neo_hooke']} Pa")


if __name__ == "__main__":
    if sys.argv[1:] == ["law"]:
        check_laws()
        sys.exit()
    for each in static_cases("st_venant_kirchhoff"):
        if sys.argv[3:] and each.name not in sys.argv[3:]:
            continue
        try:
            run(each, int(sys.argv[1]), int(sys.argv[2]))
        except RuntimeError as error:
            print(f"{each.name}: CalculiX gave up: {str(error)[-300:]}", flush=True)

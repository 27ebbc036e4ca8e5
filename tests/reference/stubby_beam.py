#!/usr/bin/env python3
"""Sag of a stubby, nearly incompressible beam by CalculiX: the figure that tests/sim_worker/solid/solid_test.cpp compares with.

A box 30 x 30 x 100 mm, one end clamped, E 1 MPa, 1000 kg/m3, gravity across; quadratic bricks with reduced integration
(C3D20R), small strain. Needs ccx (Debian package calculix-ccx). Prints the mean sag of the nodes of the free end:

    nu 0.3  8 x 28 x 8   1.74136 mm        nu 0.49  8 x 28 x 8   1.67124 mm   (6 x 20 x 6: 1.66409 mm)
"""
import pathlib
import subprocess
import tempfile

SIZE_M = (0.03, 0.1, 0.03)
# Corners of a C3D20 element on the half grid, then the middles of its edges, in CalculiX's order.
CORNERS = [(0, 0, 0), (2, 0, 0), (2, 2, 0), (0, 2, 0), (0, 0, 2), (2, 0, 2), (2, 2, 2), (0, 2, 2)]
MIDDLES = [(1, 0, 0), (2, 1, 0), (1, 2, 0), (0, 1, 0), (1, 0, 2), (2, 1, 2), (1, 2, 2), (0, 1, 2),
           (0, 0, 1), (2, 0, 1), (2, 2, 1), (0, 2, 1)]


def write_deck(path, elements, nu):
    numbers = {}
    bricks = []
    for i in range(elements[0]):
        for j in range(elements[1]):
            for k in range(elements[2]):
                grid = [(2 * i + a, 2 * j + b, 2 * k + c) for a, b, c in CORNERS + MIDDLES]
                bricks.append([numbers.setdefault(g, len(numbers) + 1) for g in grid])
    place = lambda g: ",".join(f"{g[a] * SIZE_M[a] / (2 * elements[a]):.12g}" for a in range(3))
    fixed = [str(n) for g, n in numbers.items() if g[1] == 0]
    tip = [str(n) for g, n in numbers.items() if g[1] == 2 * elements[1]]
    lines = ["*NODE, NSET=ALL"] + [f"{n},{place(g)}" for g, n in numbers.items()]
    lines.append("*ELEMENT, TYPE=C3D20R, ELSET=E")
    for n, brick in enumerate(bricks, 1):
        lines += [f"{n}," + ",".join(map(str, brick[:15])) + ",", ",".join(map(str, brick[15:]))]
    lines += ["*NSET, NSET=FIXED", *fixed, "*NSET, NSET=TIP", *tip]
    lines += ["*MATERIAL, NAME=M", "*ELASTIC", f"1e6,{nu}", "*DENSITY", "1000",
              "*SOLID SECTION, ELSET=E, MATERIAL=M", "*BOUNDARY", "FIXED,1,3", "*STEP", "*STATIC",
              "*DLOAD", "E,GRAV,9.81,0,0,-1", "*NODE PRINT, NSET=TIP", "U", "*END STEP", ""]
    path.write_text("\n".join(lines))


def sag_m(elements, nu):
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        write_deck(folder / "beam.inp", elements, nu)
        subprocess.run(["ccx", "beam"], cwd=folder, check=True, stdout=subprocess.DEVNULL)
        rows = [line.split() for line in (folder / "beam.dat").read_text().splitlines()]
        values = [float(row[3]) for row in rows if len(row) == 4 and row[0].isdigit()]
    return -sum(values) / len(values)


if __name__ == "__main__":
    for nu in (0.3, 0.49):
        for elements in ((4, 12, 4), (6, 20, 6), (8, 28, 8)):
            print(f"nu {nu}  {elements}  {1e3 * sag_m(elements, nu):.5f} mm", flush=True)

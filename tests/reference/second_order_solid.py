"""Static states of a soft box in DOLFINx (Debian's 0.5.2) with 27-node bricks, 3 x 3 x 3 points, on
graded grids; large strain, the laws of sim_worker/reference/hyperelastic_law.h.

Lengths in m, forces in N, coordinates those of the body's frame B, weight along -z.
"""
import sys

sys.path.insert(0, "/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real/lib/python3/dist-packages")

import logging

import dolfinx
import numpy as np
import scipy.sparse
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

logging.disable(logging.INFO)
JIT = {"cffi_extra_compile_args": ["-O3", "-march=native"]}
TOLERANCE = 1e-9  # of the residual [N]


def lame(young, poisson):
    return (young / (2 * (1 + poisson)),
            young * poisson / ((1 + poisson) * (1 - 2 * poisson)))


def energy_density(law, F, mu, lam):
    """Psi(F) [J/m^3]."""
    C = F.T * F
    first = ufl.tr(C)
    J = ufl.det(F)
    if law == "neo_hooke":
        return mu / 2 * (first - 3 - 2 * ufl.ln(J)) + lam / 2 * ufl.ln(J) ** 2
    if law == "st_venant_kirchhoff":
        E = (C - ufl.Identity(3)) / 2
        return mu * ufl.inner(E, E) + lam / 2 * ufl.tr(E) ** 2
    if law == "corotated":
        # |F - R|^2 = tr C - 2 tr U + 3. tr U is the largest root of
        # s^4 - 2 I s^2 - 8 J s + I^2 - 4 II, I and II the invariants of C; from sqrt(3 I) >= tr U
        # Newton's method falls to it.
        second = (first**2 - ufl.tr(C * C)) / 2
        s = ufl.sqrt(3 * first)
        for _ in range(5):
            p = s**4 - 2 * first * s**2 - 8 * J * s + first**2 - 4 * second
            s = s - p / (4 * s**3 - 4 * first * s - 8 * J)
        return mu * (first - 2 * s + 3) + lam / 2 * (s - 3) ** 2
    raise ValueError(law)


def quadratic(s):
    """Shape functions of the nodes 0, 1/2, 1 at s."""
    return np.array([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)])


class Solid:
    def __init__(self, lines, law, young, poisson, density, gravity, clamp, mirrored=False,
                 stiffness=None, bed=0.0):
        """lines: grid lines along x, y, z. Nodes with y <= clamp are fixed, or, with `bed` [N/m^4],
        material there is on springs to where it was. mirrored: x = lines[0][0] is a plane of
        symmetry. stiffness: UFL factor on the Lame constants as a function of x."""
        self.lines = [np.asarray(line, float) for line in lines]
        self.mirrored = mirrored
        n = [len(line) - 1 for line in self.lines]
        self.mesh = mesh.create_box(MPI.COMM_SELF, [[0, 0, 0], n], n, mesh.CellType.hexahedron)
        index = self.mesh.geometry.x.copy()
        for axis in range(3):
            self.mesh.geometry.x[:, axis] = self.lines[axis][np.rint(index[:, axis]).astype(int)]
        self.space = fem.VectorFunctionSpace(self.mesh, ("Lagrange", 2))
        self.w = fem.Function(self.space)
        self.nodes = self.space.tabulate_dof_coordinates()
        self.number_cells(index, n)
        x = ufl.SpatialCoordinate(self.mesh)
        mu, lam = (c * (stiffness(x) if stiffness else 1) for c in lame(young, poisson))
        v = ufl.TestFunction(self.space)
        dx = ufl.Measure("dx", metadata={"quadrature_degree": 4})
        energy = energy_density(law, ufl.Identity(3) + ufl.grad(self.w), mu, lam) * dx
        if bed:
            energy += ufl.conditional(ufl.lt(x[1], clamp), bed / 2, 0) * ufl.inner(self.w, self.w) * dx
        force = ufl.derivative(energy, self.w, v)
        self.force_form = fem.form(force, jit_params=JIT)
        self.tangent_form = fem.form(ufl.derivative(force, self.w), jit_params=JIT)
        ones = fem.Constant(self.mesh, PETSc.ScalarType((1.0, 1.0, 1.0)))
        self.mass = density * fem.petsc.assemble_vector(fem.form(ufl.dot(ones, v) * dx)).array
        self.whole_weight = np.zeros_like(self.mass)
        self.whole_weight[2::3] = -gravity * self.mass[2::3]
        self.carry(1.0)
        fixed = np.zeros((len(self.nodes), 3), bool)
        if not bed:
            fixed[self.nodes[:, 1] < clamp + 1e-9] = True
        clamped = fixed.ravel()
        plane = mirrored & (self.nodes[:, 0] < self.lines[0][0] + 1e-9)
        self.fixed = clamped | (plane[:, None] & [True, False, False]).ravel()
        self.fixed_aside = clamped | (plane[:, None] & [False, True, True]).ravel()
        self.A = fem.petsc.create_matrix(self.tangent_form)
        self.A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self.A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.solver = PETSc.KSP().create(MPI.COMM_SELF)
        self.solver.setOperators(self.A)
        self.solver.setType("preonly")
        self.solver.getPC().setType("cholesky")
        self.solver.getPC().setFactorSolverType("mumps")
        self.grip = None
        self.newton = 0

    # ---- points ------------------------------------------------------------------------------

    def number_cells(self, index, n):
        """grid[ix, iy, iz]: nodes of the cell, [x][y][z] each of 0, 1/2, 1."""
        corners = index[self.mesh.geometry.dofmap.array.reshape(-1, 8)]
        cell = np.rint(corners.min(axis=1)).astype(int)
        self.grid = np.zeros((*n, 27), int)
        for k, (i, j, l) in enumerate(cell):
            nodes = self.space.dofmap.cell_dofs(k)
            place = 0
            for axis, c in enumerate((i, j, l)):
                low, high = self.lines[axis][c], self.lines[axis][c + 1]
                place = 3 * place + np.rint(
                    2 * (self.nodes[nodes, axis] - low) / (high - low)).astype(int)
            self.grid[i, j, l, place] = nodes

    def weights_at(self, point):
        """Nodes and shape function values at a point."""
        cell, N = [], np.ones(1)
        for axis in range(3):
            line = self.lines[axis]
            c = int(np.clip(np.searchsorted(line, point[axis], "right") - 1, 0, len(line) - 2))
            cell.append(c)
            N = np.outer(N, quadratic((point[axis] - line[c]) / (line[c + 1] - line[c]))).ravel()
        return self.grid[tuple(cell)], N

    def displacement(self):
        return self.w.x.array.reshape(-1, 3)

    def point(self, point):
        """Where a point of the body is; beyond a plane of symmetry by reflection."""
        sign = -1 if self.mirrored and point[0] < self.lines[0][0] else 1
        at = np.array([sign * point[0], point[1], point[2]])
        nodes, N = self.weights_at(at)
        return (at + N @ self.displacement()[nodes]) * [sign, 1, 1]

    def start_from(self, other):
        """Displacement of a solid with another grid."""
        for k, p in enumerate(self.nodes):
            self.displacement()[k] = other.point(p) - p

    # ---- equilibrium -------------------------------------------------------------------------

    def carry(self, share):
        """Only so much of its weight, at most 1."""
        self.share = share
        self.weight = share * self.whole_weight

    def state(self):
        return self.w.x.array.copy(), self.grip.state() if self.grip else None, self.share

    def return_to(self, state):
        self.w.x.array[:] = state[0]
        if self.grip:
            self.grip.move(self, state[1], 0, None)
        self.carry(state[2])

    def residual(self, pull, before):
        r = fem.petsc.assemble_vector(self.force_form).array.copy()
        r += self.mass * pull * (self.w.x.array - before) - self.weight
        if self.grip:
            self.grip.add_force(self, r)
        free = r.copy()
        free[self.fixed] = 0
        if self.grip:
            free[self.grip.prescribed] = 0
        miss = self.grip.miss(self, r) if self.grip else np.zeros(0)
        return r, np.hypot(np.linalg.norm(free), np.linalg.norm(miss))

    def tangent(self, pull):
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self.tangent_form)
        self.A.assemble()
        if pull:
            shift = self.A.createVecRight()
            shift.array[:] = pull * self.mass
            self.A.setDiagonal(shift, addv=PETSc.InsertMode.ADD_VALUES)

    def factor(self, prescribed):
        """Of the tangent without the rows and columns of what is prescribed."""
        rows = np.flatnonzero(self.fixed)
        rows = np.union1d(rows, prescribed).astype(np.int32)
        self.A.zeroRowsColumns(rows, 1.0)
        self.solver.setUp()

    def solve_linear(self, b):
        rhs, out = self.A.createVecs()
        rhs.array[:] = b
        self.solver.solve(rhs, out)
        return out.array.copy()

    def direction(self, r, pull):
        self.tangent(pull)
        if self.grip:
            return self.grip.direction(self, r)
        self.factor(np.zeros(0, int))
        return self.solve_linear(np.where(self.fixed, 0, -r)), None

    def solve(self, pull=0.0, iterations=25):
        """Newton's method, with springs pull * mass to where the body is. False: w is as it was."""
        start = self.state()
        before = start[0]
        r, norm = self.residual(pull, before)
        done = False
        for _ in range(iterations):
            if norm <= TOLERANCE:
                done = True
                break
            self.newton += 1
            try:
                d, more = self.direction(r, pull)
            except PETSc.Error:
                break
            at = self.w.x.array.copy()
            grip_at = self.grip.state() if self.grip else None
            share = 1.0
            while share > 1e-3:
                self.w.x.array[:] = at + share * d
                if self.grip:
                    self.grip.move(self, grip_at, share, more)
                r, trial = self.residual(pull, before)
                if np.isfinite(trial) and trial < max(10 * norm, 1e-2):
                    break
                share /= 2
            else:
                break
            norm = trial
        if done or norm <= 30 * TOLERANCE:
            return True
        self.return_to(start)
        return False

    def take_weight(self):
        """Equilibrium under the whole weight from that under a share of it, in steps. As stiffness
        and weight count only by their quotient, these lead through the states of stiffer bodies."""
        factor = 1.5
        while self.share < 1:
            before = self.share
            self.carry(min(1.0, before * factor))
            if self.solve(iterations=15):
                factor = min(2.0, factor**1.5)
                continue
            self.carry(before)
            factor = factor**0.35
            if factor < 1.005:
                raise RuntimeError(f"no equilibrium found above {before:.3f} of the weight")

    def relax(self, pull=1e3, growth=10.0):
        """Equilibrium by a viscous flow whose steps grow."""
        failures = 0
        while True:
            if self.solve(pull):
                pull /= growth
                if pull < 1e-2:
                    if self.solve(0.0):
                        return
                    pull = 1.0
                    failures += 1
            else:
                pull *= 8
                failures += 1
            if pull > 1e8 or failures > 40:
                raise RuntimeError("no equilibrium found")

    def is_stable(self):
        """Whether the tangent is positive definite on the motions that the grip leaves; of a half, on
        the symmetric ones and on those to a side."""
        if not self.definite(self.grip.C if self.grip else np.zeros((0, len(self.mass)))):
            return False
        if not self.mirrored:
            return True
        symmetric, self.fixed = self.fixed, self.fixed_aside
        try:
            return self.definite(self.grip.aside if self.grip else np.zeros((0, len(self.mass))))
        finally:
            self.fixed = symmetric

    def definite(self, rows):
        """Whether the tangent is positive definite where the motion times `rows` is zero: as many
        pivots below zero as eigenvalues of rows tangent^-1 rows^T."""
        self.tangent(0.0)
        self.factor(self.grip.prescribed if self.grip else np.zeros(0, int))
        pivots = self.solver.getPC().getFactorMatrix().getMumpsInfog(12)
        rows = np.where(self.fixed, 0, scipy.sparse.csr_matrix(rows).toarray())
        by_rows = rows @ np.array([self.solve_linear(row) for row in rows]).reshape(rows.shape).T
        return pivots == np.count_nonzero(np.linalg.eigvalsh((by_rows + by_rows.T) / 2) < 0)

"""A box-shaped solid sheet in DOLFINx (Debian's 0.5.2): statics and BDF2 dynamics, large strain.

Two discretisations of the same problem:

  q1e9  8-node bricks with nine incompatible parabolas, written as an energy from which UFL derives
        residual and tangent and DOLFINx the code; they are unknowns of their own. 2 x 2 x 2 points,
        nodal masses. At small strain the element of sim_worker/reference (decision 0028).
  q2    27-node bricks, 3 x 3 x 3 points: another element.

Lengths in m, forces in N, coordinates those of the sheet's frame B.
"""
import sys

sys.path.insert(0, "/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real/lib/python3/dist-packages")

import logging

import dolfinx
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

from cases import disc_points


logging.disable(logging.INFO)


def energy_density(law, F, mu, lam):
    """Psi(F) [J/m^3], the laws of sim_worker/reference/hyperelastic_law.h."""
    C = F.T * F
    J = ufl.det(F)
    if law == "neo_hooke":
        return mu / 2 * (ufl.tr(C) - 3 - 2 * ufl.ln(J)) + lam / 2 * ufl.ln(J) ** 2
    if law == "st_venant_kirchhoff":
        E = (C - ufl.Identity(3)) / 2
        return mu * ufl.inner(E, E) + lam / 2 * ufl.tr(E) ** 2
    raise ValueError(law)


class Solid:
    def __init__(self, lines, element, law, young, poisson, density, gravity, inclusion=None,
                 clamped=True, skins=0.0):
        """lines: grid lines along x, y, z; the first along y is the clamp. inclusion: (x, y, radius,
        factor): E grows by 1 + (factor - 1) (1 - d^2 / radius^2)^2 inside; q1e9 takes it constant in
        an element, from its centre. skins: E(z) grows by 1 + skins (12 z^2 / h^2 - 1), which leaves its
        mean over the thickness h as it is and makes the sheet stiffer in bending by 0.8 skins."""
        self.lines = [np.asarray(line, float) for line in lines]
        self.element = element
        n = [len(line) - 1 for line in self.lines]
        self.mesh = mesh.create_box(MPI.COMM_SELF, [[0, 0, 0], n], n, mesh.CellType.hexahedron)
        index = self.mesh.geometry.x.copy()
        for axis in range(3):
            self.mesh.geometry.x[:, axis] = self.lines[axis][np.rint(index[:, axis]).astype(int)]
        cell = self.mesh.ufl_cell()
        position = ufl.VectorElement("Lagrange", cell, 1 if element == "q1e9" else 2)
        mu0 = young / (2 * (1 + poisson))
        lam0 = young * poisson / ((1 + poisson) * (1 - 2 * poisson))
        x = ufl.SpatialCoordinate(self.mesh)
        V0 = fem.VectorFunctionSpace(self.mesh, ("DG", 0))
        cells = self.mesh.geometry.dofmap.array.reshape(-1, 8)
        corners = self.mesh.geometry.x[cells]
        centre, size = fem.Function(V0), fem.Function(V0)
        centre.x.array[:] = corners.mean(axis=1).ravel()
        size.x.array[:] = (corners.max(axis=1) - corners.min(axis=1)).ravel()
        self.cells, self.corners = cells, corners
        stiffness = 1
        if inclusion:
            cx, cy, radius, factor = inclusion
            at = centre if element == "q1e9" else x
            d2 = ((at[0] - cx) ** 2 + (at[1] - cy) ** 2) / radius**2
            stiffness = 1 + (factor - 1) * ufl.conditional(ufl.lt(d2, 1), (1 - d2) ** 2, 0)
        if skins:
            stiffness *= 1 + skins * (12 * (x[2] / (self.lines[2][-1] - self.lines[2][0])) ** 2 - 1)
        if element == "q1e9":
            self.space = fem.FunctionSpace(
                self.mesh, ufl.MixedElement(position, ufl.TensorElement("DG", cell, 0, (3, 3))))
            self.w = fem.Function(self.space)
            u, b = ufl.split(self.w)
            # Parabola k is 1 - xi_k^2 along axis k: gradient -2 xi_k (2 / size_k) e_k.
            slope = [-2 * (2 * (x[k] - centre[k]) / size[k]) * 2 / size[k] for k in range(3)]
            bubbles = ufl.as_matrix([[b[k, i] * slope[k] for k in range(3)] for i in range(3)])
            degree = 2
        else:
            self.space = fem.FunctionSpace(self.mesh, position)
            self.w = fem.Function(self.space)
            u, bubbles, degree = self.w, 0 * ufl.Identity(3), 4
        F = ufl.Identity(3) + ufl.grad(u) + bubbles
        dx = ufl.Measure("dx", metadata={"quadrature_degree": degree})
        test = ufl.TestFunction(self.space)
        v = ufl.split(test)[0] if element == "q1e9" else test
        elastic = energy_density(law, F, mu0 * stiffness, lam0 * stiffness) * dx
        self.force_form = fem.form(ufl.derivative(elastic, self.w, test))
        self.tangent_form = fem.form(
            ufl.derivative(ufl.derivative(elastic, self.w, test), self.w))
        # Dofs of the position: [node][xyz].
        if element == "q1e9":
            sub, self.dofs = self.space.sub(0).collapse()
            self.scalar_dofmap = sub.dofmap
            self.dofs = np.asarray(self.dofs).reshape(-1, 3)
            nodes = sub.tabulate_dof_coordinates()
        else:
            nodes = self.space.tabulate_dof_coordinates()
            self.scalar_dofmap = self.space.dofmap
            self.dofs = np.arange(3 * len(nodes)).reshape(-1, 3)
        self.nodes = nodes
        weight = fem.petsc.assemble_vector(fem.form(ufl.dot(
            fem.Constant(self.mesh, PETSc.ScalarType((1.0, 1.0, 1.0))), v) * dx)).array
        self.mass = density * weight[self.dofs[:, 0]]  # lumped by rows; sums to the total
        self.gravity = np.asarray(gravity, float)
        self.free = np.ones(len(self.w.x.array), bool)
        if clamped:
            self.free[self.dofs[nodes[:, 1] < self.lines[1][0] + 1e-9].ravel()] = False
        fixed = np.flatnonzero(~self.free)
        if element != "q1e9":  # of a blocked space DOLFINx counts nodes
            fixed = fixed[::3] // 3
        self.bcs = [fem.dirichletbc(fem.Function(self.space), fixed.astype(np.int32))]
        self.A = fem.petsc.create_matrix(self.tangent_form)
        self.A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self.A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.solver = PETSc.KSP().create(MPI.COMM_SELF)
        self.solver.setOperators(self.A)
        self.solver.setType("preonly")
        self.solver.getPC().setType("cholesky")  # PETSc's own: of sheets two thirds of the time of MUMPS
        self.rows, self.target, self.compliance = None, None, 1e-6
        self.newton = 0

    # ---- points ------------------------------------------------------------------------------

    def weights_at(self, point):
        """Nodes and shape function values at a point; on faces those of one of the cells."""
        inside = np.all((self.corners.min(axis=1) <= np.asarray(point) + 1e-12)
                        & (self.corners.max(axis=1) >= np.asarray(point) - 1e-12), axis=1)
        cell = int(np.flatnonzero(inside)[0])
        low, high = self.corners[cell].min(axis=0), self.corners[cell].max(axis=0)
        t = (np.asarray(point) - low) / (high - low)
        nodes = self.scalar_dofmap.cell_dofs(cell)
        X = (self.nodes[nodes] - low) / (high - low)
        N = np.ones(len(nodes))
        for axis in range(3):
            if len(nodes) == 8:
                N *= np.where(X[:, axis] < 0.5, 1 - t[axis], t[axis])
            else:
                s = t[axis]
                N *= np.choose(np.rint(2 * X[:, axis]).astype(int),
                               [(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)])
        return nodes, N

    def positions(self):
        return self.nodes + self.w.x.array[self.dofs]

    def point(self, point):
        nodes, N = self.weights_at(point)
        return N @ self.positions()[nodes]

    # ---- grasp -------------------------------------------------------------------------------

    def hold(self, centre, radius):
        """Holds the mean and the mean slopes of the disc through the thickness; target: [row][xyz],
        the first is the mean position."""
        low = np.array([self.lines[0][0], self.lines[1][0]])
        high = np.array([self.lines[0][-1], self.lines[1][-1]])
        points, weights = disc_points(np.asarray(centre), radius, low, high)
        mean = weights @ points
        z_low, z_high = self.lines[2][0], self.lines[2][-1]
        gauss = np.array([-1, 1]) / np.sqrt(3)
        layers = [(a, b) for a, b in zip(self.lines[2][:-1], self.lines[2][1:])]
        if self.element != "q1e9":  # the same integral, exact for the quadratic element too
            gauss = np.array([-np.sqrt(0.6), 0, np.sqrt(0.6)])
        zweight = np.array([5, 8, 5]) / 18 if len(gauss) == 3 else np.array([0.5, 0.5])
        rows = np.zeros((4, len(self.nodes)))
        half = (z_high - z_low) / 2
        for p, weight in zip(points, weights):
            for a, b in layers:
                for zeta, share in zip(gauss, zweight):
                    z = (a + b) / 2 + zeta * (b - a) / 2
                    nodes, N = self.weights_at(np.array([p[0], p[1], z]))
                    factor = weight * share * (b - a) / (z_high - z_low)
                    slopes = [1, (p[0] - mean[0]) / radius, (p[1] - mean[1]) / radius, z / half]
                    rows[:, nodes] += factor * np.outer(slopes, N)
        self.rows = rows
        self.target = rows @ self.positions()

    def held_force(self):
        """Force of the tissue on the tool [N]."""
        return ((self.rows @ self.positions() - self.target) / self.compliance)[0]

    # ---- one equation ------------------------------------------------------------------------

    def residual(self, extra):
        r = fem.petsc.assemble_vector(self.force_form).array.copy()
        r[self.dofs] -= self.mass[:, None] * self.gravity
        force, blocks = extra(self.positions())
        r[self.dofs] += force
        if self.rows is not None:
            miss = (self.rows @ self.positions() - self.target) / self.compliance
            r[self.dofs] += self.rows.T @ miss
        r[~self.free] = 0
        return r, blocks

    def direction(self, r, blocks):
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self.tangent_form, bcs=self.bcs)
        self.A.assemble()
        for node in np.flatnonzero(np.abs(blocks).sum(axis=(1, 2)) > 0):
            dofs = self.dofs[node].astype(np.int32)
            if self.free[dofs[0]]:
                self.A.setValues(dofs, dofs, blocks[node].ravel(), addv=PETSc.InsertMode.ADD)
        self.A.assemble()
        self.solver.setUp()

        def solve(b):
            rhs, out = self.A.createVecs()
            rhs.array[:] = b
            self.solver.solve(rhs, out)
            return out.array.copy()

        d = solve(-r)
        if self.rows is not None:
            C = np.zeros((12, len(r)))
            for row in range(4):
                for axis in range(3):
                    C[3 * row + axis, self.dofs[:, axis]] = self.rows[row]
            C[:, ~self.free] = 0
            Y = np.array([solve(c) for c in C])
            d -= Y.T @ np.linalg.solve(C @ Y.T + self.compliance * np.eye(12), C @ d)
        return d

    def solve(self, extra, tolerance=1e-9, iterations=25, falling=False):
        """Newton; tolerance in N. The residual may grow a little in a step unless `falling`. False:
        w is as it was."""
        start = self.w.x.array.copy()
        r, blocks = self.residual(extra)
        norm = np.linalg.norm(r)
        for _ in range(iterations):
            if norm <= tolerance:
                return True
            self.newton += 1
            try:
                d = self.direction(r, blocks)
            except PETSc.Error:
                break
            at = self.w.x.array.copy()
            share = 1.0
            while share > 1e-3:
                self.w.x.array[:] = at + share * d
                r, blocks = self.residual(extra)
                trial = np.linalg.norm(r)
                if np.isfinite(trial) and trial < (norm if falling else max(10 * norm, 1e-2)):
                    break
                share /= 2
            else:
                break
            norm = trial
        if norm <= 100 * tolerance:
            return True
        self.w.x.array[:] = start
        return False

    # ---- motion ----------------------------------------------------------------------------

    def faces(self):
        """Nodes of the lower and upper face and the area of each [m2]; clamped ones left out."""
        area = np.zeros(len(self.nodes))
        for cell in range(len(self.corners)):
            nodes = self.scalar_dofmap.cell_dofs(cell)
            size = np.ptp(self.nodes[nodes], axis=0)
            z = self.nodes[nodes, 2]
            outer = (z < self.lines[2][0] + 1e-9) | (z > self.lines[2][-1] - 1e-9)
            share = np.full(len(nodes), 0.25)
            if len(nodes) == 27:  # Simpson's rule: 1/6, 4/6, 1/6 along each side
                middle = np.abs(self.nodes[nodes] - self.corners[cell].mean(axis=0)) < 1e-3 * size
                share = np.where(middle[:, :2], 4 / 6, 1 / 6).prod(axis=1)
            area[nodes[outer]] += size[0] * size[1] * share[outer]
        area[~self.free[self.dofs[:, 0]]] = 0
        return area

    def start_motion(self):
        self.x = [self.positions(), self.positions()]  # now, a step before
        self.v = [np.zeros_like(self.nodes), np.zeros_like(self.nodes)]
        self.area = self.faces()
        self.history = False

    def step(self, h, damping, board, friction, slip):
        """One step of BDF2 (the first: backward Euler), masses lumped. `board`: height of a half-space;
        contact is a spring of 2e8 Pa/m at the face nodes that starts smoothly 2 um above, friction
        that of Coulomb, the force rising as 2 y - y^2 with y = speed / slip up to y = 1."""
        now, before, beta = (4 / 3, 1 / 3, 2 * h / 3) if self.history else (1, 0, h)
        x_tilde = now * self.x[0] - before * self.x[1]
        v_tilde = now * self.v[0] - before * self.v[1]
        area = self.area
        inertia = self.mass * (1 / beta**2 + damping / beta)
        s = 2e-6

        def extra(p):
            force = inertia[:, None] * (p - x_tilde) - self.mass[:, None] * v_tilde / beta
            blocks = inertia[:, None, None] * np.eye(3)
            u = s - (p[:, 2] - board)
            k = 2e8 * area
            press = k * np.where(u <= 0, 0, np.where(u < 2 * s, u * u / (4 * s), u - s))
            force[:, 2] -= press
            blocks[:, 2, 2] += k * np.where(u <= 0, 0, np.where(u < 2 * s, u / (2 * s), 1))
            v = ((p - x_tilde) / beta)[:, :2]
            speed = np.maximum(np.linalg.norm(v, axis=1), 1e-300)
            y = speed / slip
            share = np.where(y < 1, 2 * y - y * y, 1)
            limit = friction * press
            along = v / speed[:, None]
            force[:, :2] += (limit * share)[:, None] * along
            outer = along[:, :, None] * along[:, None, :]
            slope = np.where(y < 1, (2 - 2 * y) / slip, 0)
            blocks[:, :2, :2] += (limit / beta)[:, None, None] * (
                (share / speed)[:, None, None] * (np.eye(2) - outer)
                + slope[:, None, None] * outer)
            return force, blocks

        if self.history:  # from where it goes on at its velocity, else from where it is
            self.w.x.array[self.dofs] += self.x[0] - self.x[1]
        if not self.solve(extra, iterations=60, falling=True):
            self.w.x.array[self.dofs] = self.x[0] - self.nodes
            if not self.solve(extra, iterations=60, falling=True):
                raise RuntimeError("the step does not converge")
        self.x = [self.positions(), self.x[0]]
        self.v = [(self.x[0] - x_tilde) / beta, self.v[0]]
        self.v[0][~self.free[self.dofs[:, 0]]] = 0
        self.history = True

    # ---- statics -----------------------------------------------------------------------------

    def relax(self, start=1e3, limit=1e8):
        """Static equilibrium by a viscous flow whose steps grow: each pulls with k M towards the
        last state. Robust where the sheet falls a long way."""
        k = start  # [1/s^2]
        failures = 0
        while True:
            before = self.positions()
            pull = self.mass[:, None, None] * k * np.eye(3)

            def extra(p):
                return self.mass[:, None] * k * (p - before), pull

            if self.solve(extra):
                k /= 10
                if k < 1e-3:
                    nothing = np.zeros((len(self.nodes), 3, 3))
                    if self.solve(lambda p: (np.zeros((len(self.nodes), 3)), nothing)):
                        return
                    k = 1.0
                    failures += 1
            else:
                k *= 8
                failures += 1
            if k > limit or failures > 60:
                raise RuntimeError("no equilibrium found")

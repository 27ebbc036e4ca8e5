"""A clamped soft sheet under gravity, moved by rigid pads: 27-node bricks in DOLFINx (Debian's 0.5.2).

One step minimises an increment of potential over the nodes that the pad does not hold: elastic energy, rate damping
eta / (2 h) |E - E_before|^2, inertia by BDF2 (backward Euler where the step has just changed: what strikes the board
stays there, which Newmark's rule would throw back up), weight, and the faces' terms of fenics_surface.py. Newton with a line search on that potential; where the matrix is not positive
the mass is added until it is. Box coordinates: x across from 0, y from the clamped edge, z up from the board.
"""
import sys

sys.path.insert(0, "/usr/lib/petscdir/petsc3.18/x86_64-linux-gnu-real/lib/python3/dist-packages")

import logging

import basix
import numpy as np
import ufl
from dolfinx import fem, mesh
from mpi4py import MPI
from petsc4py import PETSc

import fenics_surface as surface

logging.disable(logging.INFO)
JIT = {"cffi_extra_compile_args": ["-O3", "-march=native"], "cffi_libraries": ["m"]}


def lines(breaks, n):
    """n cells between the first and the last of `breaks`, with a line at every break, the largest cell smallest."""
    breaks = np.asarray(breaks, float)
    count = np.ones(len(breaks) - 1, int)
    for _ in range(n - len(count)):
        count[np.argmax(np.diff(breaks) / count)] += 1
    out = [np.linspace(a, b, k + 1)[:-1] for a, b, k in zip(breaks[:-1], breaks[1:], count)]
    return np.append(np.concatenate(out), breaks[-1])


class Material:
    """Numbers of the body; the effects are neutral as they stand here."""
    young, poisson, density, law = 40e3, 0.46, 1050.0, "log"
    rate_time, mass_rate = 0.008, 0.6  # eta / E [s]; [1/s]
    spot = (0.0, 0.0, 1e-3, 1.0)  # x, y, radius, factor of E
    fibre = (0.0, 0.0)  # Ef [Pa], angle from x
    stiffening = 0.0  # c2 [Pa] of c2 (I1 - 3)^2
    prony = (0.0, 1.0)  # g, tau [s]


def spot_factor(x, spot):
    """k inside the disc, 1 outside, over 1 mm across the rim."""
    d = ufl.sqrt((x[0] - spot[0])**2 + (x[1] - spot[1])**2 + 1e-12)
    return 1 + (spot[3] - 1) / (1 + ufl.exp((d - spot[2]) / 5e-4))


class Sheet:
    def __init__(self, xs, ys, thickness, material):
        m = self.material = material
        self.xs, self.ys, self.thickness = xs, ys, thickness
        n = [len(xs) - 1, len(ys) - 1, 1]
        self.mesh = mesh.create_box(MPI.COMM_SELF, [[0, 0, 0], n], n, mesh.CellType.hexahedron)
        at = np.rint(self.mesh.geometry.x).astype(int)
        self.mesh.geometry.x[:] = np.stack([xs[at[:, 0]], ys[at[:, 1]], thickness * at[:, 2]], axis=1)
        self.V = fem.VectorFunctionSpace(self.mesh, ("Lagrange", 2))
        self.rest = self.V.tabulate_dof_coordinates().copy()
        self._number_grid()
        self._forms()
        self.terms, self.pad = [], np.zeros(0, int)
        self.newton = self.factored = self.chords = 0
        self.factor_of = None  # the pad for which A has been factored

    def _number_grid(self):
        half = lambda v: np.sort(np.concatenate([v, (v[1:] + v[:-1]) / 2]))
        gx, gy, gz = half(self.xs), half(self.ys), half(np.array([0, self.thickness]))
        i, j, k = (np.abs(self.rest[:, a, None] - g[None]).argmin(1) for a, g in enumerate((gx, gy, gz)))
        self.grid = np.empty((len(gx), len(gy), 3), int)  # node numbers
        self.grid[i, j, k] = np.arange(len(self.rest))
        self.lower, self.upper = (surface.Surface(self.grid[:, :, k], self.xs, self.ys) for k in (0, 2))
        for s in (self.lower, self.upper):
            s.rest = s.points(self.rest)

    def _forms(self):
        m, V = self.material, self.V
        number = lambda v: fem.Constant(self.mesh, PETSc.ScalarType(v))
        self.u, self.before, self.predicted = (fem.Function(V) for _ in range(3))
        test = ufl.TestFunction(V)
        x = ufl.SpatialCoordinate(self.mesh)
        F = ufl.Identity(3) + ufl.grad(self.u)
        C = F.T * F
        E, J = (C - ufl.Identity(3)) / 2, ufl.det(F)
        G = ufl.Identity(3) + ufl.grad(self.before)
        E0 = (G.T * G - ufl.Identity(3)) / 2
        mu = number(m.young / (2 * (1 + m.poisson)))
        lam = number(m.young * m.poisson / ((1 + m.poisson) * (1 - 2 * m.poisson)))
        I1 = ufl.tr(C)
        if m.law == "log":
            psi = mu / 2 * (I1 - 3 - 2 * ufl.ln(J)) + lam / 2 * ufl.ln(J)**2
        else:  # split into shape and volume
            psi = mu / 2 * (J**(-2 / 3) * I1 - 3) + (lam + 2 * mu / 3) / 4 * (J**2 - 1 - 2 * ufl.ln(J))
        if m.stiffening:
            psi += number(m.stiffening) * (I1 - 3 - 2 * ufl.ln(J))**2
        if m.fibre[0]:
            a = ufl.as_vector([number(np.cos(m.fibre[1])), number(np.sin(m.fibre[1])), 0])
            stretch = ufl.dot(a, E * a)
            psi += number(m.fibre[0] / 2) * ufl.conditional(ufl.gt(stretch, 0), stretch, 0)**2
        self.rate = number(0.0)  # eta / h over E
        D = E - E0
        psi += self.rate * mu * (ufl.inner(D, D) + ufl.tr(D)**2)
        dx = ufl.Measure("dx", metadata={"quadrature_degree": 4})
        self.branch = None
        if m.prony[0]:
            self._prony(E, mu, lam, number)
            B = E - self.branch
            psi += self.share * (mu * ufl.inner(B, B) + lam / 2 * ufl.tr(B)**2)
        psi *= spot_factor(x, [number(v) for v in m.spot])
        rho = number(m.density)
        self.inertia, self.drag = number(0.0), number(0.0)
        w, v = self.u - self.predicted, self.u - self.before
        psi += rho * (self.inertia / 2 * ufl.inner(w, w) + self.drag / 2 * ufl.inner(v, v) + number(9.81) * self.u[2])
        energy = psi * dx
        first = ufl.derivative(energy, self.u, test)
        form = lambda f: fem.form(f, jit_params=JIT)
        self.energy_form, self.force_form = form(energy), form(first)
        self.tangent_form = form(ufl.derivative(first, self.u))
        one = fem.Constant(self.mesh, PETSc.ScalarType((1.0, 1.0, 1.0)))
        self.mass = fem.petsc.assemble_vector(fem.form(rho * ufl.dot(one, test) * dx)).array.copy()
        self.A = fem.petsc.create_matrix(self.tangent_form)
        self.A.setOption(PETSc.Mat.Option.NEW_NONZERO_ALLOCATION_ERR, False)
        self.A.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        self.A.setOption(PETSc.Mat.Option.KEEP_NONZERO_PATTERN, True)
        self._solver()

    def _solver(self):
        self.ksp = PETSc.KSP().create(MPI.COMM_SELF)
        self.ksp.setOperators(self.A)
        self.ksp.setType("preonly")
        pc = self.ksp.getPC()
        pc.setType("cholesky")
        pc.setFactorSolverType("cholmod")  # a tenth of the time of PETSc's own

    def _prony(self, E, mu, lam, number):
        """A Maxwell branch: its dashpot's strain at the Gauss points, condensed over a step by backward Euler."""
        Q = fem.FunctionSpace(self.mesh, ufl.TensorElement("Quadrature", self.mesh.ufl_cell(), 4, shape=(3, 3),
                                                           quad_scheme="default"))
        self.branch = fem.Function(Q)
        self.share = number(0.0)
        points, _ = basix.make_quadrature(basix.CellType.hexahedron, 4)
        self.strain = fem.Expression(E, points)
        self.cells = np.arange(self.mesh.topology.index_map(3).size_local, dtype=np.int32)
        self.places = np.concatenate([Q.dofmap.cell_dofs(cell) for cell in self.cells])

    def flow(self, blend):
        """The dashpots go that share of the way to the strain."""
        strain = self.strain.eval(self.cells).reshape(-1, 9)
        old = self.branch.x.array.reshape(-1, 9)
        old[self.places] += blend * (strain - old[self.places])

    # ---- one step --------------------------------------------------------------------------------

    def positions(self):
        return self.rest + self.u.x.array.reshape(-1, 3)

    def start(self):
        self.halt()
        p = self.positions()
        for term in self.terms:
            term.start(term.s.points(p))

    def halt(self):
        """Takes all motion out."""
        self.velocity = np.zeros_like(self.rest)
        self.last = None  # h, positions' and velocities' arrays of the step before

    def potential(self):
        p = self.positions()
        faces = sum(term.evaluate(term.s.points(p), False)[0] for term in self.terms)
        return fem.assemble_scalar(self.energy_form) + faces

    def gradient(self):
        r = fem.petsc.assemble_vector(self.force_form).array.reshape(-1, 3).copy()
        p = self.positions()
        for term in self.terms:
            term.s.scatter(term.evaluate(term.s.points(p), False)[1], r)
        return r.ravel()

    def assemble(self):
        """The second derivative into A."""
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self.tangent_form)
        self.A.assemble()
        p = self.positions()
        for face in (self.lower, self.upper):
            K = sum(term.evaluate(face.points(p), True)[2] for term in self.terms if term.s is face)
            if np.isscalar(K):
                continue
            touched = np.flatnonzero(np.abs(K).sum(axis=(1, 2, 3)) > 0)
            dofs = (3 * face.faces[touched][:, :, None] + np.arange(3)).reshape(-1, 27).astype(np.int32)
            for d, block in zip(dofs, face.blocks(K[touched])):
                self.A.setValues(d, d, block, addv=PETSc.InsertMode.ADD)
        self.A.assemble()

    def direction(self, r, jump):
        """Newton's direction; the pad's nodes go by `jump`."""
        rhs, out = self.A.createVecs()
        pad = (3 * self.pad[:, None] + np.arange(3)).ravel().astype(np.int32)
        rhs.array[:] = -r
        if jump is not None:
            out.array[:] = jump
            rhs.array[:] -= (self.A * out).array
        rhs.array[pad] = 0 if jump is None else jump[pad]
        self.A.zeroRowsColumns(pad, 1.0)
        shift, self.factor_of = 0.0, self.pad
        for _ in range(12):
            if shift:
                diagonal, _ = self.A.createVecs()
                diagonal.array[:] = shift * self.mass
                diagonal.array[pad] = 0
                self.A.setDiagonal(diagonal, addv=PETSc.InsertMode.ADD)
                self.A.assemble()
            self.factored += 1
            try:
                self.ksp.setUp()
                self.ksp.solve(rhs, out)
                d = out.array.copy()
                if self.ksp.getConvergedReason() > 0 and np.isfinite(d).all() and (
                        jump is not None or d @ r < 0):
                    return d
            except PETSc.Error:
                pass
            self._solver()  # one that has failed does not factor again
            shift = max(4 * shift, 2e3)
        self.factor_of = None
        raise RuntimeError("no direction")

    def minimise(self, target, tolerance=1e-5, iterations=40):
        """target: positions of the pad's nodes. False: it did not get there."""
        start = self.u.x.array.copy()
        free = np.ones(len(start), bool)
        free[(3 * self.pad[:, None] + np.arange(3)).ravel()] = False
        jump = np.zeros(len(start))
        if len(self.pad):
            jump.reshape(-1, 3)[self.pad] = target - self.positions()[self.pad]
        first = bool(np.abs(jump).max() > 0)
        energy = None
        for k in range(iterations):
            r = self.gradient()
            self.reaction = r.reshape(-1, 3)[self.pad].sum(0)
            norm = np.linalg.norm(r[free])
            if not first and norm < tolerance:
                return True
            self.newton += 1
            self.assemble()
            try:
                d = self.direction(np.where(free, r, 0) if not first else r, jump if first else None)
            except RuntimeError:
                break
            at = self.u.x.array.copy()
            if first:  # the pad moves; the potential before says nothing about the one after
                self.u.x.array[:] = at + d
                energy = self.potential()
                if not np.isfinite(energy):
                    break
                first, energy = False, None
                if self.chord(target):
                    return True
                continue
            if energy is None:
                energy = self.potential()
            slope, share = d @ np.where(free, r, 0), 1.0
            while share > 1e-4:
                self.u.x.array[:] = at + share * d
                trial = self.potential()
                if np.isfinite(trial) and trial <= energy + 1e-4 * share * slope + 1e-13:
                    break
                share /= 2
            else:
                self.u.x.array[:] = at
                if norm < 5 * tolerance:  # rounding of the potential
                    return True
                break
            if self.chord(target):
                return True
            energy = None
        self.u.x.array[:] = start
        return False

    def chord(self, target, tolerance=1e-5):
        """Newton with the matrix that was factored last, a sixth of the cost each, as long as it closes in well. False:
        it stays at the best it has found."""
        if self.factor_of is not self.pad:
            return False
        rhs, out = self.A.createVecs()
        pad = (3 * self.pad[:, None] + np.arange(3)).ravel()
        start = self.u.x.array.copy()
        if len(pad):
            self.u.x.array[pad] = (target - self.rest[self.pad]).ravel()
        before = np.inf
        for _ in range(9):
            r = self.gradient()
            self.reaction = r.reshape(-1, 3)[self.pad].sum(0)
            r[pad] = 0
            norm = np.linalg.norm(r)
            if norm < tolerance:
                return True
            if not norm < .4 * before:
                if not norm < before:
                    self.u.x.array[:] = start
                return False
            before, start = norm, self.u.x.array.copy()
            rhs.array[:] = -r
            self.ksp.solve(rhs, out)
            self.u.x.array[:] += out.array
            self.chords += 1
        return False

    def minimise_from(self, x, target):
        self.u.x.array[:] = x.ravel()
        return self.minimise(target)

    def step(self, h, target, depth=0):
        """One step of h seconds; target(share) gives the pad's nodes at that share of it. Halves where needed."""
        m = self.material
        x = self.u.x.array.reshape(-1, 3).copy()
        v = self.velocity
        if self.last and abs(self.last[0] - h) < 1e-9:
            reach, x_from, v_from = 2 * h / 3, (4 * x - self.last[1]) / 3, (4 * v - self.last[2]) / 3
        else:
            reach, x_from, v_from = h, x, v
        self.before.x.array[:] = x.ravel()
        self.predicted.x.array[:] = (x_from + reach * v_from).ravel()
        self.inertia.value = 1 / reach**2
        self.drag.value = m.mass_rate / h
        self.rate.value = m.rate_time / h
        if self.branch:
            g, tau = m.prony
            self.share.value = g / (1 + h / tau)
        # First from where it goes on at its velocity, which saves an iteration, then from where it is.
        at = target(1.0)
        self.u.x.array[:] = (x + h * v).ravel()
        if self.chord(at) or self.minimise(at) or self.minimise_from(x + h * v, at) or self.minimise_from(x, at):
            self.velocity = (self.u.x.array.reshape(-1, 3) - x_from) / reach
            self.last = h, x, v
            self.force = -self.reaction  # of the tissue on the tool
            p = self.positions()
            for term in self.terms:
                term.accept(term.s.points(p))
            if self.branch:
                self.flow(h / (m.prony[1] + h))
            return
        if depth > 6:
            raise RuntimeError("a step of a hundredth does not converge")
        self.u.x.array[:] = x.ravel()
        self.last = None
        self.step(h / 2, lambda s: target(s / 2), depth + 1)
        self.step(h / 2, lambda s: target(0.5 + s / 2), depth + 1)


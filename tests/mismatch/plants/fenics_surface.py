"""Forces on the faces of the sheet, at 4 x 4 Gauss points of each quadratic face: board, friction, clamp bed, bump,
adhesion. All derive from an increment of potential, so that a step of the sheet is a minimum and a line search can
judge it. Lengths in m, forces in N; y = 0 is the clamped edge here, x = 0 one side.

  board     penetration g presses with c g^2, as asperities do: 30 Pa at 4 um, and from 25 um on
            with the 1e8 Pa/m reached there
  friction  bristles of 15 um: mu p e / sqrt(e^2 + d^2), e the slide since the bristle took hold; a bristle that is bent
            further is dragged along. What holds by friction does not creep. p is that of the step before
  bed       springs per area under both faces of the clamped strip, in all directions
  sphere    c g^2 as the board, without friction, on one face
  adhesion  pull k d exp(-d / d0) towards the place of first touch, along the secant below the largest d so far
"""
import numpy as np

PRESS = 2e12  # [Pa/m2] of board and spheres
FIRM = 25e-6  # [m]
BRISTLE = 15e-6  # [m]


def shape_1d(s):
    return np.stack([(1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1)], axis=-1)


class Surface:
    """Gauss points of one face (`z` index of the grid of nodes: 0 lower, 2 upper)."""

    def __init__(self, grid, xs, ys):
        """grid: [2 n + 1][2 m + 1] node numbers of the face; xs, ys: lines of the cells."""
        gauss, weight = np.polynomial.legendre.leggauss(4)
        gauss, weight = (gauss + 1) / 2, weight / 2
        N = shape_1d(gauss)
        self.shape = np.einsum("ai,bj->abij", N, N).reshape(16, 9)
        self.products = np.einsum("qk,ql->klq", self.shape, self.shape).reshape(81, 16)
        n, m = len(xs) - 1, len(ys) - 1
        self.faces = np.array([grid[2 * i:2 * i + 3, 2 * j:2 * j + 3].ravel() for i in range(n) for j in range(m)])
        hx, hy = np.diff(xs), np.diff(ys)
        area = np.repeat(hx, m) * np.tile(hy, n)
        self.area = area[:, None] * np.outer(weight, weight).ravel()[None, :]  # [face][point]
        self.rest = None  # set with the nodes

    def points(self, nodes):
        return self.shape @ nodes[self.faces]

    def scatter(self, force, out):
        np.add.at(out, self.faces, self.shape.T @ force)

    def blocks(self, stiffness):
        """[face][27 x 27] from [face][point][3][3]."""
        b = self.products @ stiffness.reshape(len(stiffness), 16, 9)
        return b.reshape(-1, 9, 9, 3, 3).transpose(0, 1, 3, 2, 4).reshape(-1, 27 * 27)


def unilateral(gap, area):
    """Energy, push and its slope of a gap < 0."""
    g = np.maximum(-gap, 0)
    curved = np.minimum(g, FIRM)
    over = g - curved  # beyond FIRM along the tangent, where Newton would only creep
    energy = curved**3 / 3 + over * (FIRM**2 + FIRM * over)
    return PRESS * (area * energy).sum(), PRESS * area * (curved**2 + 2 * FIRM * over), 2 * PRESS * area * curved


class Board:
    """z = 0 with friction; the points of the pad are between jaw and board and not pressed."""

    def __init__(self, surface, friction, active):
        self.s, self.friction = surface, friction
        self.area = surface.area * active
        self.hold = None

    def start(self, x):
        self.hold = x[..., :2].copy()
        self.pressed = np.zeros(x.shape[:2])

    def evaluate(self, x, hessian):
        energy, push, slope = unilateral(x[..., 2], self.area)
        force = np.zeros_like(x)
        force[..., 2] = -push
        e = x[..., :2] - self.hold
        root = np.sqrt((e**2).sum(-1) + BRISTLE**2)
        limit = self.friction * self.pressed
        energy += (limit * (root - BRISTLE)).sum()
        force[..., :2] = (limit / root)[..., None] * e
        K = None
        if hessian:
            K = np.zeros(x.shape + (3,))
            K[..., 2, 2] = slope
            K[..., :2, :2] = (limit / root)[..., None, None] * (
                np.eye(2) - e[..., :, None] * e[..., None, :] / (root**2)[..., None, None])
        return energy, force, K

    def accept(self, x):
        _, self.pressed, _ = unilateral(x[..., 2], self.area)
        e = x[..., :2] - self.hold
        length = np.sqrt((e**2).sum(-1))
        share = np.minimum(1, 4 * BRISTLE / np.maximum(length, 1e-30))
        free = self.pressed == 0
        self.hold = x[..., :2] - e * share[..., None]
        self.hold[free] = x[free][:, :2]


class Bed:
    """`weight` [face][point]: 1 on the clamped strip where it holds, 0 elsewhere. stiffness [N/m3]."""

    def __init__(self, surface, stiffness, weight):
        self.k = stiffness * surface.area * weight
        self.s = surface

    def start(self, x):
        self.rest = self.s.rest

    def evaluate(self, x, hessian):
        d = x - self.rest
        K = self.k[..., None, None] * np.eye(3) if hessian else None
        return 0.5 * (self.k[..., None] * d**2).sum(), self.k[..., None] * d, K

    def accept(self, x):
        pass


class Sphere:
    def __init__(self, surface, centre, radius, active):
        self.s, self.centre, self.radius = surface, np.asarray(centre), radius
        self.area = surface.area * active

    def start(self, x):
        pass

    def evaluate(self, x, hessian):
        d = x - self.centre
        r = np.sqrt((d**2).sum(-1))
        n = d / r[..., None]
        energy, push, slope = unilateral(r - self.radius, self.area)
        K = slope[..., None, None] * n[..., :, None] * n[..., None, :] if hessian else None
        return energy, -push[..., None] * n, K

    def accept(self, x):
        pass


class Adhesion:
    """`weight`: 1 on the patch. The work of parting is k d0^2 per area."""

    def __init__(self, surface, k, d0, weight):
        self.s = surface
        self.k, self.d0 = k * surface.area * weight, d0

    def start(self, x):
        self.at = x.copy()
        self.at[..., 2] = 0
        self.far = np.zeros(x.shape[:2])

    def evaluate(self, x, hessian):
        d = x - self.at
        r = np.sqrt((d**2).sum(-1)) + 1e-12
        inside = r <= self.far
        secant = np.exp(-np.where(inside, self.far, r) / self.d0)
        # Work of the envelope from 0 to r: d0^2 (1 - (1 + r / d0) exp(-r / d0)).
        envelope = lambda r: self.d0**2 * (1 - (1 + r / self.d0) * np.exp(-r / self.d0))
        work = np.where(inside, secant * r**2 / 2,
                        np.exp(-self.far / self.d0) * self.far**2 / 2 + envelope(r) - envelope(self.far))
        K = None
        if hessian:
            # The falling side would make the matrix indefinite; its slope along d is taken as 0 there.
            n = d / r[..., None]
            along = np.where(inside, 0, np.minimum(r / self.d0, 1)) * secant
            K = (self.k * secant)[..., None, None] * np.eye(3) - (
                self.k * along)[..., None, None] * n[..., :, None] * n[..., None, :]
        return (self.k * work).sum(), (self.k * secant)[..., None] * d, K

    def accept(self, x):
        self.far = np.maximum(self.far, np.sqrt(((x - self.at)**2).sum(-1)))

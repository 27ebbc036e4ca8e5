"""What holds a second_order_solid.Solid: the mean and slopes of a disc, or a rigid pad on both faces.

Both give way by springs; of a body with a plane of symmetry they hold the half that is there, and
`force` is that of the whole. The protocol: see Solid.direction and Solid.solve.
"""
import numpy as np
import scipy.sparse

from cases import disc_points

MISS = 10.0  # of a grip against the residual [N/m]


class Disc:
    """Mean displacement and mean slopes along x, y, z over a disc, through the thickness: GraspPatch
    of sim_worker/reference. compliance [m/N]: of the mean."""

    prescribed = np.zeros(0, int)

    def __init__(self, solid, centre, radius, compliance=0.0):
        low = np.array([-solid.lines[0][-1] if solid.mirrored else solid.lines[0][0],
                        solid.lines[1][0]])
        high = np.array([line[-1] for line in solid.lines[:2]])
        points, weights = disc_points(np.asarray(centre), radius, low, high)
        mean = weights @ points
        if solid.mirrored:
            inside = points[:, 0] > solid.lines[0][0]
            points, weights = points[inside], 2 * weights[inside]
        half = solid.lines[2][-1]
        gauss, share = np.polynomial.legendre.leggauss(3)
        rows = np.zeros((4, len(solid.nodes)))
        for p, weight in zip(points, weights):
            for a, b in zip(solid.lines[2][:-1], solid.lines[2][1:]):
                for zeta, part in zip(gauss, share / 2):
                    z = (a + b) / 2 + zeta * (b - a) / 2
                    nodes, N = solid.weights_at((p[0], p[1], z))
                    slopes = [1, (p[0] - mean[0]) / radius, (p[1] - mean[1]) / radius, z / half]
                    rows[:, nodes] += weight * part * (b - a) / (2 * half) * np.outer(slopes, N)
        kinds = [(row, axis) for row in range(4) for axis in range(3)]
        C = np.zeros((len(kinds), solid.w.x.array.size))
        for k, (row, axis) in enumerate(kinds):
            C[k, axis::3] = rows[row]
        # Of a half the others are zero by symmetry; they hold it when it moves to a side.
        here = np.array([not solid.mirrored or (row == 1) == (axis == 0) for row, axis in kinds])
        self.aside = C[~here]
        self.kinds = [kind for kind, kept in zip(kinds, here) if kept]
        self.C = scipy.sparse.csr_matrix(np.where(solid.fixed, 0, C[here]))
        self.times = 2 if solid.mirrored else 1
        self.compliance = np.array([self.times * compliance * (row == 0) for row, _ in self.kinds])
        self.target = np.zeros(len(self.kinds))
        self.p = np.zeros(len(self.kinds))

    def aim(self, lift):
        for k, (row, axis) in enumerate(self.kinds):
            if row == 0:
                self.target[k] = lift[axis]

    def add_force(self, solid, r):
        r += self.C.T @ self.p

    def miss(self, solid, r):
        return MISS * (self.C @ solid.w.x.array - self.target - self.compliance * self.p)

    def direction(self, solid, r):
        solid.factor(self.prescribed)
        d = solid.solve_linear(np.where(solid.fixed, 0, -r))
        Y = np.array([solid.solve_linear(row.toarray().ravel()) for row in self.C])
        S = self.C @ Y.T + np.diag(self.compliance)
        more = np.linalg.solve(S, self.C @ d + self.miss(solid, r) / MISS)
        return d - Y.T @ more, more

    def state(self):
        return self.p.copy()

    def move(self, solid, at, share, more):
        self.p = at + share * more if share else at.copy()

    def force(self):
        """Of the tissue on the tool [N]."""
        out = np.zeros(3)
        for p, (row, axis) in zip(self.p, self.kinds):
            if row == 0:
                out[axis] = self.times * p
        return out


def rotation(v):
    angle = np.linalg.norm(v)
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = v / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


class Pad:
    """A rigid rectangle glued to both faces. It moves by `lift` less compliance [m/N] times force and
    turns about its centre by turn_compliance [rad/(N m)] times moment (rotation vector)."""

    def __init__(self, solid, centre, half, compliance=0.0, turn_compliance=0.0):
        self.centre = np.array([*centre, 0.0])
        near = np.abs(solid.nodes - self.centre)
        faces = np.abs(near[:, 2] - solid.lines[2][-1]) < 1e-9
        self.nodes = np.flatnonzero(
            faces & (near[:, 0] < half[0] + 1e-9) & (near[:, 1] < half[1] + 1e-9))
        self.X = solid.nodes[self.nodes] - self.centre
        self.prescribed = (3 * self.nodes[:, None] + np.arange(3)).ravel()
        self.C = self.aside = np.zeros((0, solid.w.x.array.size))  # what it holds is prescribed
        self.active = np.array([1, 2, 3] if solid.mirrored else range(6))
        self.times = 2 if solid.mirrored else 1
        self.compliance = np.repeat([compliance, turn_compliance], 3)
        self.q = np.zeros(6)
        self.target = np.zeros(6)
        self.load = np.zeros(6)  # of the pad on the tissue

    def aim(self, lift):
        self.target[:3] = lift

    def motions(self):
        """Columns: velocities of the nodes for a unit of each of the six."""
        x = self.X @ rotation(self.q[3:]).T
        T = np.zeros((3 * len(x), 6))
        for axis in range(3):
            T[axis::3, axis] = 1
            e = np.eye(3)[axis]
            T[:, 3 + axis] = np.cross(e, x).ravel()
        return T

    def add_force(self, solid, r):
        self.load = self.times * self.motions().T @ r[self.prescribed]

    def miss(self, solid, r):
        return MISS * (self.q - self.target + self.compliance * self.load)[self.active]

    def direction(self, solid, r):
        A = solid.A
        begin, columns, values = A.getValuesCSR()
        K = scipy.sparse.csr_matrix((values, columns, begin), shape=A.getSize())[self.prescribed]
        solid.factor(self.prescribed)
        b = np.where(solid.fixed, 0, -r)
        b[self.prescribed] = 0
        d = solid.solve_linear(b)
        T = self.motions()
        Y = np.zeros((len(self.active), len(r)))
        for k, j in enumerate(self.active):
            b = -(K.T @ T[:, j])
            b[solid.fixed] = 0
            b[self.prescribed] = T[:, j]
            Y[k] = solid.solve_linear(b)
        a = self.active
        C = self.times * self.compliance[a]
        S = np.eye(len(a)) + C[:, None] * (T[:, a].T @ (K @ Y.T))
        more = np.zeros(6)
        more[a] = np.linalg.solve(
            S, -self.miss(solid, r) / MISS - C * (T[:, a].T @ (K @ d)))
        return d + Y.T @ more[a], more

    def state(self):
        return self.q.copy()

    def move(self, solid, at, share, more):
        self.q = at + share * more if share else at.copy()
        x = self.centre + self.q[:3] + self.X @ rotation(self.q[3:]).T
        solid.w.x.array[self.prescribed] = (x - solid.nodes[self.nodes]).ravel()

    def force(self):
        """Of the tissue on the tool [N]."""
        return -np.where(np.isin(np.arange(3), self.active), self.load[:3], 0)

    def moment(self):
        """Of the tissue on the tool about the pad's centre [N m]."""
        return -np.where(np.isin(np.arange(3, 6), self.active), self.load[3:], 0)

"""A clamped soft sheet under gravity, moved by jaws, in MuJoCo 4: one quadratic flex of cells whose linear elasticity
turns with each cell, stepped by the integrator `discrete`, contact and elasticity in one solve.

Each node of the grid is a body on three sliders. What holds a node, clamp or jaws, is a spring on its sliders; MuJoCo
takes these springs implicitly, so a stiff one is as good as a rigid hold. Contact is at the nodes: a ball of RADIUS on
each of the lower face meets the board, which lies about that much lower. Box coordinates: x across from 0, y from the clamped
edge, z up from the board.
"""
import mujoco
import numpy as np

# MuJoCo first guesses a step by conjugate gradients, which 30 iterations cannot finish, and says so at every step. The
# Newton solve that follows factors the whole matrix, and the step is what that one finds.
mujoco.set_mju_user_warning(lambda text: None)

RADIUS = 2e-4  # [m] of the balls at the nodes
SOFT = 5e-5  # [m] that a sheet sinks into the board by its weight
DIVERGED = [mujoco.mjtWarning.mjWARN_BADQPOS, mujoco.mjtWarning.mjWARN_BADQVEL, mujoco.mjtWarning.mjWARN_BADQACC]
RIGID = 1e5  # [N/m] on a node that jaws hold


def lines(breaks, n):
    """Lines from the first to the last of `breaks` and through all of them, with about n cells of one size."""
    breaks = np.asarray(breaks, float)
    size = (breaks[-1] - breaks[0]) / n
    parts = [np.linspace(a, b, max(1, int(round((b - a) / size))) + 1) for a, b in zip(breaks[:-1], breaks[1:])]
    return np.concatenate([parts[0]] + [part[1:] for part in parts[1:]])


def halves(cells):
    return np.sort(np.concatenate([cells, (cells[1:] + cells[:-1]) / 2]))


def shares(cells):
    """Of a line's measure, by Simpson's rule, at its nodes."""
    out = np.zeros(2 * len(cells) - 1)
    for k, size in enumerate(np.diff(cells)):
        out[2 * k:2 * k + 3] += size * np.array([1, 4, 1]) / 6
    return out


class Sheet:
    def __init__(self, xs, ys, thickness, young, poisson, density, damping=0.0, friction=0.3, factor=None, ball=None,
                 yield_strain=0.0, step=0.01, gravity=9.81):
        """factor(x, y): of Young's modulus at a place. ball: (centre, radius, touched face 0 or 1)."""
        self.xs, self.ys, self.thickness, self.ball_radius = xs, ys, thickness, ball[1] if ball else 0.0
        zs = np.array([0, thickness])
        grid = np.meshgrid(halves(xs), halves(ys), halves(zs), indexing="ij")
        self.shape = grid[0].shape
        self.rest = np.stack(grid, -1).reshape(-1, 3)
        self.number = np.arange(len(self.rest)).reshape(self.shape)
        volume = np.einsum("i,j,k->ijk", shares(xs), shares(ys), shares(zs)).ravel()
        self.area = np.einsum("i,j->ij", shares(xs), shares(ys))
        self.mass = density * volume
        self.model = mujoco.MjModel.from_xml_string(self._xml(young, poisson, damping, friction, ball, yield_strain, step, gravity))
        m = self.model
        self.data = mujoco.MjData(m)
        self.h, self.time = step, 0.0
        self._stiffen(young, poisson, factor)
        self.goal = m.qpos_spring[1:].reshape(-1, 3)  # of the springs, as displacement; a view
        self.hold = m.jnt_stiffness[1:].reshape(-1, 3)
        self.hold[:] = 0
        self.data.qpos[1:].reshape(-1, 3)[:, 2] = -1e-5  # so that it touches the board in the first step

    def _xml(self, young, poisson, damping, friction, ball, yield_strain, step, gravity):
        top, bottom = self.number[:, :, 2], self.number[:, :, 0]
        touch = np.zeros(len(self.rest), int)  # 1 the board, 2 a ball
        touch[bottom] = 1
        if ball:
            touch[[bottom, top][ball[2]]] |= 2
        bodies = []
        for n, (x, mass) in enumerate(zip(self.rest, self.mass)):
            geom = f'<geom size="{RADIUS}" contype="0" conaffinity="{touch[n]}"/>' if touch[n] else ""
            sliders = "".join(f'<joint type="slide" axis="{axis}" stiffness="1"/>'
                              for axis in ("1 0 0", "0 1 0", "0 0 1"))
            bodies.append(f'<body name="n{n}" pos="{x[0]:.9g} {x[1]:.9g} {x[2]:.9g}"><inertial pos="0 0 0" mass="{mass:.9g}" '
                          f'diaginertia="{mass * 1e-6:.6g} {mass * 1e-6:.6g} {mass * 1e-6:.6g}"/>{sliders}{geom}</body>')
        corner = self.number[::2, ::2, ::2]
        tets = []
        for i, j, k in np.ndindex(*(np.array(corner.shape) - 1)):
            c = corner[i:i + 2, j:j + 2, k:k + 2]
            for a, b in (((1, 0, 0), (1, 1, 0)), ((1, 0, 0), (1, 0, 1)), ((0, 1, 0), (1, 1, 0)), ((0, 1, 0), (0, 1, 1)),
                         ((0, 0, 1), (1, 0, 1)), ((0, 0, 1), (0, 1, 1))):
                tets += [c[0, 0, 0], c[a], c[b], c[1, 1, 1]]
        renumber = np.full(len(self.rest), -1)
        renumber[corner.ravel()] = np.arange(corner.size)
        obstacle = ""
        if ball:
            centre, radius, _ = ball
            obstacle = (f'<body name="ball" mocap="true" pos="{centre[0]:.9g} {centre[1]:.9g} {centre[2]:.9g}">'
                        f'<geom size="{radius - RADIUS:.9g}" contype="2" conaffinity="0" condim="1" '
                        f'priority="1" solref="{step} 1" solimp=".9 .9997 .0003"/></body>')
        text = lambda v: " ".join(f"{x:.9g}" for x in np.ravel(v))
        # MuJoCo counts contacts where a step begins. Under a board that is stiff at once an edge would be thrown off and sink
        # in turns, by millimetres; so the board stiffens over 0.3 mm, and lies SOFT higher than where the sheet shall rest.
        # The body aside has a row of its own at all times, without which Newton would leave the first guess as it is.
        return f"""<mujoco><option integrator="discrete" solver="Newton" timestep="{step}" tolerance="1e-5" iterations="30"
gravity="0 0 {-gravity:.9g}"><flag island="disable"/></option>
<size memory="200M"/>
<default><geom type="sphere" condim="1" friction="0 0 0" solref="{step} 1" solimp=".9 .9999 .0003"/></default>
<worldbody><geom type="plane" size="1 1 .1" pos="0 0 {SOFT - RADIUS}" contype="1" conaffinity="0" condim="3" friction="{friction} 0 0"/>
<body name="aside" pos="0 0 1" gravcomp="1"><joint type="slide" frictionloss="1"/>
<geom size=".01" mass="1e-5" contype="0" conaffinity="0"/></body>
{obstacle}{"".join(bodies)}</worldbody>
<deformable><flex name="sheet" dim="3" radius="0.0001" dof="quadratic" cellcount="{len(self.xs) - 1} {len(self.ys) - 1} 1"
body="{' '.join(['world'] * corner.size)}" vertex="{text(self.rest[corner.ravel()])}" element="{text(renumber[tets])}"
node="{' '.join(f'n{n}' for n in range(len(self.rest)))}">
<contact contype="0" conaffinity="0" selfcollide="none"/>
<elasticity young="{young:.9g}" poisson="{poisson:.9g}" damping="{damping:.9g}" yield="{yield_strain:.9g}"/></flex></deformable></mujoco>"""

    def _stiffen(self, young, poisson, factor):
        """Each cell's stiffness. MuJoCo 4.0.0 gives every cell that of the first, so each is taken from a flex of one cell
        of its size, times the mean of the factor over it."""
        blocks = self.model.flex_stiffness.reshape(len(self.xs) - 1, len(self.ys) - 1, -1)
        within, known = (np.arange(16) + .5) / 16, {}
        for i, j in np.ndindex(*blocks.shape[:2]):
            size = np.round([self.xs[i + 1] - self.xs[i], self.ys[j + 1] - self.ys[j], self.thickness], 9)
            if tuple(size) not in known:
                known[tuple(size)] = mujoco.MjModel.from_xml_string(f"""<mujoco><worldbody><flexcomp name="c" type="grid" dim="3"
count="2 2 2" spacing="{size[0]} {size[1]} {size[2]}" dof="quadratic" cellcount="1 1 1" radius="0.0001"><contact contype="0"
conaffinity="0" selfcollide="none"/><elasticity young="{young:.9g}" poisson="{poisson:.9g}"/></flexcomp></worldbody></mujoco>"""
                                                                   ).flex_stiffness.ravel().copy()
            x, y = (v[k] + within * (v[k + 1] - v[k]) for v, k in ((self.xs, i), (self.ys, j)))
            blocks[i, j] = known[tuple(size)] * (factor(*np.meshgrid(x, y, indexing="ij")).mean() if factor else 1)

    # ---- what holds it --------------------------------------------------------------------------

    def springs(self, nodes, stiffness):
        """[N/m] on nodes, to where `goal` says; a number or one per node."""
        self.hold[nodes] = np.broadcast_to(stiffness, (len(nodes),))[:, None]

    def clamp(self, stiffness, strip, holds):
        """Springs of that many N/m3 under both faces from y = 0 to `strip`, a line of the grid; `holds` 0 or 1 by x."""
        within = shares(self.ys[self.ys < strip + 1e-9])
        area = np.zeros(self.shape[:2])
        area[:, :len(within)] = np.outer(shares(self.xs) * holds, within)
        for face in (0, 2):
            self.springs(self.number[:, :, face].ravel(), stiffness * area.ravel())

    def out_of_contact(self, nodes):
        """These touch neither board nor ball from now on."""
        for n in nodes:
            body = self.model.body(f"n{n}")
            if body.geomnum[0]:
                self.model.geom_conaffinity[body.geomadr[0]] = 0

    def ball(self):
        return self.data.mocap_pos[0].copy() if len(self.data.mocap_pos) else None

    def move_ball(self, centre):
        self.data.mocap_pos[0] = centre

    # ---- motion ---------------------------------------------------------------------------------

    def moved(self):
        return self.data.qpos[1:].reshape(-1, 3).copy()

    def positions(self):
        return self.rest + self.moved()

    def velocity(self):
        return self.data.qvel[1:].reshape(-1, 3)

    def advance(self, h=None):
        self.model.opt.timestep = h or self.h
        mujoco.mj_step(self.model, self.data)
        self.time += self.model.opt.timestep
        if any(self.data.warning[w].number for w in DIVERGED):
            raise RuntimeError(f"the step at {self.time:.3f} s has diverged")

    def calm(self, steps):
        """Towards rest: steps without inertia of before."""
        for _ in range(steps):
            self.advance()
        self.moving = np.abs(self.velocity()).max()
        self.data.qvel[:] = 0

    def pull(self, nodes):
        """Force of the tissue on what holds these nodes."""
        q = self.data.qpos[1:].reshape(-1, 3)[nodes]
        return -(self.hold[nodes] * (self.goal[nodes] - q)).sum(0)

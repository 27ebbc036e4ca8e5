#!/usr/bin/env python3
"""Peer of bench_elastic: the same lift by MuJoCo's flex, a shell of finite elements (double precision).

31 x 31 nodes, 90 x 90 x 3 mm, 1000 kg/m^3, E 100 kPa, nu 0, pinned edge, the 3 x 3 nodes of a corner moved on an arc, 2.4 s
of lift and 2 s of hold, by an implicit integrator with steps of 20 ms / SUBSTEPS. `peer_mujoco.py SURFACE` with the converged
surface that `bench_elastic 0 SURFACE` wrote. Prints env steps per second of one thread and the static error at the end.
"""
import sys
import time

try:
    import mujoco
    import numpy as np
except ImportError:
    print("# mujoco is not installed: no peer figure")
    sys.exit(0)

SIDE, PITCH, PINNED, STEP, DAMPING, STEPS = 31, 0.003, -0.045, 0.02, 3.0, 220
SUBSTEPS = 10


# The one that takes the forces of a flex implicitly.
INTEGRATOR = "discrete" if int(mujoco.__version__.split(".")[0]) >= 4 else "implicitfast"


def model_of():
    mass = 1000 * 0.003 * 0.09 * 0.09
    pinned = " ".join(str(SIDE * ix) for ix in range(SIDE))
    return mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{STEP / SUBSTEPS}" integrator="{INTEGRATOR}" solver="Newton" gravity="0 0 -9.81">
    <flag contact="disable"/>
  </option>
  <size memory="200M"/>
  <worldbody>
    <flexcomp name="sheet" type="grid" dim="2" count="{SIDE} {SIDE} 1" spacing="{PITCH} {PITCH} {PITCH}"
              mass="{mass}" radius="0.0015">
      <elasticity young="1e5" poisson="0" thickness="0.003" elastic2d="both"/>
      <contact selfcollide="none"/>
      <pin id="{pinned}"/>
    </flexcomp>
  </worldbody>
</mujoco>""")


def way_at(when):
    radius = 0.042 - PINNED
    angle = min(0.025 * when, 0.060) / radius
    return np.array([0, radius * (np.cos(angle) - 1), radius * np.sin(angle)])


def main():
    converged = np.loadtxt(sys.argv[1])
    model = model_of()
    model.dof_damping[:] = DAMPING * model.body_mass[model.dof_bodyid]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rest = data.flexvert_xpos.copy()
    # Nodes in our order: x outer, y inner.
    order = np.lexsort((np.round(rest[:, 1] / PITCH), np.round(rest[:, 0] / PITCH)))
    bodies = model.flex_vertbodyid
    corner = [order[SIDE * ix + iy] for ix in range(3) for iy in range(SIDE - 3, SIDE)]
    dofs = np.array([model.body_dofadr[bodies[v]] for v in corner])
    heavy = np.array([bodies[v] for v in corner])
    model.body_mass[heavy] *= 1e3  # the step must not move what is set
    mujoco.mj_setConst(model, data)
    best = 1e9
    for number in range(STEPS):
        if number % 20 == 0:
            begin = time.thread_time()
        for k in range(SUBSTEPS):
            when = STEP * (number + k / SUBSTEPS)
            now, then = way_at(when), way_at(when + STEP / SUBSTEPS)
            for axis in range(3):
                data.qpos[dofs + axis] = now[axis]
                data.qvel[dofs + axis] = (then[axis] - now[axis]) * SUBSTEPS / STEP
            mujoco.mj_step(model, data)
        if number % 20 == 19 and number > 25:
            best = min(best, (time.thread_time() - begin) / 20)
    mujoco.mj_kinematics(model, data)
    mujoco.mj_flex(model, data)
    off = data.flexvert_xpos[order] - converged
    error = 1e3 * np.sqrt((off ** 2).sum() / len(off))
    place = data.flexvert_xpos[order]
    print(f"peer.mujoco.env_steps_per_s {1 / best:.2f} steps/s")
    print(f"peer.mujoco.static_error_mm {error:.2f} mm # version {mujoco.__version__}, {SUBSTEPS} substeps, centre z "
          f"{1e3 * place[480, 2]:.2f} mm, free corner z {1e3 * place[960, 2]:.2f} mm")


if __name__ == "__main__":
    main()

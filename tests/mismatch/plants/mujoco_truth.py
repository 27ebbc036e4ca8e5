"""Runs the recordings of a case in MuJoCo, by the commands of protocol.py, and stores them as fenics_truth.py says."""
import mujoco
import numpy as np

import fenics_truth as common
import mujoco_sheet
import protocol
from protocol import DURATION

STEP = 0.05 / 3  # [s]
CELLS = 6  # along each side


def draw_case(effect, seed):
    case = protocol.draw_case(effect, seed, "mujoco")
    case["base"].update(law="corotated", mass_rate_per_s=0.0)  # it takes no damping by mass at a flex
    return case


def build(case, recording, cells, step):
    """-> sheet, nodes in the jaws, where the ball has to be at last"""
    b, effect, p = case["base"], case["effect"], case["parameters"]
    middle = np.array([b["width_m"], b["length_m"]]) / 2
    centre = middle + case["where"].get("centre_m", [0, 0])
    at, pad = common.pad_place(case, recording), np.array(b["pad_m"])
    low, high = at - pad / 2, at + pad / 2
    breaks = [0, low[0], high[0], b["width_m"]], [0, b["strip_m"], low[1], high[1], b["length_m"]]
    if effect.startswith("obstacle"):  # which only nodes feel: one of them at its top
        breaks = [sorted(v + [c]) if np.abs(np.array(v) - c).min() > .0015 else v for v, c in zip(breaks, centre)]
    xs, ys = (mujoco_sheet.lines(v, cells) for v in breaks)
    ball = factor = None
    if effect in ("inclusion", "soft_spot"):
        factor = lambda x, y: np.where(np.hypot(x - centre[0], y - centre[1]) < p["r"], p["k"], 1.0)
    if effect == "obstacle_below":
        ball = np.append(centre, p["protrusion"] - p["radius"]), p["radius"], 0
    if effect == "obstacle_above":
        ball = np.append(centre, b["thickness_m"] + p["gap"] + p["radius"]), p["radius"], 1
    s = mujoco_sheet.Sheet(xs, ys, b["thickness_m"], b["young_Pa"] * case["young_factor"][recording], b["poisson"],
                           b["density_kg_per_m3"], b["rate_time_s"], b["friction"], factor, ball, p.get("ey", 0.0), step)
    bed = b["bed_N_per_m3"]
    if effect == "anchor_compliance":
        bed = p["K_per_length"] / (2 * b["strip_m"])
    x = mujoco_sheet.halves(xs) - middle[0]
    holds = np.ones(len(x))
    if effect == "anchor_detachment":
        holds[(x > case["where"]["edge_interval_m"][0]) & (x < case["where"]["edge_interval_m"][1])] = 0
    s.clamp(bed, b["strip_m"], holds)
    return s, np.flatnonzero(common.within(s.rest, at, pad / 2))


def settle(s):
    """To rest on board and ball before the clock starts; a ball below comes up from under the board."""
    final = s.ball()
    if final is not None and final[2] < 0:
        for share in np.linspace(-1, 0, 21):
            s.move_ball(final + [0, 0, share * 2 * (final[2] + s.ball_radius)])
            s.calm(3)
    for _ in range(40):
        s.calm(3)
        if s.moving < 1e-5:
            break


class Jaws:
    """They close on a patch and carry its nodes along, each on a spring that is as good as rigid."""

    def __init__(self, case, recording, s, nodes):
        self.case, self.s, self.nodes = case, s, nodes
        self.tip, self.slipped, self.place = common.tip_path(case, recording), np.zeros(3), None
        b = case["base"]
        self.pull = b["young_Pa"] * b["thickness_m"] * b["width_m"] * .05  # [N] about that of the full lift

    def close(self):
        self.place = self.s.positions()[self.nodes]
        self.s.out_of_contact(self.nodes)
        self.s.springs(self.nodes, mujoco_sheet.RIGID)

    def carry(self, t):
        """Sets where the nodes have to be at t."""
        p, middle = self.place, self.place.mean(0)
        if self.case["effect"] == "jaw_orientation":
            angle = self.case["parameters"]["roll"] * np.clip((t - protocol.CLOSED + .2) / .2, 0, 1)
            p = middle + (p - middle) @ common.rotation(self.case["shaft"], angle).T
        self.s.goal[self.nodes] = p + self.tip(t) + self.slipped - self.s.rest[self.nodes]

    def yielded(self, force, h):
        """The patch slips along the pull once that is too much, as a whole, up to a length."""
        if self.case["effect"] != "grasp_slip":
            return
        p, size = self.case["parameters"], np.linalg.norm(force)
        speed = p["v0"] * max(size / (p["Fs_share"] * self.pull) - 1, 0)
        left = max(p["total"] - np.linalg.norm(self.slipped), 0)
        self.slipped = self.slipped + force / max(size, 1e-9) * min(speed * h, left)


def run_recording(case, recording, cells=CELLS, step=STEP, progress=lambda text: None, until=DURATION):
    """-> dictionary of arrays. Nothing is stepped before the jaws close, nor once all lies still again."""
    s, nodes = build(case, recording, cells, step)
    settle(s)
    jaws = Jaws(case, recording, s, nodes)
    take = protocol.CLOSED - (.2 if case["effect"] == "jaw_orientation" else 0)
    lowered = protocol.MOTIONS[protocol.RECORDINGS[recording][1]][-1][0] + .3  # delays included
    every = int(round(common.FRAME / step))
    frames, forces, still = [], [np.zeros(3)], True
    keep = lambda: frames.append(s.moved()[s.number[:, :, [0, 2]]].transpose(2, 0, 1, 3))
    keep()
    for k in range(int(round(until / step))):
        t = k * step
        if t > take - 1e-9 and jaws.place is None:
            jaws.close()
            still = False
        if not still:
            parts = 2 if protocol.RECORDINGS[recording][1] == protocol.FAST and .65 < t < 1.3 else 1
            for part in range(parts):
                jaws.carry(t + (part + 1) * step / parts)
                s.advance(step / parts)
            forces.append(s.pull(nodes))
            jaws.yielded(forces[-1], step)
            still = t > lowered and np.abs(s.velocity()).max() < 5e-5
        else:
            forces.append(forces[-1])
        if (k + 1) % every == 0:
            keep()
        if (k + 1) % (20 * every) == 0:
            progress(f"{t + step:.2f} s, force {np.round(forces[-1], 3)}")
    move = common.encode(np.rint(np.array(frames) / common.STEP_M).astype(np.int64))
    return {"xs": s.xs, "ys": s.ys, "move": move, "frame_s": common.FRAME * np.arange(len(frames)),
            "force_N": np.array(forces, np.float32), "step_s": step * np.arange(len(forces))}


def run_case(effect, seed, folder, cells=None, recordings=range(9), progress=print):
    case = draw_case(effect, seed)
    common.store(case, lambda case, k: run_recording(case, k, cells or CELLS, progress=progress), folder, recordings, progress)

"""Runs the recordings of a case and stores what happened: both faces, force, without any sensor.

<recording>.npz: `xs`, `ys` lines of the cells (nodes lie on them and half way between); `move` [frame][face, lower
first][x][y][xyz] int16, displacement of the nodes in steps of 10 um as differences over frames,
the upper face less the lower; `frame_s`;
`force_N` [step][xyz] of the tissue on the tool, `step_s`."""
import json
import os

import numpy as np

import protocol
from protocol import DURATION

STEP_M = 1e-5
FRAME = 0.05  # [s]


def play(commanded, half_width):
    """Tip behind a play of that half width per axis, at first in its middle."""
    out = commanded.copy()
    for k in range(1, len(out)):
        out[k] = np.clip(out[k - 1], commanded[k] - half_width, commanded[k] + half_width)
    return out


def tip_path(case, recording):
    """Way of the tip as it really is, as a function of time."""
    p = case["parameters"]
    delay = p["tau"] if case["effect"] == "actuation_delay" else 0
    t = np.arange(0, DURATION + 1e-9, 1e-3)
    way = protocol.path(case, recording, t - delay)
    if case["effect"] == "tool_backlash":
        way = play(way, p["b"])
    return lambda s: np.array([np.interp(s, t, way[:, k]) for k in range(3)])


def rotation(axis, angle):
    a = np.asarray(axis) / np.linalg.norm(axis)
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def within(x, centre, half):
    return np.all(np.abs(x[..., :2] - centre) < np.asarray(half) + 1e-9, axis=-1)


def pad_place(case, recording):
    """Centre of what the jaws hold: the pinch, this recording's jitter, a displaced grasp. It stays on the sheet."""
    b, pad = case["base"], np.array(case["base"]["pad_m"])
    at = np.array(case["pinches_m"][protocol.RECORDINGS[recording][0]]) + case["jitter_m"][recording]
    if case["effect"] == "grasp_offset":
        at = at + [case["parameters"]["x"], case["parameters"]["y"]]
    return np.clip(at, pad / 2 + 5e-4, np.array([b["width_m"], b["length_m"]]) - pad / 2 - 5e-4)


def build(case, recording, cells):
    import fenics_sheet
    import fenics_surface as faces
    b, effect, p = case["base"], case["effect"], case["parameters"]
    m = fenics_sheet.Material()
    m.young = b["young_Pa"] * case["young_factor"][recording]
    m.poisson, m.density, m.law = b["poisson"], b["density_kg_per_m3"], b["law"]
    m.rate_time, m.mass_rate = b["rate_time_s"], b["mass_rate_per_s"]
    middle = np.array([b["width_m"], b["length_m"]]) / 2
    centre = middle + case["where"].get("centre_m", [0, 0])
    if effect in ("inclusion", "soft_spot"):
        m.spot = (centre[0], centre[1], p["r"], p["k"])
    if effect == "anisotropy":
        m.fibre = (p["Ef_over_E"] * m.young, p["angle"])
    if effect == "strain_stiffening":
        m.stiffening = p["c2_over_mu"] * m.young / (2 * (1 + m.poisson))
    if effect == "viscoelastic":
        m.prony = (p["g"], p["tau"])
    at, pad = pad_place(case, recording), np.array(b["pad_m"])
    low, high = at - pad / 2, at + pad / 2
    xs = fenics_sheet.lines([0, low[0], high[0], b["width_m"]], cells)
    ys = fenics_sheet.lines([0, b["strip_m"], low[1], high[1], b["length_m"]], cells)
    s = fenics_sheet.Sheet(xs, ys, b["thickness_m"], m)
    held = within(s.rest, at, pad / 2)
    open_lower = ~within(s.lower.rest, at, pad / 2)
    s.terms = [faces.Board(s.lower, b["friction"], open_lower)]
    bed = b["bed_N_per_m3"]
    if effect == "anchor_compliance":
        bed = p["K_per_length"] / (2 * b["strip_m"])
    for face in (s.lower, s.upper):
        strip = (face.rest[..., 1] < b["strip_m"]) * 1.0
        if effect == "anchor_detachment":
            x = face.rest[..., 0] - middle[0]
            strip[(x > case["where"]["edge_interval_m"][0]) & (x < case["where"]["edge_interval_m"][1])] = 0
        s.terms.append(faces.Bed(face, bed, strip))
    s.ball = None
    if effect == "obstacle_below":
        top = p["protrusion"]
        s.ball = faces.Sphere(s.lower, [*centre, top - p["radius"]], p["radius"], open_lower)
    if effect == "obstacle_above":
        low_point = b["thickness_m"] + p["gap"]
        s.ball = faces.Sphere(s.upper, [*centre, low_point + p["radius"]], p["radius"], ~within(s.upper.rest, at, pad / 2))
    if s.ball:
        s.terms.append(s.ball)
    if effect == "adhesion":
        s.terms.append(faces.Adhesion(s.lower, p["k"], p["d0"], within(s.lower.rest, centre, case["where"]["half_size_m"]) * 1.0))
    return s, np.flatnonzero(held)


def settle(s):
    """To rest on board and ball before the clock starts; a ball below comes up from under the board."""
    nobody = lambda share: np.zeros((0, 3))
    terms, calm, branch = s.terms, s.material.mass_rate, s.material.rate_time
    s.terms = [term for term in terms if type(term).__name__ != "Adhesion"]
    s.material.mass_rate, s.material.rate_time = 200.0, 0.0
    s.start()
    if s.ball and s.ball.s is s.lower:
        final = s.ball.centre.copy()
        for share in np.linspace(-.9, 0, 19):
            s.ball.centre = final + [0, 0, share * (final[2] + s.ball.radius)]
            s.step(.05, nobody)
            s.halt()
    for h in (.02, .1, .5, 2):
        s.step(h, nobody)
        s.halt()
    s.terms, s.material.mass_rate, s.material.rate_time = terms, calm, branch
    s.start()


class Jaws:
    """Where the pad's nodes have to be; they keep their place to the tip from when the jaws have closed."""

    def __init__(self, case, recording, s, held):
        self.case, self.s, self.held = case, s, held
        self.tip, self.slip, self.taken = tip_path(case, recording), np.zeros(3), None
        # A tissue of this weight and stiffness pulls about so hard in the full lift.
        b = case["base"]
        self.scale = b["young_Pa"] * b["thickness_m"] * b["width_m"] * .05

    def take(self):
        self.s.pad = self.held
        self.taken = self.s.positions()[self.held].copy()

    def at(self, t):
        if self.taken is None:
            return np.zeros((0, 3))
        p, middle = self.taken, self.taken.mean(0)
        if self.case["effect"] == "jaw_orientation":  # they turn the tissue as they close
            angle = self.case["parameters"]["roll"] * np.clip((t - protocol.CLOSED + .2) / .2, 0, 1)
            p = middle + (p - middle) @ rotation(self.case["shaft"], angle).T
        return p + self.tip(t) + self.slip

    def after(self, h, force):
        if self.case["effect"] == "grasp_slip":
            p, size = self.case["parameters"], np.linalg.norm(force)
            over = size / (p["Fs_share"] * self.scale) - 1
            left = p["total"] - np.linalg.norm(self.slip)
            if over > 0 and left > 0:
                self.slip = self.slip + force / size * min(p["v0"] * over * h, left)


def run_recording(case, recording, cells=9, step=None, progress=lambda text: None):
    """-> dictionary of arrays."""
    motion = protocol.RECORDINGS[recording][1]
    h = step or .025
    s, held = build(case, recording, cells)
    settle(s)
    if s.branch:
        s.flow(1.0)  # a branch has long relaxed to the strain at rest
    jaws = Jaws(case, recording, s, held)
    # Jaws that turn take hold as they begin to close, all others as they have closed.
    take = protocol.CLOSED - (.2 if case["effect"] == "jaw_orientation" else 0)
    lowered = protocol.MOTIONS[motion][-1][0] + .3  # delays included
    count, every = int(round(DURATION / h)), int(round(FRAME / h))
    frames, forces, still = [], [np.zeros(3)], True
    keep = lambda: frames.append((s.positions() - s.rest)[s.grid[:, :, [0, 2]]].transpose(2, 0, 1, 3))
    keep()
    for k in range(count):
        t = k * h
        if t > take - 1e-9 and jaws.taken is None:
            jaws.take()
            still = False
        if not still:  # before it is taken and long after it is laid down nothing moves
            parts = 2 if motion == protocol.FAST and .65 < t < 1.3 else 1
            for part in range(parts):
                s.step(h / parts, lambda share: jaws.at(t + (part + share) * h / parts))
            jaws.after(h, s.force)
            still = t > lowered and np.abs(s.velocity).max() < 2e-5
        forces.append(np.zeros(3) if jaws.taken is None else s.force)
        if (k + 1) % every == 0:
            keep()
        if (k + 1) % (10 * every) == 0:
            progress(f"{t + h:.2f} s, {s.newton} + {s.chords} iterations, force {np.round(forces[-1], 3)}")
    move = encode(np.rint(np.array(frames) / STEP_M).astype(np.int64))
    return {"xs": s.xs, "ys": s.ys, "move": move, "frame_s": FRAME * np.arange(len(frames)),
            "force_N": np.array(forces, np.float32), "step_s": h * np.arange(count + 1)}


def encode(moved):
    """From displacements in steps."""
    coded = np.diff(moved, axis=0, prepend=0)
    coded[:, 1] -= coded[:, 0]
    return coded.astype(np.int16)


def decode(stored):
    """Displacements [frame][face][x][y][xyz] in metres."""
    move = stored["move"].astype(np.int64)
    move[:, 1] += move[:, 0]
    return np.cumsum(move, axis=0) * STEP_M


def thinned(stored):
    """The frames at .05, .15 ... s alone, which are those that the camera takes."""
    moved = np.rint(decode(stored)[1::2] / STEP_M).astype(np.int64)
    return dict(stored, move=encode(moved), frame_s=stored["frame_s"][1::2])


def store(case, run, folder, recordings, progress):
    """Runs what is not there yet; a recording is written under another name and renamed once it is whole."""
    os.makedirs(folder, exist_ok=True)
    path = os.path.join(folder, "truth.json")
    if os.path.exists(path):
        with open(path) as f:
            if json.load(f) != json.loads(json.dumps(case)):
                raise SystemExit(f"{path} is of another case: choose another folder")
    with open(path, "w") as f:
        json.dump(case, f, indent=1)
    for k in recordings:
        name = os.path.join(folder, f"r{k:02d}.npz")
        if os.path.exists(name):
            continue
        progress(f"{folder} r{k:02d}: {protocol.RECORDINGS[k][1]}")
        out = run(case, k)
        with open(name + ".part", "wb") as f:
            np.savez_compressed(f, **out)
        os.replace(name + ".part", name)


def run_case(effect, seed, folder, cells=None, recordings=range(9), progress=print):
    case = protocol.draw_case(effect, seed)
    store(case, lambda case, k: run_recording(case, k, cells or 9, progress=progress), folder, recordings, progress)

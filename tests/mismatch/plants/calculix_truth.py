"""Runs the recordings of a case in CalculiX, by the commands of protocol.py, and stores them as fenics_truth.py says. Every
frame is at rest: inertia and damping are left out, in the fast lift too."""
import sys

import numpy as np

import calculix_sheet
import fenics_truth as common
import protocol
from protocol import DURATION

CELLS = 7  # along each side
REACH_M = 0.0008  # of the jaws' nodes in an increment at most
HALVED = 2  # times that all increments are, where ccx by halving one gets nowhere


def draw_case(effect, seed):
    case = protocol.draw_case(effect, seed, "calculix")
    law = "Mooney-Rivlin" if case["base"]["law"] == "log" and effect != "strain_stiffening" else "neo-Hooke"
    case["base"].update(law=law, mass_rate_per_s=0.0, rate_time_s=0.0)
    return case


def build(case, recording, cells):
    b, effect, p = case["base"], case["effect"], case["parameters"]
    middle = np.array([b["width_m"], b["length_m"]]) / 2
    centre = middle + case["where"].get("centre_m", [0, 0])
    at, pad = common.pad_place(case, recording), np.array(b["pad_m"])
    low, high = at - pad / 2, at + pad / 2
    across = [0, low[0], high[0], b["width_m"]]
    free = [0.0, 0.0]
    if effect == "anchor_detachment":  # lines at its ends as well, where no other is near
        free = middle[0] + np.array(case["where"]["edge_interval_m"])
        across = sorted(across + [x for x in free if np.abs(np.array(across) - x).min() > .0015])
    xs = calculix_sheet.lines(across, cells)
    ys = calculix_sheet.lines([0, b["strip_m"], low[1], high[1], b["length_m"]], cells)
    m = calculix_sheet.Material()
    m.young = b["young_Pa"] * case["young_factor"][recording]
    m.poisson, m.density, m.law = b["poisson"], b["density_kg_per_m3"], b["law"]
    if effect == "strain_stiffening":
        m.law, m.stiffening = "Yeoh", p["c2_over_mu"] * m.young / (2 * (1 + m.poisson))
    factor = None
    if effect in ("inclusion", "soft_spot"):
        factor = lambda x, y: np.where(np.hypot(x - centre[0], y - centre[1]) < p["r"], p["k"], 1.0)
    s = calculix_sheet.Sheet(xs, ys, b["thickness_m"], m, factor)
    bed = b["bed_N_per_m3"]
    if effect == "anchor_compliance":
        bed = p["K_per_length"] / (2 * b["strip_m"])
    s.clamp(bed, b["strip_m"], lambda x: not free[0] < x < free[1])
    s.pad = common.within(s.rest, at, pad / 2)
    s.lie_on(b["friction"], (*centre, p["radius"], p["protrusion"]) if effect == "obstacle_below" else None)
    return s


def way_of(case, recording, taken):
    """Places of nodes that the jaws take at `taken` [n][xyz], as a function of time."""
    tip, middle = common.tip_path(case, recording), taken.mean(0)

    def places(t):
        p = taken
        if case["effect"] == "jaw_orientation":  # they turn the tissue as they close
            angle = case["parameters"]["roll"] * np.clip((t - protocol.CLOSED + .2) / .2, 0, 1)
            p = middle + (p - middle) @ common.rotation(case["shaft"], angle).T
        return p + tip(t)
    return places


def increments(places, times, reach):
    """-> times of increments in which no node goes farther than `reach`, and which of them each of `times` is. While
    nothing moves there are none: at rest nothing changes then."""
    out, which = [times[0]], [0]
    for a, b in zip(times[:-1], times[1:]):
        gone = np.linalg.norm(places(b) - places(a), axis=1).max()
        count = 0 if gone < 1e-8 else int(np.ceil(gone / reach))
        out += list(a + (b - a) * np.arange(1, count + 1) / max(count, 1))
        which.append(len(out) - 1)
    return np.array(out), np.array(which)


def carry(s, places, times, progress):
    """-> displacements and forces of the frames at `times` after the first in which anything has moved, and which of them
    each frame is, 0 the first. Where no rest is found the whole way is gone again in increments half as long."""
    exists = s.pad & (s.number > 0)
    for halved in range(HALVED + 1):
        reach = REACH_M / 2**halved
        steps, which = increments(places, times, reach)
        wanted = np.unique(which[which > 0])
        at = np.array([places(t) for t in steps])
        way = np.append(0, np.cumsum(np.maximum(np.linalg.norm(np.diff(at, axis=0), axis=2).max(axis=1) / reach, .02)))
        try:
            moved, force = s.carried(at - s.rest[exists], way, wanted)
            return moved, force, np.searchsorted(wanted, which, side="right")
        except calculix_sheet.Diverged as stopped:
            time = np.interp(stopped.time, way, steps)
            progress(f"no rest after {time:.3f} s in {len(steps) - 1} increments")
            last = stopped
    raise RuntimeError(f"no rest was found after {time:.3f} s; {last}")


def run_recording(case, recording, cells=CELLS, progress=lambda text: None, until=DURATION):
    """-> dictionary of arrays."""
    s = build(case, recording, cells)
    try:
        rest = s.settled()
    except calculix_sheet.Diverged as stopped:
        raise RuntimeError(f"no rest was found before the jaws close; {stopped}") from None
    # Jaws that turn take hold as they begin to close, all others as they have closed.
    take = protocol.CLOSED - (.2 if case["effect"] == "jaw_orientation" else 0)
    frames = common.FRAME * np.arange(int(round(until / common.FRAME)) + 1)
    first = int(round(take / common.FRAME))
    exists = s.pad & (s.number > 0)
    places = way_of(case, recording, s.rest[exists] + rest[exists])
    moved, force, which = carry(s, places, frames[first:], progress)
    progress(f"{len(force)} frames on {len(s.xs) - 1} x {len(s.ys) - 1} cells, largest pull {np.linalg.norm(force, axis=1).max():.3f} N")
    moved, force = np.concatenate([[rest], moved]), np.concatenate([[np.zeros(3)], force])
    of = np.concatenate([np.zeros(first, int), which])
    faces = moved[:, :, :, [0, 2]].transpose(0, 3, 1, 2, 4)[of]
    move = common.encode(np.rint(faces / common.STEP_M).astype(np.int64))
    return {"xs": s.xs, "ys": s.ys, "move": move, "frame_s": frames, "force_N": force[of].astype(np.float32), "step_s": frames}


def run_case(effect, seed, folder, cells=None, recordings=range(9), progress=print):
    case = draw_case(effect, seed)
    if not calculix_sheet.program():
        raise SystemExit("--plant calculix needs the program ccx, Debian's package calculix-ccx")
    try:
        common.store(case, lambda case, k: run_recording(case, k, cells or CELLS, progress=progress), folder, recordings, progress)
    except RuntimeError as stopped:
        sys.exit(f"{folder}: {stopped}")

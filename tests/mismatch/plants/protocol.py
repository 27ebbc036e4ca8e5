"""What one case is: a sheet, nine commanded motions and at most one thing that the operator does not know of.

All of it is drawn from the seed. Box coordinates as in fenics_sheet.py: x across from 0 to the width, y from the
clamped edge, z up from the board. Frame B of the labels: the same axes from the centre of the sheet. Frame S of
scene_believed.txt: x away from the clamp, y along it, right-handed: S = (y, width - x, z)."""
import numpy as np

DURATION = 4.0  # [s] of every recording, so that no length tells anything
CLOSED = 0.5  # [s] jaws close from 0.3 s on
EFFECTS = ["null", "inclusion", "soft_spot", "anisotropy", "obstacle_below", "obstacle_above", "anchor_detachment",
           "anchor_compliance", "grasp_offset", "jaw_orientation", "adhesion", "viscoelastic", "strain_stiffening",
           "tool_backlash", "actuation_delay", "grasp_slip", "plastic_set"]
# What each plant can express of its own. The place of a name in EFFECTS is part of the seeds: names are added at the end.
PLANTS = {
    "fenics": EFFECTS[:16],
    "mujoco": ["null", "inclusion", "soft_spot", "obstacle_below", "obstacle_above", "anchor_detachment", "anchor_compliance",
               "grasp_offset", "jaw_orientation", "tool_backlash", "actuation_delay", "grasp_slip", "plastic_set"],
    "calculix": ["null", "inclusion", "soft_spot", "obstacle_below", "anchor_detachment", "anchor_compliance", "grasp_offset",
                 "jaw_orientation", "strain_stiffening", "tool_backlash", "actuation_delay"],
    "own": EFFECTS[:16]}
# Height over the full lift, tug over the full tug, by time; straight between, rounded over 80 ms.
MOTIONS = {
    "slow lift in two levels, return, lower": [
        (0, 0, 0), (.6, 0, 0), (1.1, .5, 0), (1.4, .5, 0), (1.9, 1, 0), (2.3, 1, 0), (2.7, .4, 0), (2.9, .4, 0), (3.3, 0, 0)],
    "fast lift, hold, fast return": [
        (0, 0, 0), (.7, 0, 0), (.9, 1, 0), (2.1, 1, 0), (2.25, .3, 0), (2.8, .3, 0), (3.0, 0, 0)],
    "lift, lower, rest, lift again": [
        (0, 0, 0), (.6, 0, 0), (1.0, .6, 0), (1.45, 0, 0), (1.95, 0, 0), (2.5, .8, 0), (2.8, .8, 0), (3.35, 0, 0)],
    "low lift, pull to the side, long hold": [
        (0, 0, 0), (.6, 0, 0), (.95, .4, 0), (1.3, .4, 1), (2.6, .4, 1), (2.95, .4, 0), (3.3, 0, 0)]}
SLOW, FAST, TWICE, TUG = MOTIONS
# Pinch and motion of each recording; the last repeats the first.
RECORDINGS = [(0, SLOW), (1, SLOW), (2, SLOW), (3, SLOW), (4, SLOW), (0, FAST), (1, TWICE), (0, TUG), (0, SLOW)]


def path(case, recording, t):
    """Commanded motion of the tip from where it closed [n][xyz] at times t."""
    motion = np.array(MOTIONS[RECORDINGS[recording][1]])
    fine = np.arange(-1.0, DURATION + 1, 1e-3)
    window = np.ones(81) / 81
    height, tug = (np.convolve(np.interp(fine, motion[:, 0], motion[:, k]), window, "same") for k in (1, 2))
    lift = case["lift_m"][recording] * np.interp(t, fine, height)
    side = np.interp(t, fine, tug)[..., None] * np.asarray(case["tug_m"])
    return np.stack([side[..., 0], side[..., 1], lift], axis=-1)


def jaw_angle(t):
    return 0.6 * np.clip((CLOSED - np.asarray(t)) / 0.2, 0, 1)


def draw_effect(name, rng, base):
    """Numbers under the names of the catalogue, and the place in B, of a size that is well worth noticing."""
    width, length = base["width_m"], base["length_m"]
    place = np.array([rng.uniform(-.22, .22) * width, rng.uniform(-.18, .18) * length])
    u, sign = rng.uniform, rng.choice([-1, 1])
    log = lambda a, b: float(np.exp(u(np.log(a), np.log(b))))
    where = {"centre_m": place.tolist()}
    if name == "inclusion":
        return {"k": log(4, 9), "r": u(.008, .011)}, where
    if name == "soft_spot":
        return {"k": u(.15, .3), "r": u(.010, .013)}, where
    if name == "anisotropy":
        return {"Ef_over_E": log(.8, 2.5), "angle": u(0, np.pi)}, {}
    if name == "obstacle_below":  # a ball sunk in the board, that stands out by the protrusion
        return {"radius": u(.008, .014), "protrusion": u(.002, .0035)}, where
    if name == "obstacle_above":
        return {"radius": u(.006, .010), "gap": u(.002, .005)}, where
    if name == "anchor_detachment":
        piece = u(.22, .33) * width
        start = rng.choice([0.0, u(.1, .6) * width, width - piece])
        return {"length": piece}, {"edge_interval_m": [start - width / 2, start + piece - width / 2]}
    if name == "anchor_compliance":
        return {"K_per_length": log(300, 1500)}, {}
    if name == "grasp_offset":
        angle, size = u(0, 2 * np.pi), u(.0025, .0045)
        return {"x": size * np.cos(angle), "y": size * np.sin(angle), "offset": size}, {}
    if name == "jaw_orientation":
        return {"roll": sign * np.radians(u(15, 30)), "tilt": 0.0, "lean": 0.0}, {}
    if name == "adhesion":  # work of parting k d0^2
        G, d0 = log(.4, 1.6), u(.0005, .001)
        return {"G": G, "k": G / d0**2, "d0": d0}, dict(where, half_size_m=[u(.009, .014), u(.009, .014)])
    if name == "viscoelastic":
        return {"g": u(.25, .5), "tau": log(.25, .9)}, {}
    if name == "strain_stiffening":
        return {"c2_over_mu": log(3, 10)}, {}
    if name == "tool_backlash":
        return {"b": u(.0008, .0016)}, {}
    if name == "actuation_delay":
        return {"tau": u(.07, .14)}, {}
    if name == "grasp_slip":
        return {"v0": u(.003, .006), "Fs_share": u(.35, .6), "total": u(.002, .004)}, {}
    if name == "plastic_set":  # ideal: beyond the strain ey the shape flows
        return {"ey": log(.008, .02)}, {}
    return {}, {}


def draw_case(effect, seed, plant="fenics"):
    """The truth of a case as one dictionary that JSON keeps. The same seed draws the same for every plant."""
    if effect not in PLANTS[plant]:
        raise SystemExit(f"--effect {effect}: the plant {plant} has {', '.join(PLANTS[plant])}")
    rng = np.random.default_rng([77, seed])
    u = rng.uniform
    base = {
        "width_m": round(u(.050, .070), 3), "length_m": round(u(.050, .070), 3), "thickness_nominal_m": round(u(.0025, .0035), 4),
        "young_Pa": float(np.exp(u(np.log(15e3), np.log(80e3)))), "poisson": u(.45, .475), "density_kg_per_m3": 1050 * u(.99, 1.01),
        "law": str(rng.choice(["log", "split"])), "rate_time_s": u(.004, .012), "mass_rate_per_s": u(.3, 1.0),
        "friction": u(.22, .42), "strip_m": round(u(.005, .007), 4), "bed_N_per_m3": float(np.exp(u(np.log(2e7), np.log(8e7)))),
        "pad_m": [round(u(.005, .007), 4), round(u(.005, .007), 4)]}
    base["thickness_m"] = base["thickness_nominal_m"] * u(.985, 1.015)
    width, length, pad = base["width_m"], base["length_m"], base["pad_m"]
    rim = [length - pad[1] / 2 - u(.001, .003) for _ in range(3)]
    side = [pad[0] / 2 + u(.001, .003), width - pad[0] / 2 - u(.001, .003)]
    pinches = [[width * u(.42, .58), rim[0]], [width * u(.2, .28), rim[1]], [width * u(.72, .8), rim[2]],
               [side[0], length * u(.5, .66)], [side[1], length * u(.5, .66)]]
    full = length * u(.27, .33)
    # At a side the clamp is nearer: the same height would pull there with much more force.
    lifts = [full * (.8 if pinch > 2 else 1) for pinch, _ in RECORDINGS]
    angle = rng.choice([-1, 1]) * u(.7, 1.0) * np.pi / 2  # mostly across, which bends and shears
    tug = u(.006, .009)
    lean = np.radians(u(5, 18))
    turn = u(0, 2 * np.pi)
    truth = {
        "format": 1, "seed": seed, "engine": plant, "effect": effect, "base": base, "pinches_m": pinches, "lift_m": lifts,
        "tug_m": [tug * np.sin(angle), tug * np.cos(angle)],
        "shaft": [np.sin(lean) * np.cos(turn), np.sin(lean) * np.sin(turn), np.cos(lean)],
        "held_out": sorted([int(rng.integers(1, 5)), int(rng.choice([5, 6]))]),
        "jitter_m": np.clip(rng.normal(0, .0005, (9, 2)), -.001, .001).tolist(),
        "young_factor": np.clip(1 + rng.normal(0, .015, 9), .97, 1.03).tolist()}
    truth["parameters"], truth["where"] = draw_effect(effect, rng, base)
    return truth

#!/usr/bin/python3
"""Makes cases with concealed physics for `mismatch explain` to find.

  truth   simulates the nine recordings of a case into TRUTHDIR; what is there is kept, so it can be resumed
  thin    copies a truth with the frames that a camera of 10 Hz sees, half the size
  case    draws sensor, clocks and registration over a truth and writes a case folder; it prints the
          SHA-256 of every file and of the label, which without --labels only `label` writes
  label   writes the label of a case that was made without one
  differ  prints how far two truths of one seed are apart, in height of the upper face where the jaws are highest, and
          how hard they pull there
  plan    prints the cases of a batch, one a line: name, effect, seed of the truth, seed of the sensor
"""
import argparse
import hashlib
import importlib
import os
import shutil
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))

import numpy as np

import case_folder
import fenics_truth
import protocol


def thin(source, target):
    os.makedirs(target)
    shutil.copy(os.path.join(source, "truth.json"), target)
    for name in sorted(os.listdir(source)):
        if name.endswith(".npz"):
            with np.load(os.path.join(source, name)) as stored:
                out = fenics_truth.thinned({key: stored[key] for key in stored.files})
            np.savez_compressed(os.path.join(target, name), **out)


def upper_face(stored, frame, count=60):
    """Height over that at rest [m] at count x count places that cover the sheet evenly."""
    def between(lines):
        """Matrix from nodes on and half way between the lines to the places."""
        at = (np.arange(count) + .5) / count * lines[-1]
        cell = np.clip(np.searchsorted(lines, at) - 1, 0, len(lines) - 2)
        s = (at - lines[cell]) / np.diff(lines)[cell]
        out = np.zeros((count, 2 * len(lines) - 1))
        for k, weight in enumerate(((1 - s) * (1 - 2 * s), 4 * s * (1 - s), s * (2 * s - 1))):
            out[np.arange(count), 2 * cell + k] = weight
        return out
    return between(stored["xs"]) @ fenics_truth.decode(stored)[frame, 1, :, :, 2] @ between(stored["ys"]).T


def differ(first, second):
    for name in sorted(set(os.listdir(first)) & set(os.listdir(second))):
        if name.endswith(".npz"):
            a, b = (np.load(os.path.join(folder, name)) for folder in (first, second))
            times = np.intersect1d(np.round(a["frame_s"], 6), np.round(b["frame_s"], 6))
            at = lambda v, t: int(np.argmin(np.abs(v - t)))
            # The middle of the time in which they are as high as they get.
            high = np.array([fenics_truth.decode(a)[at(a["frame_s"], t), 1, :, :, 2].max() for t in times])
            t = np.median(times[high > high.max() - 2e-5])
            t = times[at(times, t)]
            off = upper_face(a, at(a["frame_s"], t)) - upper_face(b, at(b["frame_s"], t))
            pull = [np.linalg.norm(v["force_N"][at(v["step_s"], t)]) for v in (a, b)]
            print(f"{name[:3]} at {t:.2f} s: {1e3 * np.sqrt((off**2).mean()):.3f} mm rms, {1e3 * np.abs(off).max():.3f} mm at most; pull "
                  f"{pull[0]:.3f} and {pull[1]:.3f} N")


# Of each pair a smoke batch has one.
SMOKE = {
    "fenics": [["adhesion", "obstacle_below"], ["grasp_offset", "anchor_detachment"], ["tool_backlash", "viscoelastic"]],
    "mujoco": [["plastic_set", "obstacle_below"], ["grasp_offset", "anchor_detachment"], ["tool_backlash", "actuation_delay"]],
    "calculix": [["strain_stiffening", "obstacle_below"], ["grasp_offset", "anchor_detachment"], ["tool_backlash", "actuation_delay"]],
    "own": [["adhesion", "obstacle_below"], ["grasp_offset", "anchor_detachment"], ["tool_backlash", "viscoelastic"]]}


def truth_seed(effect, index):
    return 101 + 40 * index + protocol.EFFECTS.index(effect)


def plan(batch, seed, plant="fenics"):
    """A batch in the order of its names, which tell nothing. The first truths of an effect serve every seed of a smoke
    batch, so that what is kept is used again; the sensor is always drawn anew."""
    place = list(protocol.PLANTS).index(plant)
    rng = np.random.default_rng([80, seed, place] if place else [80, seed])
    if batch == "smoke":
        chosen = [("null", 0), ("null", 1), ("inclusion", 0)] + [(rng.choice(pair), 0) for pair in SMOKE[plant]]
    else:
        chosen = [("null", k) for k in range(8)] + [(e, k) for e in protocol.PLANTS[plant][1:] for k in range(2)]
    rows = [(f"{rng.integers(16**8):08x}", str(e), truth_seed(e, k), int(rng.integers(2**31))) for e, k in chosen]
    return sorted(rows)


def arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    commands = parser.add_subparsers(dest="command", required=True)
    truth = commands.add_parser("truth")
    truth.add_argument("--plant", choices=protocol.PLANTS, default="fenics")
    truth.add_argument("--effect", required=True, choices=protocol.EFFECTS)
    truth.add_argument("--seed", type=int, required=True)
    truth.add_argument("-o", dest="folder", required=True)
    truth.add_argument("--cells", type=int, help="along each side of the sheet; 9 of fenics, 7 of calculix, 6 of mujoco if not said")
    truth.add_argument("--recordings", type=int, nargs="*", default=list(range(9)))
    thinner = commands.add_parser("thin")
    thinner.add_argument("truth")
    thinner.add_argument("-o", dest="folder", required=True)
    difference = commands.add_parser("differ")
    difference.add_argument("truth")
    difference.add_argument("other")
    for name in ("case", "label"):
        c = commands.add_parser(name)
        c.add_argument("truth")
        c.add_argument("--seed", type=int, required=True, help="of the sensor")
        c.add_argument("-o", dest="folder", required=True, help="the case folder; its name is the name of the case")
        c.add_argument("--labels", required=name == "label")
        c.add_argument("--force", choices=["yes", "no"], help="with a force sensor or not; drawn if not said")
    batch = commands.add_parser("plan")
    batch.add_argument("--plant", choices=protocol.PLANTS, default="fenics")
    batch.add_argument("--batch", choices=["smoke", "dev"], required=True)
    batch.add_argument("--seed", type=int, required=True)
    return parser.parse_args()


def main():
    a = arguments()
    if a.command == "truth":
        try:
            engine = importlib.import_module(f"{a.plant}_truth")
        except ModuleNotFoundError as missing:
            raise SystemExit(f"--plant {a.plant} needs the Python package {missing.name}, which {sys.executable} does not have") from None
        engine.run_case(a.effect, a.seed, a.folder, a.cells, a.recordings, lambda text: print(text, flush=True))
    elif a.command == "plan":
        for row in plan(a.batch, a.seed, a.plant):
            print(*row)
    elif a.command == "differ":
        differ(a.truth, a.other)
    elif a.command == "thin":
        thin(a.truth, a.folder)
    else:
        label = case_folder.write_case(a.truth, a.seed, a.folder, {"yes": True, "no": False, None: None}[a.force], a.command == "label")
        if a.labels:
            case_folder.write_label(label, a.labels)
        if a.command == "case":
            print(*case_folder.digest(a.folder), sep="\n")
        print(f"{hashlib.sha256(case_folder.label_bytes(label)).hexdigest()}  {label['case']}.json")


if __name__ == "__main__":
    main()

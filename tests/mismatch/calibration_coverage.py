#!/usr/bin/env python3
"""How often the 90 % intervals of `mismatch calibrate` hold the truth: small cases of the own engine whose numbers are drawn
from what is believed of them.

/usr/bin/python3 calibration_coverage.py MISMATCH SCRATCH [--cases 100] [--first 0] [--threads 1] [--moving]
    [--recorded-mm 3] [--tolerance-mm 3]

The meshes of recordings and fit are of those tolerances; that of a fit is not graded for the clamp of neo-Hooke, and so stiffer.
A case leaves SCRATCH/case<N>.json and is not computed again; at the end the table of all cases that are there.
"""
import argparse
import json
import math
import re
import shutil
from pathlib import Path

import numpy as np

import small_lifts as small

MATERIAL, EFFECTS, SENSOR = "scene.tissue.material.", "scene.tissue.effects.", "scene.depth_sensor."
# What docs/calibrate.md 2 takes where nothing is stated, but for the stiffness (small_lifts.PRIORS).
PINCH, FACTOR, CLOCK, OWN_CLOCK = 1.5e-3, 0.05, 0.05, 0.005
MOST_POISSON = 0.489  # its knob ends at 0.49


def draw(number):
    """Numbers of the true scene by path, pinches [m], ln of the factors on E, clocks [s] of the lifts."""
    random = np.random.default_rng([18, number])
    normal = random.normal
    count = len(small.PINCHES)
    poisson = 1.0
    while poisson > MOST_POISSON:
        poisson = normal(0.45, 0.03)
    truth = {MATERIAL + "young_modulus_pa": 60e3 * math.exp(math.log(2) * normal()),
             MATERIAL + "damping_per_s": 5 * math.exp(math.log(3) * normal()),
             MATERIAL + "poisson_ratio": poisson,
             EFFECTS + "bending_change": math.exp(math.log(1.15) * normal()) - 1,
             EFFECTS + "friction_change": math.exp(math.log(1.6) * normal()) - 1,
             "scene.tissue.thickness_m": small.THICKNESS * math.exp(math.log(1.05) * normal()),
             SENSOR + "time_offset_s": float(np.clip(CLOCK * normal(), -0.24, 0.24))}
    for axis in "xyz":
        truth[f"{SENSOR}registration_m.{axis}"] = 0.002 * normal()
        truth[f"{SENSOR}registration_deg.{axis}"] = 0.7 * normal()
    return truth, PINCH * normal(size=(count, 2)), FACTOR * normal(size=count), OWN_CLOCK * normal(size=count)


def moments(number):
    """Of each lift: when the camera takes a cloud of each hold, anywhere in its last 0.3 s [s]. Were it always the moment the
    jaws go on, any clock later than the true one would show the same tissue and any earlier one tissue that has moved: the
    truth would be the edge of what is possible in every case, and no interval of 90 % holds its edge."""
    random = np.random.default_rng([19, number])
    return [[end - 0.02 * random.integers(1, 16) for end in small.HOLDS] for _ in small.PINCHES]


def expected(truth, offsets, factors, clocks):
    """The truth by the names of calibration.json."""
    names = {}
    for path, value in truth.items():
        if path.startswith(SENSOR + "registration_m"):
            path = "registration." + path[-1]
        elif path.startswith(SENSOR + "registration_deg"):
            path, value = "registration.turn_" + path[-1], math.radians(value)
        names[path] = value
    for k in range(len(offsets)):
        names[f"lift{k}: pinch.x"], names[f"lift{k}: pinch.y"] = offsets[k]
        names[f"lift{k}: stiffness.ln_factor"] = factors[k]
        names[f"lift{k}: clock"] = clocks[k]
    return names


def compute(program, number, folder, args):
    truth, offsets, factors, clocks = draw(number)
    times = [np.arange(0.2, 1.5, 0.1)] * len(small.PINCHES) if args.moving else moments(number)
    small.PRIORS = ((MATERIAL + "young_modulus_pa", "factor", 2), *small.PRIORS[1:])
    small.write_case(program, folder, truth, offsets, number, times, np.exp(factors), ("--tolerance-mm", args.recorded_mm),
                     cloud_rate=10 if args.moving else 50)
    for k, clock in enumerate(clocks):
        index = folder / "lifts" / f"lift{k}" / "clouds.csv"
        header, *rows = index.read_text().splitlines()
        moved = [f"{float(row.split(',')[0]) + clock:.9g},{row.split(',')[1]}" for row in rows]
        index.write_text("\n".join([header, *moved]) + "\n")
    small.calibrate(program, folder, folder / "out", ["--threads", args.threads, "--tolerance-mm", args.tolerance_mm,
                                                     "--no-leave-out"])
    return counted(folder / "out", expected(truth, offsets, factors, clocks))


def counted(out, truth):
    """What was found beside the truth, by the names of calibration.json."""
    found = json.loads((out / "calibration.json").read_text())
    kept = {}
    for name, value in truth.items():
        n = small.number(found, name)
        kept[name] = {"true": float(value), "value": n["value"], "low": n["low90"], "high": n["high90"],
                      "prior": n["prior"]["high90"] - n["prior"]["low90"]}
    return {"numbers": kept, "core_seconds": found["core_seconds"], "warnings": found["warnings"],
            "laws": found["laws"]}


def table(cases):
    rows = {}
    for case in cases:
        for name, n in case["numbers"].items():
            kind = re.sub(r"lift\d: ", "lifts: ", name)
            inside = n["low"] <= n["true"] <= n["high"]
            seen = n["high"] - n["low"] < 0.9 * n["prior"]
            rows.setdefault(kind, []).append((inside, seen, (n["high"] - n["low"]) / n["prior"]))
    print(f"{'number':44s} inside of seen   inside of all   width against the belief's")
    total = {True: [0, 0], False: [0, 0]}
    for kind, list_ in rows.items():
        seen = [i for i, s, _ in list_ if s]
        for of, values in ((True, seen), (False, [i for i, _, _ in list_])):
            if not kind.startswith("lifts"):
                total[of][0] += sum(values)
                total[of][1] += len(values)
        share = f"{sum(seen)} of {len(seen)}" if seen else "-"
        print(f"{kind:44s} {share:>14s}   {sum(i for i, _, _ in list_):4d} of {len(list_):4d}   "
              f"{np.median([w for _, _, w in list_]):.2f}")
    for of, words in ((True, "seen"), (False, "all")):
        inside, count = total[of]
        print(f"shared numbers, {words}: {inside} of {count}, {100 * inside / max(count, 1):.1f} %")
    print(f"{len(cases)} cases, {np.mean([c['core_seconds'] for c in cases]):.1f} core-seconds each")


def run(compute, args):
    """compute(program, number, folder, args) of every case that is not there."""
    args.scratch.mkdir(parents=True, exist_ok=True)
    for number in range(args.first, args.first + args.cases):
        file = args.scratch / f"case{number}.json"
        if file.exists():
            continue
        folder = args.scratch / f"case{number}"
        shutil.rmtree(folder, ignore_errors=True)
        try:
            case = compute(args.program, number, folder, args)
        except AssertionError as error:
            print(f"case {number}: {error}", flush=True)
            continue
        file.write_text(json.dumps(case, indent=1) + "\n")
        shutil.rmtree(folder)
        print(f"case {number}: {case['core_seconds']:.1f} core-seconds", flush=True)
    table([json.loads(f.read_text()) for f in sorted(args.scratch.glob("case*.json"))])


def arguments(cases, tolerance):
    """A parser of what run() takes."""
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--cases", type=int, default=cases)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--threads", default="1")
    parser.add_argument("--tolerance-mm", default=tolerance)
    parser.add_argument("--moving", action="store_true")
    return parser


if __name__ == "__main__":
    options = arguments(100, "3")
    options.add_argument("--recorded-mm", default="3")
    run(compute, options.parse_args())

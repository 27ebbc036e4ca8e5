#!/usr/bin/env python3
"""How often the 90 % intervals of `mismatch calibrate` hold the truth of another engine: small sheets that DOLFINx lifted
(tests/reference/run_lift_cases.py), whose numbers are drawn from what is believed of them. Shares no code with the simulation.

/usr/bin/python3 lift_cases.py MISMATCH SCRATCH [--cases 12] [--first 0] [--threads 1] [--moving] [--tolerance-mm 0.6]

At rest: a cloud in the last 0.3 s of each hold, before its end; --moving: ten a second. Registration, clocks, the moments of the
clouds and where the jaws closed against what the robot says are drawn here. SCRATCH/case<N>.json as of calibration_coverage.py.
"""
import subprocess
from pathlib import Path

import numpy as np

import calibration_coverage as coverage
import lift_recordings as recordings

LIFTS = Path(__file__).parents[1] / "reference" / "results" / "lift_cases"
HOLDS = (0.9, 1.7)  # [s] of the lifts
BELIEVED = {"thickness": 0.003, "density": 1000, "young": 50e3, "factor": 2}
FRICTION = 0.25  # of lift_recordings.BELIEF


def write_case(number, folder, moving):
    """The recordings into `folder`; their truth by the names of calibration.json."""
    random = np.random.default_rng([47, number])
    turn_deg, shift = 0.7 * random.normal(size=3), 0.002 * random.normal(size=3)
    clock = float(np.clip(coverage.CLOCK * random.normal(), -0.24, 0.24))
    files = [np.load(f) for f in sorted((LIFTS / f"case{number}").glob("lift*.npz"))]
    offsets = coverage.PINCH * random.normal(size=(len(files), 2))
    clocks = coverage.OWN_CLOCK * random.normal(size=len(files))
    moments = np.random.default_rng([48, number])
    recordings.write_belief(folder, float(np.ptp(files[0]["rest_m"][:, 0])), **BELIEVED)
    for k, lift in enumerate(files):
        # The robot knows the height over the board that it was told, not how thick the tissue is.
        told = lift["path_m"] - np.append(offsets[k], lift["path_m"][0, 2] - BELIEVED["thickness"] / 2)
        # Anywhere in a hold, as those of calibration_coverage.moments.
        taken = np.array(HOLDS) - 0.1 * moments.integers(1, 4, len(HOLDS))
        far = np.abs(lift["times_s"][:, None] - taken).min(axis=1)
        frames = np.flatnonzero((far < 1e-6) | (moving & (lift["times_s"] > 0.15)))
        recordings.write_recording(folder / f"lift{k}", lift, told, frames, clock + clocks[k], recordings.turn(turn_deg),
                                   shift, np.random.default_rng([47, number, k]))
    sheet = files[0]
    material, effects, sensor = coverage.MATERIAL, coverage.EFFECTS, coverage.SENSOR
    truth = {material + "young_modulus_pa": float(sheet["young_sheet_Pa"]),
             material + "damping_per_s": float(sheet["damping_per_s"]),
             material + "poisson_ratio": float(sheet["poisson"]),
             effects + "bending_change": 0.8 * float(sheet["skins"]),  # dolfinx_solid.Solid
             effects + "friction_change": float(sheet["friction"]) / FRICTION - 1,
             "scene.tissue.thickness_m": float(sheet["thickness_m"]),
             sensor + "time_offset_s": clock}
    for axis in range(3):
        truth[f"{sensor}registration_m.{'xyz'[axis]}"] = shift[axis]
        truth[f"{sensor}registration_deg.{'xyz'[axis]}"] = turn_deg[axis]
    factors = [np.log(float(lift["young_Pa"] / lift["young_sheet_Pa"])) for lift in files]
    return coverage.expected(truth, offsets, factors, clocks)


def compute(program, number, folder, args):
    truth = write_case(number, folder / "lifts", args.moving)
    out = folder / "out"
    command = [program, "calibrate", "-r", folder / "lifts", "-o", out, "--no-leave-out", "--threads", args.threads,
               "--tolerance-mm", args.tolerance_mm]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, (done.returncode, done.stderr)
    return coverage.counted(out, truth)


if __name__ == "__main__":
    coverage.run(compute, coverage.arguments(12, "0.6").parse_args())

#!/usr/bin/env python3
"""The clamped silicone beam of the set `silicone_beam` by `mismatch import` and `mismatch calibrate` alone: fitted to its markers under
its own weight, held out with 52 g at its tip. Prints the table of decision 0035 from what calibrate writes.

OMENTUM_REAL_DATA=... /usr/bin/python3 beam_calibration.py MISMATCH SCRATCH [--tolerance-mm 1]
"""
import argparse
import json
import os
import subprocess
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
LOAD = 0.052  # [kg] of the set, as the density
COUNTED = 5   # periods
RESTS = 0.5   # [s] at the end
SCENE = """format_version: 1
tissue {
  grid { count_x: 7 count_y: 22 pitch_m: 0.005 }
  density_kg_per_m3: 1070
  thickness_m: 0.03
  anchor_max_y_m: -0.0474
  model: TISSUE_REFERENCE
  material { young_modulus_pa: 2e5 poisson_ratio: 0.48 damping_per_s: 4 law: LAW_NEO_HOOKE }
  effects { added_mass { mass_kg: 0 y_m: 0.0495 radius_m: 0.003 } }
  reference { substeps: 8 }
}
tool { contact: false }
held_start { y_m: 0.0525 radius_m: 0.018 position_m { x: 0 y: 0.0525 z: 0 } }
"""
PRIORS = """prior { path: "scene.tissue.effects.bending_change" factor: 1.02 source: "a block of one material" }
prior { path: "scene.tissue.thickness_m" sd: 0.0003 source: "a mould" }
prior { path: "scene.tissue.material.poisson_ratio" sd: 0.005 source: "rubber" }
prior { path: "scene.depth_sensor.registration_m" sd: 0.005 source: "maps/silicone_beam.txtpb" }
prior { path: "scene.depth_sensor.registration_deg" sd: 2 source: "maps/silicone_beam.txtpb" }
"""
MARKERS = "name,on,x_m,y_m,z_m\n" + "".join(f"base{k},clamp,,,\n" for k in (1, 2, 3))


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    return done.stdout


def heights(table):
    """Time [s], height of the mean of the tip's markers [m] as seen and as simulated."""
    rows = np.genfromtxt(table, delimiter=",", names=True)
    mean = lambda what: np.mean([rows[f"tip{k}_{what}_z_m"] for k in (1, 2, 3)], axis=0)
    return rows["t_s"], mean("seen"), mean("simulated")


def rest(t, height):
    return height[t > t[-1] - RESTS].mean()


def crossings(t, height):
    """Upwards through rest, after it was let go."""
    h = height - rest(t, height)
    begin = np.flatnonzero(h < 0.5 * h[0])[0]
    t, h = t[begin:], h[begin:]
    return [a + (b - a) * p / (p - q) for a, b, p, q in zip(t, t[1:], h, h[1:]) if p < 0 <= q]


def frequency(t, height):
    """Of the first periods after the release [Hz]."""
    up = crossings(t, height)
    return COUNTED / (up[COUNTED] - up[0])


def decay(t, height):
    """Of the amplitude, from the highest place of each of these periods [1/s]."""
    h = height - rest(t, height)
    up = crossings(t, height)
    tops = [np.flatnonzero((t >= a) & (t < b))[h[(t >= a) & (t < b)].argmax()] for a, b in zip(up, up[1:])][:COUNTED]
    return -np.polyfit(t[tops], np.log(h[tops]), 1)[0]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--tolerance-mm", type=float, default=1)
    args = parser.parse_args()
    data = os.environ.get("OMENTUM_REAL_DATA")
    if not data or not (Path(data) / "silicone_beam").is_dir():
        raise SystemExit("OMENTUM_REAL_DATA: no set silicone_beam there: skipped")
    args.scratch.mkdir(parents=True)
    for file, text in (("beam.txtpb", SCENE), ("beam.prior.txtpb", PRIORS), ("markers.csv", MARKERS)):
        (args.scratch / file).write_text(text)
    run(args.program, "import", Path(data) / "silicone_beam", "--map", HERE / "maps" / "silicone_beam.txtpb", "-o", args.scratch / "in")
    print(run(args.program, "calibrate", "--scene", args.scratch / "beam.txtpb", "--markers", args.scratch / "markers.csv", "-r",
              args.scratch / "in", "-o", args.scratch / "out", "--tolerance-mm", args.tolerance_mm,
              "--set-for", f"beam_load52*:scene.tissue.effects.added_mass.mass_kg={LOAD}"), flush=True)
    for row in json.loads((args.scratch / "out" / "calibration.json").read_text())["fit"]:
        print(f"{row['recording']}, {row['role']}: markers {1e3 * row['rmse_model']:.2f} mm rms from where they are simulated")
    tables = {name: heights(args.scratch / "out" / "markers" / f"beam_{name}.csv")
              for name in ("gravity_V2_a", "gravity_V2_b", "load52_V2_a", "load52_V2_b")}
    for words, of in (("frequency [Hz]", frequency), ("decay [1/s]", decay)):
        for load in ("gravity", "load52"):
            pair = [tables[f"{load}_V2_{k}"] for k in "ab"]
            print(f"{load}: {words} simulated {of(pair[0][0], pair[0][2]):.3f} and {of(pair[1][0], pair[1][2]):.3f}, "
                  f"measured {of(*pair[0][:2]):.3f} and {of(*pair[1][:2]):.3f}")
    lower = {k: [1e3 * (rest(own[0], own[w]) - rest(loaded[0], loaded[w])) for w in (1, 2)]
             for k, own, loaded in (("a", tables["gravity_V2_a"], tables["load52_V2_a"]),
                                    ("b", tables["gravity_V2_b"], tables["load52_V2_b"]))}
    print(f"load52: tip lower at rest, simulated {lower['a'][1]:.2f} and {lower['b'][1]:.2f} mm, "
          f"measured {lower['a'][0]:.2f} and {lower['b'][0]:.2f}")
    fallen = [1e3 * (h[:5].mean() - rest(t, h)) for t, *both in tables.values() for h in both]
    print("from the hand to rest, measured and simulated [mm]: " + ", ".join(f"{x:.2f}" for x in fallen))


if __name__ == "__main__":
    main()

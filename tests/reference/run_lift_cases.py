"""Twelve small sheets with DOLFINx whose numbers are drawn from what their recordings say is believed of them, three
lifts each. What tests/mismatch/lift_cases.py makes recordings of, calibrates on and counts.

/usr/bin/python3 run_lift_cases.py [CASE ...] [--elements N] [--steps 1] [--out FOLDER]    FOLDER/case<N>/lift<K>.npz

The beliefs (one standard deviation): E 50 kPa to a factor of 2, Poisson's ratio 0.45 +- 0.03, thickness 3 mm to 5 %,
bending to 15 % beside what these do, friction 0.25 to a factor of 1.6, damping 5 /s to a factor of 3, E of each lift to 5 %.
Every law of dolfinx_solid.energy_density is as likely. Density is known. Files as those of run_lifts.py; --steps: of time
in one of theirs, --elements: along x and y instead of 10, of soft sheets 14, for the errors of both.
"""
import argparse
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from run_lifts import Lift, simulate

CASES = 12
SIDE, CLAMP, STEP = 0.03, -0.027, 0.05  # half of the sheet's [m], along y [m], [s]
PINCHES = [(-0.020, 0.025), (0.003, 0.0255), (0.0235, 0.009)]  # about where the jaws close, x_B, y_B [m]
AROUND, EDGE = 0.003, 0.001  # [m]: how far from there at most; how far from the rim at least
HEIGHTS = [(0, 0), (0.1, 0), (0.5, 0.01), (0.9, 0.01), (1.3, 0.02), (1.7, 0.02)]
MOST_POISSON = 0.489
SOFT = 25e3  # [Pa]: bends so closely at the jaws and where it leaves the board that it takes more elements


def draw(number):
    """The lifts of a case."""
    random = np.random.default_rng([43, number])
    factor = lambda of: math.exp(math.log(of) * random.normal())
    young = 50e3 * factor(2)
    poisson = 1.0
    while poisson > MOST_POISSON:
        poisson = random.normal(0.45, 0.03)
    sheet = Lift((), HEIGHTS, poisson=poisson, thickness=0.003 * factor(1.05), damping=5 * factor(3),
                 friction=0.25 * factor(1.6), skins=(factor(1.15) - 1) / 0.8,
                 law=str(random.choice(["neo_hooke", "st_venant_kirchhoff"])), side=SIDE, clamp=CLAMP, step=STEP)
    most = SIDE - EDGE
    return [replace(sheet, centre=tuple(np.clip(np.array(pinch) + random.uniform(-AROUND, AROUND, 2), -most, most)),
                    young=young * factor(1.05)) for pinch in PINCHES], young


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("cases", type=int, nargs="*", default=range(CASES))
    parser.add_argument("--elements", type=int)
    parser.add_argument("--steps", type=int, default=1)
    parser.add_argument("--lifts", type=int, nargs="+", default=range(len(PINCHES)))
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "results" / "lift_cases")
    args = parser.parse_args()
    for wanted in args.cases:
        lifts, young_mean = draw(wanted)
        elements = args.elements or (14 if young_mean < SOFT else 10)
        for k in args.lifts:
            file = args.out / f"case{wanted}" / f"lift{k}.npz"
            if not file.exists():
                simulate(replace(lifts[k], step=STEP / args.steps), elements, file, young_sheet_Pa=young_mean)

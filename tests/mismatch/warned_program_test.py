#!/usr/bin/env python3
"""What is wrong with a recording or a belief is said by `mismatch calibrate` in words that name it, and nothing of the kind is
said of what is right. Lifts of a small sheet; those of another engine: warned_calibrations.py.

usage: warned_program_test.py MISMATCH [CASE ...]

That a body is thinner than believed is told of lifts on a finer mesh alone: warned_calibrations.py.
"""
import json
import pathlib
import re
import sys
import tempfile

import small_lifts as small

YOUNG = "scene.tissue.material.young_modulus_pa"
PINCHES = (*small.PINCHES, (-0.0185, 0.007), (0.012, 0.0185))
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007), (0.0005, 0.0002), (-0.0003, -0.0006))
SIDE, REGISTRATION, THICKNESS = r"^recording lift{}: .*other side", r"^registration: .*register it again", r"^scene\.tissue\.thickness_m: alike"
SHIFT = {f"scene.depth_sensor.registration_m.{axis}": by for axis, by in zip("xyz", (0.006, -0.006, 0.0053))}
# What is otherwise than believed; recordings on the wrong side; warnings that must be there; that must not be.
CASES = {
    "as_told": ({}, (), [], [SIDE.format(r"\d"), REGISTRATION, THICKNESS]),
    "two_wrong_sides": ({}, (0, 2), [SIDE.format(0), SIDE.format(2)], [SIDE.format("[134]"), REGISTRATION, THICKNESS]),
    "registration_10_mm": (SHIFT, (), [REGISTRATION], [SIDE.format(r"\d")]),
}


def main():
    program = pathlib.Path(sys.argv[1])
    failed = []
    for name in sys.argv[2:] or CASES:
        other, mirrored, wanted, unwanted = CASES[name]
        with tempfile.TemporaryDirectory() as scratch:
            folder = pathlib.Path(scratch)
            small.write_case(program, folder, {YOUNG: 50e3, **other}, OFFSETS, seed=2, mesh=("--tolerance-mm", "1.5"),
                             pinches=PINCHES, mirrored=mirrored)
            small.calibrate(program, folder, folder / "out", ["--tolerance-mm", "6", "--no-leave-out", "--threads", "2"])
            found = json.loads((folder / "out" / "calibration.json").read_text())
        print(f"# {name}, {found['core_seconds']:.0f} core-seconds")
        for line in found["warnings"]:
            print(f"#   {line}")
        for n in found["parameters"]:
            print(f"#   {n['name']} {n['value']:.5g} ({n['low90']:.5g} - {n['high90']:.5g})", flush=True)
        failed += [(name, w) for w in wanted if not any(re.search(w, line) for line in found["warnings"])]
        failed += [(name, line) for line in found["warnings"] if any(re.search(w, line) for w in unwanted)]
    assert not failed, failed


if __name__ == "__main__":
    main()

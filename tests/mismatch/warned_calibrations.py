#!/usr/bin/env python3
"""What is wrong with a recording or a belief is said by `mismatch calibrate` in words that name it. Lifts of another engine
(lift_recordings.py), of which something is told wrongly.

/usr/bin/python3 warned_calibrations.py MISMATCH SCRATCH [CASE ...] [--threads 2] [--tolerance-mm 0.6]
"""
import argparse
import json
import re
import subprocess
import sys
from pathlib import Path

# Arguments of lift_recordings.py; warnings that must be there; that must not be.
SIDE, REGISTRATION, THICKNESS = r"recording lift{}: .*other side", r"^registration: .*register it again", r"^scene\.tissue\.thickness_m: "
CASES = {
    "as_told": ([], [], [SIDE.format(r"\d"), REGISTRATION, THICKNESS]),
    "two_wrong_sides": (["--wrong-side", "0", "3"], [SIDE.format(0), SIDE.format(3)],
                        [SIDE.format("[124]"), REGISTRATION, THICKNESS]),
    "registration_10_mm": (["--shift-mm", "6", "-6", "5.3"], [REGISTRATION], [SIDE.format(r"\d")]),
    "thinner_by_a_fifth": (["--believed-thickness-mm", "3.75"], [THICKNESS], [SIDE.format(r"\d"), REGISTRATION]),
}


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"of {', '.join(CASES)}; all where none is named")
    parser.add_argument("--threads", default="2")
    parser.add_argument("--tolerance-mm", default="0.6")
    args = parser.parse_args()
    failed = False
    for name in args.cases or CASES:
        options, wanted, unwanted = CASES[name]
        case, out = args.scratch / name, args.scratch / f"{name}_out"
        subprocess.run([sys.executable, Path(__file__).with_name("lift_recordings.py"), case, *options], check=True)
        command = [args.program, "calibrate", "-r", case, "-o", out, "--threads", args.threads, "--tolerance-mm",
                   args.tolerance_mm, "--no-leave-out"]
        subprocess.run([str(c) for c in command], check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        found = json.loads((out / "calibration.json").read_text())
        warnings = found["warnings"]
        missing = [w for w in wanted if not any(re.search(w, line) for line in warnings)]
        false = [line for line in warnings if any(re.search(w, line) for w in unwanted)]
        failed |= bool(missing or false)
        print(f"{name}: {'as it should be' if not missing and not false else 'NOT as it should be'}, "
              f"{found['core_seconds']:.0f} core-seconds")
        for line in warnings:
            print(f"  {line}")
        for n in found["parameters"]:
            print(f"  # {n['name']} {n['value']:.5g} ({n['low90']:.5g} - {n['high90']:.5g})", flush=True)
    return failed


if __name__ == "__main__":
    sys.exit(main())

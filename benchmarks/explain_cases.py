#!/usr/bin/env python3
"""Figures of `mismatch explain` on the stored cases of another engine: prints lines "name value unit  # remark".

/usr/bin/python3 explain_cases.py PROGRAM SCRATCH [--threads N]

Nine recordings of 4 s each are drawn from a stored truth (tests/mismatch/plants), one case in which nothing is concealed and
one with a stiff place; meshes are the default ones. A column is what one recording would do by one number: those of all candidates,
of all recordings but the first, over the seconds of that stage.
"""
import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

PLANTS = Path(__file__).parents[1] / "tests" / "mismatch" / "plants"
SIMULATED = ("obstacle", "grasp_slip", "jaw_orientation.roll@", "anchor_detachment.length@of")  # no columns


def explain(program, case, out, threads):
    """Verdict, seconds in all, seconds of the columns."""
    begin = time.monotonic()
    run = subprocess.Popen([program, "explain", "-r", case, "-o", out, "--threads", str(threads)], stdout=subprocess.DEVNULL,
                           stderr=subprocess.PIPE, text=True)
    columns = [None, None]
    for line in run.stderr:
        sys.stderr.write(line)
        if columns[0] is None and "columns of effects" in line:
            columns[0] = time.monotonic()
        elif columns[0] is not None and columns[1] is None and "columns of effects" not in line:
            columns[1] = time.monotonic()
    if run.wait() != 0:
        sys.exit(f"explain_cases.py: explain of {case} ended with {run.returncode}")
    seconds = time.monotonic() - begin
    return json.loads((out / "verdict.json").read_text()), seconds, columns[1] - columns[0]


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program")
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--threads", type=int, default=2)
    args = parser.parse_args()
    for truth, figure in (("null_101", "null_case_s"), ("inclusion_102", "case_s")):
        case, out = args.scratch / truth, args.scratch / f"{truth}_verdict"
        subprocess.run([sys.executable, PLANTS / "plants.py", "case", PLANTS / "truths" / truth, "--seed", "1", "--force", "no",
                        "-o", case], check=True, stdout=subprocess.DEVNULL)
        verdict, seconds, in_columns = explain(args.program, case, out, args.threads)
        print(f"explain.{figure} {seconds:.0f} s  # {verdict['status']}, {verdict['core_seconds']:.0f} core-seconds")
        if truth == "null_101":
            asked = [s for s in verdict["scores"] if not s["key"].startswith(SIMULATED)]
            columns = len(asked) * (len(verdict["recordings"]) - 1)
            print(f"explain.columns_per_s {columns / in_columns:.2f} 1/s  # {len(asked)} columns a recording")
        sys.stdout.flush()


if __name__ == "__main__":
    main()

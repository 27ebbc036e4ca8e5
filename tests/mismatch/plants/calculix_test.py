#!/usr/bin/python3
"""What the plant calculix records, on a few cells: nothing moves before the jaws close, the patch goes where the commands say,
an effect is seen, one of no size is not; where no rest is found it says when. Ends with 77 where ccx is missing."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

sys.dont_write_bytecode = True
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
try:
    import numpy as np
except ImportError:
    print("no numpy here")
    sys.exit(77)

import calculix_sheet
import calculix_truth
import fenics_truth
import protocol

if not calculix_sheet.program():
    print("no ccx here")
    sys.exit(77)

RECORDING, CELLS = 7, 3  # a low lift, then a pull to the side
UNTIL = 1.3  # [s] up, and pulled a little


def check(what, true):
    if not true:
        sys.exit(f"not so: {what}")


def case_of(effect, parameters=None, where=None):
    case = calculix_truth.draw_case(effect, 3)
    case["lift_m"] = [.5 * lift for lift in case["lift_m"]]
    if parameters is not None:
        case["parameters"], case["where"] = parameters, where or {}
    return case


def run(case):
    out = calculix_truth.run_recording(case, RECORDING, CELLS, until=UNTIL)
    return out, fenics_truth.decode(out)


def held(case, out):
    """Of the upper face's nodes, those in the jaws."""
    x, y = np.meshgrid(calculix_sheet.halves(out["xs"]), calculix_sheet.halves(out["ys"]), indexing="ij")
    return fenics_truth.within(np.stack([x, y], -1), fenics_truth.pad_place(case, RECORDING), np.array(case["base"]["pad_m"]) / 2)


def commands_are_followed(case, out, move):
    t, pad = out["frame_s"], held(case, out)
    check("jaws hold nodes at the corners of the patch, on its sides and in its middle", pad.sum() == 9)
    closed = t < protocol.CLOSED + 1e-9
    check("nothing moves before the jaws close", np.ptp(move[closed], axis=0).max() == 0)
    patch = move[:, 1][:, pad]
    way = patch - patch[closed][-1]
    check("the patch goes where the commands say", np.abs(way - fenics_truth.tip_path(case, RECORDING)(t).T[:, None]).max() < 3e-5)
    lift = .4 * case["lift_m"][RECORDING]
    check("the sheet is lifted, the clamp is not", move[..., 2].max() > .98 * lift and np.abs(move[:, :, :, 0]).max() < .1 * lift)
    check("the tissue pulls the tool down in the lift", out["force_N"][-1, 2] < -.003)
    check("a force for every frame", len(out["force_N"]) == len(out["frame_s"]) == len(move))


def effects_are_seen(null, move):
    middle = {"centre_m": [0, 0]}
    same, _ = run(case_of("inclusion", {"k": 1.0, "r": .01}, middle))
    check("an inclusion of no size changes nothing", all(np.array_equal(same[key], null[key]) for key in null))
    for effect, parameters, where in (("inclusion", {"k": 8.0, "r": .012}, middle), ("actuation_delay", {"tau": .1}, {})):
        _, other = run(case_of(effect, parameters, where))
        check(f"{effect} moves the surface in the lift", np.abs(other - move)[:, 1].max() > 2e-4)


def what_finds_no_rest_ends_with_the_time(folder):
    """A ccx that settles the sheet and then gives up 2 mm on the way."""
    lazy = pathlib.Path(folder) / "ccx"
    lazy.write_text(f"""#!/bin/bash
grep -q AMPLITUDE sheet.inp || exec {calculix_sheet.program()} "$@"
echo '  2   9   1   3  {1 + .002 / calculix_truth.REACH_M}  {.002 / calculix_truth.REACH_M}  0.1' > sheet.sta
echo ' *ERROR: increment size smaller than minimum'
exit 201
""")
    lazy.chmod(0o755)
    code = f"import sys; sys.path.insert(0, sys.argv[1]); import calculix_truth; calculix_truth.run_case('null', 3, sys.argv[2], {CELLS}, [{RECORDING}])"
    done = subprocess.run([sys.executable, "-B", "-c", code, HERE, lazy.parent / "truth"], capture_output=True, text=True, check=False,
                          env=dict(os.environ, PATH=f"{folder}:{os.environ['PATH']}"))
    check(f"it ends with 1 and says why: {done.stderr}", done.returncode == 1 and "increment size smaller" in done.stderr)
    told = [float(line.split("no rest after ")[1].split()[0]) for line in done.stdout.splitlines() if "no rest after" in line]
    check("it has tried shorter increments", len(told) == calculix_truth.HALVED + 1)
    gone = np.linalg.norm(fenics_truth.tip_path(calculix_truth.draw_case("null", 3), RECORDING)(told[0]))
    check(f"and says when: {told}, {gone}", abs(gone - .002) < 1e-4 and told[0] > told[1])
    check("and leaves no recording", os.listdir(lazy.parent / "truth") == ["truth.json"])


def a_case_says_what_it_is(out, case):
    with tempfile.TemporaryDirectory() as folder:
        truth = pathlib.Path(folder) / "truth"
        truth.mkdir()
        (truth / "truth.json").write_text(json.dumps(case))
        frames = fenics_truth.FRAME * np.arange(81)  # the last one stays to the end
        kept = np.minimum(np.arange(81), len(out["move"]) - 1)
        moved = np.rint(fenics_truth.decode(out)[kept] / fenics_truth.STEP_M).astype(int)
        longer = dict(out, move=fenics_truth.encode(moved), frame_s=frames, force_N=out["force_N"][kept], step_s=frames)
        np.savez_compressed(truth / f"r{RECORDING:02d}.npz", **longer)
        made = subprocess.run([sys.executable, "-B", HERE / "plants.py", "case", truth, "--seed", "2", "-o", f"{folder}/c0", "--labels",
                               f"{folder}/labels"], capture_output=True, text=True, check=False)
        check(f"a case is made: {made.stderr}", made.returncode == 0)
        label = json.loads((pathlib.Path(folder) / "labels" / "c0.json").read_text())
        check("its label names engine and law, and no effect", label["engine"] == "calculix" and label["effects"] == [] and
              label["base"]["law"] in ("neo-Hooke", "Mooney-Rivlin"))
        check("the case does not", not any("calculix" in path.read_text() for path in pathlib.Path(folder, "c0").rglob("*.txt*")))


def main():
    case = case_of("null")
    check("the other plant draws the same sheet", protocol.draw_case("null", 3)["pinches_m"] == case["pinches_m"])
    out, move = run(case)
    commands_are_followed(case, out, move)
    effects_are_seen(out, move)
    with tempfile.TemporaryDirectory() as folder:
        what_finds_no_rest_ends_with_the_time(folder)
    a_case_says_what_it_is(out, case)
    print("recordings are as they should be")


if __name__ == "__main__":
    main()

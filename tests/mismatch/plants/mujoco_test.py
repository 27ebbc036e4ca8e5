#!/usr/bin/python3
"""What the plant mujoco records, on a few cells: nothing moves before the jaws close, the patch goes where the commands
say, an effect of no size changes no byte. Ends with 77 where MuJoCo is missing."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.dont_write_bytecode = True
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
try:
    import mujoco  # noqa: F401
except ImportError:
    print("no MuJoCo here")
    sys.exit(77)

import numpy as np

import fenics_truth
import mujoco_sheet
import mujoco_truth
import protocol

RECORDING, CELLS, STEP = 5, 3, .0125  # the fast lift
UNTIL = 1.2  # [s] up and held


def check(what, true):
    if not true:
        sys.exit(f"not so: {what}")


def case_of(effect, parameters=None, where=None):
    case = mujoco_truth.draw_case(effect, 3)
    if parameters is not None:
        case["parameters"], case["where"] = parameters, where or {}
    return case


def run(case, until=protocol.DURATION):
    out = mujoco_truth.run_recording(case, RECORDING, CELLS, STEP, until=until)
    return out, fenics_truth.decode(out)


def held(case, out):
    """Of the upper face's nodes, those in the jaws."""
    x, y = np.meshgrid(mujoco_sheet.halves(out["xs"]), mujoco_sheet.halves(out["ys"]), indexing="ij")
    return fenics_truth.within(np.stack([x, y], -1), fenics_truth.pad_place(case, RECORDING), np.array(case["base"]["pad_m"]) / 2)


def commands_are_followed(case, out, move):
    t, pad = out["frame_s"], held(case, out)
    check("jaws hold nodes at the corners of the patch, on its sides and in its middle", pad.sum() == 9)
    closed = t < protocol.CLOSED + 1e-9
    check("nothing moves before the jaws close", np.ptp(move[closed], axis=0).max() == 0)
    patch = move[:, 1][:, pad]
    way = patch - patch[closed][-1]
    check("the patch goes where the commands say", np.abs(way - fenics_truth.tip_path(case, RECORDING)(t).T[:, None]).max() < 3e-5)
    lift = case["lift_m"][RECORDING]
    check("the sheet is lifted, the clamp is not", move[..., 2].max() > .98 * lift and np.abs(move[:, :, :, 0]).max() < .1 * lift)
    check("nothing goes through the board", move[:, 0, :, :, 2].min() > -3e-4)
    check("it lies still at the end", np.ptp(move[-4:], axis=0).max() < 5e-5 and np.abs(move[-1]).max() < 1e-3)
    check("the tissue pulls the tool down in the lift", out["force_N"][np.argmin(np.abs(out["step_s"] - 2)), 2] < -.02)
    check("a force for every step", len(out["force_N"]) == len(out["step_s"]) and abs(out["step_s"][-1] - protocol.DURATION) < 1e-9)


def effects_of_no_size_are_the_null(null):
    middle = {"centre_m": [0, 0]}
    for effect, parameters, where in (("inclusion", {"k": 1.0, "r": .01}, middle), ("tool_backlash", {"b": 0.0}, {})):
        out, _ = run(case_of(effect, parameters, where), UNTIL)
        check(f"{effect} of no size changes nothing", all(np.array_equal(out[key], null[key][:len(out[key])]) for key in null))


def middle_rises(out, move):
    """By how much the upper face's node nearest to the middle has risen, in the hold [m]."""
    i, j = (np.abs(mujoco_sheet.halves(v) - v[-1] / 2).argmin() for v in (out["xs"], out["ys"]))
    return move[int(round(UNTIL / fenics_truth.FRAME)), 1, i, j, 2]


def effects_are_seen(null, move):
    for effect, parameters, where in (("inclusion", {"k": 8.0, "r": .012}, {"centre_m": [0, 0]}), ("grasp_slip", None, None)):
        _, other = run(case_of(effect, parameters, where), UNTIL)
        check(f"{effect} moves the surface in the lift", np.abs(other[-1] - move[len(other) - 1])[1].max() > 2e-4)
    gap = .003
    under = middle_rises(*run(case_of("obstacle_above", {"radius": .01, "gap": gap}, {"centre_m": [0, 0]}), UNTIL))
    check("a ball above keeps the middle down", under < gap + 5e-4 and middle_rises(null, move) > under + .001)


def a_case_says_what_it_is(out, case):
    with tempfile.TemporaryDirectory() as folder:
        truth = pathlib.Path(folder) / "truth"
        truth.mkdir()
        (truth / "truth.json").write_text(json.dumps(case))
        np.savez_compressed(truth / f"r{RECORDING:02d}.npz", **out)
        made = subprocess.run([sys.executable, "-B", HERE / "plants.py", "case", truth, "--seed", "2", "-o", f"{folder}/c0", "--labels",
                               f"{folder}/labels"], capture_output=True, text=True, check=False)
        check(f"a case is made: {made.stderr}", made.returncode == 0)
        label = json.loads((pathlib.Path(folder) / "labels" / "c0.json").read_text())
        check("its label names engine and law, and no effect", label["engine"] == "mujoco" and label["effects"] == [] and
              label["base"]["law"] == "corotated")
        check("the case does not", not any("mujoco" in path.read_text() for path in pathlib.Path(folder, "c0").rglob("*.txt*")))


def main():
    case = case_of("null")
    check("the other plant draws the same sheet", protocol.draw_case("null", 3)["pinches_m"] == case["pinches_m"])
    out, move = run(case)
    commands_are_followed(case, out, move)
    effects_of_no_size_are_the_null(out)
    effects_are_seen(out, move)
    a_case_says_what_it_is(out, case)
    print("recordings are as they should be")


if __name__ == "__main__":
    main()

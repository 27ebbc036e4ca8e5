#!/usr/bin/python3
"""What the plant own records, on a coarse mesh of the program: nothing moves before the jaws close, the patch goes where the
commands say and turns as the other plants turn it, faces lie where they have to. Argument: the program mismatch."""
import os
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
try:
    import numpy as np
except ImportError:
    print("no numpy here")
    sys.exit(77)

import case_folder
import fenics_truth
import own_truth
import protocol

RECORDING, MESH = 7, "tolerance_m: 5e-3"


def check(what, true):
    if not true:
        sys.exit(f"not so: {what}")


def run(effect, parameters=None):
    case = own_truth.draw_case(effect, 3)
    case["parameters"].update(parameters or {})
    out = own_truth.run_recording(case, RECORDING, MESH, 20)
    rest = case_folder.nodes_of(out, case["base"])
    move = fenics_truth.decode(out)
    inside = fenics_truth.within(rest[1], fenics_truth.pad_place(case, RECORDING), np.array(case["base"]["pad_m"]) / 2 - 1e-3)
    return case, out, rest + move, move, inside


def commands_are_followed(case, out, move, inside):
    t = out["frame_s"]
    closed = t < protocol.CLOSED + 1e-9
    check("nothing moves before the jaws close", np.ptp(move[closed], axis=0).max() < 5e-5)
    patch = move[:, 1][:, inside]
    way = patch - patch[closed][-1]
    # The program takes a step of 50 ms as straight.
    check("the patch goes where the commands say", np.abs(way - fenics_truth.tip_path(case, RECORDING)(t).T[:, None]).max() < 3e-4)
    check("the clamp stays", np.abs(move[:, :, :, 0]).max() < 5e-5)
    check("nothing goes through the board", move[:, 0, :, :, 2].min() > -3e-4)
    check("faces are as far apart as the sheet is thick", np.abs(move[0, 1] - move[0, 0]).max() < 5e-5)
    check("the tissue pulls the tool down in the lift", out["force_N"][np.argmin(np.abs(out["step_s"] - 1.25)), 2] < -.01)


def jaws_turn_as_those_of_the_other_plants():
    case, out, at, move, inside = run("jaw_orientation", {"roll": np.radians(25)})
    frame = int(np.argmin(np.abs(out["frame_s"] - 1.25)))
    before, after = at[0, 1][inside], at[frame, 1][inside]
    turned = fenics_truth.rotation(case["shaft"], np.radians(25))
    expected = (before - before.mean(0)) @ turned.T
    off = np.abs(after - after.mean(0) - expected).max()
    check(f"a patch is turned by its angle about the shaft, off by {1e3 * off:.2f} mm of {1e3 * np.abs(expected).max():.2f}", off < 3e-4)


def main():
    os.environ["OMENTUM_MISMATCH"] = sys.argv[1]
    case, out, at, move, inside = run("null")
    check("some nodes are in the jaws", inside.sum() >= 4)
    commands_are_followed(case, out, move, inside)
    jaws_turn_as_those_of_the_other_plants()
    _, _, _, other, _ = run("inclusion")
    check("an inclusion moves the surface in the lift", np.abs(other - move)[:, 1].max() > 2e-4)
    print("recordings are as they should be")


if __name__ == "__main__":
    main()

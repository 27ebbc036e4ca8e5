#!/usr/bin/env python3
"""Jaws that hardly resist a turn and are turned at once leave the sheet as if they were not turned. A lift off a board.

usage: turning_jaws_program_test.py MISMATCH
"""
import pathlib
import sys
import tempfile

import numpy as np

from simulate_program import SCENE, markers, run, write_lift


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "scene.txtpb").write_text(SCENE)
        write_lift(folder / "commands", 0.02, start=(0, 0, 0.0015), rate=100)

        def surfaces(out, compliance, turn):
            effects = [f"scene.tissue.effects.grasp_turn_rad_per_n_m={compliance}", f"scene.tissue.effects.jaw_tilt_deg={turn}"]
            run(program, folder, out, ["--rate", "100"] + [word for text in effects for word in ("--set", text)])
            return markers(folder / out)[1]

        level = surfaces("level", 30000, 0)
        free, rigid = (1e3 * np.linalg.norm(surfaces(f"turned{compliance}", compliance, 10) - level, axis=2).max()
                       for compliance in (30000, 0))
        print(f"# turned by 10 deg: {free:.4f} mm from jaws that were not with free ones, {rigid:.4f} mm with rigid ones")
        assert free < 0.05 * rigid, (free, rigid)


main()

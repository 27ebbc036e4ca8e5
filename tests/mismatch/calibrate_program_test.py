#!/usr/bin/env python3
"""`mismatch calibrate` on three small lifts of `mismatch simulate`: the stiffness is inside its interval, and the learner takes
the calibrated scene. That threads and order change no byte calibration_bytes_test.py asks.

usage: calibrate_program_test.py MISMATCH LEARNER
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import small_lifts as small

YOUNG, FRICTION = "scene.tissue.material.young_modulus_pa", "scene.tissue.effects.friction_change"
TRUTH = {YOUNG: 42e3, FRICTION: 0.2, "scene.depth_sensor.registration_m.z": 0.0015,
         "scene.depth_sensor.registration_m.x": -0.001}
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007))
MESH = ("--tolerance-mm", "6")


def check_numbers(found):
    young = small.number(found, YOUNG)
    print(f"# E {young['value'] / 1e3:.2f} kPa ({young['low90'] / 1e3:.2f} - {young['high90'] / 1e3:.2f}), true "
          f"{TRUTH[YOUNG] / 1e3:g}, believed {young['prior']['value'] / 1e3:g}")
    assert young["low90"] < TRUTH[YOUNG] < young["high90"], young
    assert young["high90"] / young["low90"] < 0.2 * young["prior"]["high90"] / young["prior"]["low90"], young
    for axis in "xyz":
        shift = TRUTH.get(f"scene.depth_sensor.registration_m.{axis}", 0)
        assert small.is_inside(found, f"registration.{axis}", shift), small.number(found, f"registration.{axis}")
    for row in found["fit"]:
        assert row["rmse_model"] < row["rmse_base"] and row["rmse_model"] < 1.3 * small.NOISE, row
    assert sorted(r["recording"] for r in found["fit"] if r["role"] == "left_out") == ["lift0", "lift1", "lift2"]


def main():
    program, learner = (pathlib.Path(a) for a in sys.argv[1:])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        small.write_case(program, folder, TRUTH, OFFSETS, seed=1, mesh=("--tolerance-mm", "1.5"))
        small.calibrate(program, folder, folder / "one", [*MESH, "--threads", 2])
        check_numbers(json.loads((folder / "one" / "calibration.json").read_text()))
        page = (folder / "one" / "report.html").read_text()
        assert all(f"lift{k}" in page for k in range(3)) and not re.search(r"(src|href)=\"https?://", page)
        for words in ("scene.tissue.material.young_modulus (stiffness)", "numerics.mesh, the error of the mesh", "lift0: pinch.x, the place of the pinch along x"):
            assert f"<td>{words}</td>" in page, words
        scene = folder / "one" / "scene.txtpb"
        done = subprocess.run([learner, "--preset", "omentum_elastic", "--set", f"scene_file={scene}", "--dry-run"],
                              capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert "is not checked" not in done.stderr, done.stderr


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""`mismatch predict` on a made-up verdict: what two scenes foretell of commands is what `mismatch simulate` makes of them, moved
as the camera is off and as late as its clock; clouds are not looked at, and each recording has a line that says what of its
commands lies beyond those that were fitted.

usage: predict_program_test.py MISMATCH
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np

import explained_lifts as lifts
import small_lifts as small

SHIFT, LATE = 0.001, 0.03  # [m] along z, [s]
CAMERA = f"depth_sensor {{ registration_m {{ z: {SHIFT} }} time_offset_s: {LATE} }}\n"
SCENE = lifts.BELIEVED.replace("tissue {", "tissue { reference { friction_slip_speed_m_per_s: 1e-3 }", 1) + CAMERA
SOFT = "scene.tissue.material.young_modulus_pa=30000"
VISITED = [{"name": "lift", "unit": "m", "low": 0, "high": 0.014}, {"name": "sideways", "unit": "m", "low": 0, "high": 0.003},
           {"name": "speed", "unit": "m/s", "low": 0, "high": 0.026}, {"name": "hold", "unit": "s", "low": 0, "high": 1.46},
           {"name": "pinch_x", "unit": "m", "low": -0.0155, "high": 0.0165}, {"name": "pinch_y", "unit": "m", "low": 0.006, "high": 0.019}]
TOLERANCE = 3  # [mm]


def run(*command, code=0):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == code, (command, done.returncode, done.stderr)
    return done.stdout if code == 0 else done.stderr


def write_case(folder):
    out = folder / "out"
    out.mkdir()
    verdict = {"format_version": 1, "status": "explained", "effects": [{"class": {"members": [{"name": "inclusion"}]}}], "visited": VISITED}
    (out / "verdict.json").write_text(json.dumps(verdict))
    (out / "scene.base.txtpb").write_text(SCENE)
    (out / "scene.repaired.txtpb").write_text(SCENE.replace("young_modulus_pa: 60000", "young_modulus_pa: 30000"))
    for name, factor, clouds in (("known", 1.0, True), ("high", 1.5, False)):
        recording = folder / "commands" / name
        (recording / "clouds").mkdir(parents=True)
        head, *rows = small.tool_rows(lifts.PINCHES[1], (0, 0)).splitlines()
        cells = [row.split(",") for row in rows]
        for row in cells:
            row[3] = repr(0.0015 + factor * (float(row[3]) - 0.0015))
        (recording / "tool.csv").write_text("\n".join([head, *(",".join(row) for row in cells)]) + "\n")
        (recording / "recording.txtpb").write_text(f'name: "{name}"\ntool_rate_hz: 50\ntip_point: jaw_tip\n')
        if clouds:
            (recording / "clouds.csv").write_text("t_s,file\n0.21,clouds/a.ply\n1.4,clouds/b.ply\n")
            for file in ("a", "b"):
                (recording / "clouds" / f"{file}.ply").write_text("no cloud: it is not looked at\n")


def simulated(program, folder, mesh, more, times):
    """Upper faces of the recording "known" at these times, as the camera has them."""
    scene = folder / "out" / "scene.base.txtpb"
    out = folder / f"simulated{len(more)}"
    sets = [w for axis, count in zip("xyz", mesh) for w in ("--set", f"scene.tissue.reference.elements_{axis}={count}")]
    run(program, "simulate", "--scene", scene, "--model", "reference", "--commands", folder / "commands" / "known", "-o", out,
        "--cloud-rate", 0, *sets, *more)
    rows = np.loadtxt(out / "markers.csv", delimiter=",", skiprows=1)
    faces = rows[:, 1:].reshape(len(rows), 2, 16, 16, 3)[:, 0]
    at = (np.array(times) - LATE) / 0.02
    step = at.astype(int)
    share = (at - step)[:, None, None, None]
    return (1 - share) * faces[step] + share * faces[step + 1] + np.array((0, 0, SHIFT))


def mesh_of(program, folder):
    """What a mesh of this tolerance has, enough for both recordings."""
    said = run(program, "simulate", "--scene", folder / "out" / "scene.base.txtpb", "--model", "reference", "--tolerance-mm", TOLERANCE,
               "--set", "scene.tissue.material.law=LAW_COROTATED", "--commands", *sorted((folder / "commands").iterdir()), "-o",
               folder / "meshes", "--cloud-rate", 0)
    return np.array([m for m in re.findall(r"mesh (\d+) x (\d+) x (\d+)", said)], int).max(0)


def main():
    program = pathlib.Path(sys.argv[1])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        write_case(folder)
        command = (program, "predict", folder / "out", "-r", folder / "commands", "--tolerance-mm", TOLERANCE)
        lines = run(*command, "-o", folder / "new").splitlines()
        assert lines[1] == "known: 2 frames, within what was fitted", lines
        assert re.fullmatch(r"high: 3\d frames, extrapolated: lift 21.0 mm, up to 14.0 mm were fitted \(7.0 mm beyond\); "
                            r"speed 3\d.\d mm/s, up to 26.0 mm/s were fitted \(9.\d mm/s beyond\)", lines[0]), lines
        with np.load(folder / "new" / "predictions" / "known.npz") as file:
            assert np.allclose(file["t_s"], (0.21, 1.4)) and file["uv_B"].shape == (16, 16, 2), file["t_s"]
            mesh = mesh_of(program, folder)
            for what, more in (("base", ()), ("model", ("--set", SOFT))):
                off = np.abs(file[what] - simulated(program, folder, mesh, more, file["t_s"])).max()
                print(f"# {what}: {1e6 * off:.2f} um")
                assert off < 5e-6, (what, off)
            assert np.abs(file["model"] - file["base"])[1].max() > 1e-4
        with np.load(folder / "new" / "predictions" / "high.npz") as file:
            assert np.allclose(np.diff(file["t_s"]), 0.05), file["t_s"]

        told = run(*command, "-o", folder / "new", code=2)
        assert told.count("\n") == 1 and "is not empty" in told, told
        (folder / "out" / "scene.base.txtpb").unlink()
        told = run(*command, "-o", folder / "none", code=2)
        assert told.count("\n") == 1 and "scene.base.txtpb" in told and not (folder / "none").exists(), told


if __name__ == "__main__":
    main()

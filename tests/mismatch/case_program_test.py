#!/usr/bin/env python3
"""A case folder as others write it, without an edit: recordings with the believed scene of the case above them are
imported, told of, made a scene and simulated.

usage: case_program_test.py MISMATCH
"""
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

from simulate_program import write_lift

BELIEVED = """# what the operator believes
sheet_size_x_m: 0.045
sheet_size_y_m: 0.045
sheet_thickness_m: 0.003
young_modulus_nominal_Pa: 60000
young_modulus_uncertainty_factor: 3
poisson_ratio_nominal: 0.45
density_nominal_kg_per_m3: 1050
material: soft silicone
sheet_origin_x_m: 0.0225
sheet_origin_y_m: -0.0225
sheet_origin_z_m: 0
sheet_axis_x_in_W: 0 1 0
sheet_axis_y_in_W: -1 0 0
clamped_edge: sheet x from 0 to 0.003 m
clamp_strip_width_m: 0.003
board_plane_normal: 0 0 1
board_plane_z_m: 0
board_friction_nominal: 0.3
gravity_m_per_s2: 0 0 -9.81
gripper_patch_x_m: 0.006
gripper_patch_y_m: 0.006
tip_reference: centre of the gripped patch, mid thickness
pinch_point_0_sheet_m: 0.0405 0.0045
camera_position_W_m: 0 0.1 0.25
camera_view_direction_W: 0 -0.35 -0.94
camera_registration_uncertainty: up to 2 mm, 1 deg
sensor_noise_class: depth 0.5-1.5 mm sigma at 0.35 m growing with range squared
sensor_depth_step_m: 0.00025
clock_offset_uncertainty_s: 0.02
cloud_content: visible top surface of the sheet only
force_sensor: at the tool tip
shaft_direction_W: -0.008 0.273 0.962
"""
COARSE = ("--set", "scene.tissue.reference.elements_x=8", "--set", "scene.tissue.reference.elements_y=8", "--set", "scene.tissue.reference.elements_z=1")
UNUSED = ("material", "clamped_edge", "tip_reference", "cloud_content", "force_sensor")


def run(*command, code=0):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == code, (command, done.returncode, done.stderr)
    return done.stdout, done.stderr


def write_case(case):
    for name, more in (("r00", 'repeat_of: "r00"\n'), ("r01", 'repeat_of: "r00"\nheld_out: true\n')):
        write_lift(case / name, 0.012)
        (case / name / "recording.txtpb").write_text(
            f'name: "{name}"\nscene: "scene_believed.txt"\nframe: "W"\nunits: "m, s, N, rad"\ntip_point: jaw_tip\n'
            f'tool_rate_hz: 50\ncloud_rate_hz: 2\n{more}')
        (case / name / "clouds").mkdir()
        x, y = np.meshgrid(np.linspace(-0.02, 0.02, 9), np.linspace(-0.015, 0.02, 9))
        points = "".join(f"{a:.4f} {b:.4f} 0.003\n" for a, b in zip(x.ravel(), y.ravel()))
        head = f"ply\nformat ascii 1.0\nelement vertex {x.size}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
        for k in range(2):
            (case / name / "clouds" / f"{k}.ply").write_text(head + points)
        (case / name / "clouds.csv").write_text("t_s,file\n0,clouds/0.ply\n0.5,clouds/1.ply\n")
    (case / "scene_believed.txt").write_text(BELIEVED)


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        case = folder / "case"
        case.mkdir()
        write_case(case)

        _, told = run(program, "import", case, "-o", folder / "recordings")
        for key in UNUSED:
            assert told.count(f": {key}: ") == 1, (key, told)
        files = sorted((folder / "recordings").iterdir())
        assert [f.name for f in files] == ["r00.mcap", "r01.mcap"], files

        out, _ = run(program, "info", *files)
        assert out.count("repeat of: r00") == 1 and out.count("repeats of r00:") == 1, out
        assert out.count("held out: yes") == 1, out
        of_files = out
        out, _ = run(program, "info", case)
        for file in files:
            of_files = of_files.replace(str(file), str(case / file.stem))
        assert out == of_files, (out, of_files)
        _, told = run(program, "info", case, "--contact-sheet", folder / "sheet.png", code=2)
        assert "allowed one" in told and not (folder / "sheet.png").exists(), told
        run(program, "info", case / "r00", "--contact-sheet", folder / "sheet.png")
        assert (folder / "sheet.png").read_bytes().startswith(b"\x89PNG")
        for once in ([files[0]], [files[0], files[0]], [case / "r00", case / "r00"]):
            out, _ = run(program, "info", *once)
            assert "repeat" not in out, out

        _, told = run(program, "scene", case / "scene_believed.txt", "-o", folder / "scene.txtpb")
        for key in UNUSED:
            assert told.count(f": {key}: ") == 1, (key, told)
        scene = (folder / "scene.txtpb").read_text()
        for part in ("hold: HOLD_PAD", "half_x_m: 0.003", "shaft_direction", "gravity_m_per_s2: 9.81", "noise_m: 0.0015"):
            assert part in scene, (part, scene)
        assert "gravity_tilt" not in scene, scene
        priors = (folder / "scene.prior.txtpb").read_text()
        for path in ("young_modulus_pa", "registration_m", "registration_deg", "time_offset_s"):
            assert path in priors, (path, priors)

        run(program, "simulate", "--scene", folder / "scene.txtpb", "--model", "reference", *COARSE, "--commands", *files, "-o",
            folder / "simulated", "--cloud-rate", "2")
        assert (folder / "simulated" / "r01" / "clouds.csv").is_file()

        # Bad input: one line with its place, and nothing is half imported.
        bad = BELIEVED.replace("0 0 -9.81", "0 -9.81")
        line = BELIEVED.splitlines().index("gravity_m_per_s2: 0 0 -9.81") + 1
        (case / "scene_believed.txt").write_text(bad)
        for command in (("import", case, "-o", folder / "none"),
                        ("scene", case / "scene_believed.txt", "-o", folder / "none.txtpb")):
            _, told = run(program, *command, code=2)
            wanted = f"{case}/scene_believed.txt:{line}: gravity_m_per_s2: 2 numbers, needed 1 or 3\n"
            assert told == f"mismatch: {wanted}", told
        (case / "scene_believed.txt").unlink()
        _, told = run(program, "import", case, "-o", folder / "none", code=2)
        assert "r00/recording.txtpb:2:1: scene: scene_believed.txt is neither in" in told, told
        assert told.count("\n") == 1, told
        left = [p.name for p in folder.iterdir() if p.name.startswith("none")]
        assert not left, left
    print("a case goes in")


if __name__ == "__main__":
    main()

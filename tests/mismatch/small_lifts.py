"""Lifts of a small sheet by `mismatch simulate`, as a robot and a depth camera would have recorded them: recordings of
docs/formats.md 3 and the scene that is believed. Where the jaws closed is a little beside what the recording says.
"""
import math
import shutil
import subprocess

import numpy as np

from simulate_program import SCENE

CAMERA = """camera { position_m { y: 0.17 z: 0.18 } axis { y: -0.687 z: -0.727 } up { y: -0.727 z: 0.687 }
  vertical_fov_deg: 20 exposure_fov_deg: 7 exposure_pixels: 64 }
"""
BELIEVED = "".join(CAMERA if line.startswith("camera") else line for line in SCENE.splitlines(keepends=True)
                   if not line.startswith("  reference"))
PINCHES = ((-0.0155, 0.0185), (0.0015, 0.019), (0.0165, 0.0125))  # x, y of the jaws [m]
HEIGHTS = ((0, 0), (0.1, 0), (0.4, 0.007), (0.8, 0.007), (1.1, 0.014), (1.5, 0.014))  # [s], [m]
HOLDS = (0.8, 1.5)  # [s]
NOISE = 1e-3  # [m] along the ray
THICKNESS = 0.003  # [m] believed
# Of the true sheet, which always comes to rest with it: friction is smooth below 0.1 mm/s.
SMOOTH = "scene.tissue.reference.friction_slip_speed_m_per_s=1e-4"
PRIORS = ("scene.tissue.material.young_modulus_pa", "factor", 3), \
         ("scene.depth_sensor.registration_m", "sd", 0.002), ("scene.depth_sensor.registration_deg", "sd", 0.7)


def tool_rows(pinch, offset):
    rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
    knots = np.array(HEIGHTS)
    for k in range(round(knots[-1, 0] / 0.02) + 3):
        t = 0.02 * k
        height = np.interp(t, knots[:, 0], knots[:, 1])
        tip = (pinch[0] + offset[0], pinch[1] + offset[1] - 0.2 * height, THICKNESS / 2 + height)
        rows.append(",".join(f"{x:.9g}" for x in (t, *tip, 0.4 if t < 0.079 else 0)))
    return "\n".join(rows) + "\n"


def truth_overrides(truth):
    """Of a scene whose sheet lies on the same board."""
    overrides = [f"{path}={value:.12g}" for path, value in truth.items()]
    thickness = truth.get("scene.tissue.thickness_m", THICKNESS)
    return overrides + [SMOOTH, f"scene.tissue.pose.translation_m.z={thickness / 2:.12g}"]


def write_case(program, folder, truth, offsets, seed, times=None, factors=None, mesh=(), pinches=PINCHES, mirrored=(),
               keep=False, cloud_rate=10):
    """Recordings folder/lifts/lift0 ..., the scene folder/believed.txtpb and its priors. `truth`: numbers of the true scene
    by path; `offsets`: where the jaws closed against what is recorded, m; `factors`: on E, of every recording; `mirrored`: numbers of
    recordings whose tool.csv has x on the wrong side; `times` [s]: of the clouds kept, of every recording, else the ends of the
    holds; `keep` leaves what was simulated in folder/true."""
    scratch = folder / "true"
    scratch.mkdir(parents=True)
    (scratch / "scene.txtpb").write_text(BELIEVED + f"depth_sensor {{ width_px: 60 height_px: 48 noise_m: {NOISE} }}\n")
    (folder / "believed.txtpb").write_text(BELIEVED)
    (folder / "believed.prior.txtpb").write_text(
        "".join(f'prior {{ path: "{path}" {kind}: {value} source: "test" }}\n' for path, kind, value in PRIORS))
    young = "scene.tissue.material.young_modulus_pa"
    for k, (pinch, offset) in enumerate(zip(pinches, offsets)):
        commands = scratch / f"commands{k}"
        commands.mkdir()
        (commands / "tool.csv").write_text(tool_rows(pinch, offset))
        here = dict(truth)
        if factors is not None:
            here[young] = here[young] * factors[k]
        sets = [word for override in truth_overrides(here) for word in ("--set", override)]
        command = [program, "simulate", "--scene", scratch / "scene.txtpb", "--commands", commands, "-o", scratch / f"lift{k}",
                   "--cloud-rate", cloud_rate, "--seed", 100 * seed + k, *mesh, *sets]
        done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told = (-pinch[0], pinch[1]) if k in mirrored else pinch
        write_recording(scratch / f"lift{k}", folder / "lifts" / f"lift{k}", tool_rows(told, (0, 0)),
                        times[k] if times else HOLDS)
    if not keep:
        shutil.rmtree(scratch)


def write_recording(simulated, folder, tool, times):
    """What a robot knows and a camera saw of a simulated lift, and nothing else."""
    (folder / "clouds").mkdir(parents=True)
    (folder / "tool.csv").write_text(tool)
    header, *rows = (simulated / "clouds.csv").read_text().splitlines()
    kept = [row for row in rows if min(abs(float(row.split(",")[0]) - t) for t in times) < 1e-6]
    assert len(kept) == len(times), (rows, times)
    for row in kept:
        shutil.copy(simulated / row.split(",")[1], folder / "clouds")
    (folder / "clouds.csv").write_text("\n".join([header, *kept]) + "\n")
    (folder / "recording.txtpb").write_text(
        f'name: "{folder.name}"\ntool_rate_hz: 50\ncloud_rate_hz: 10\ntip_point: jaw_tip\nclock_offset_uncertainty_s: 0.05\n')


def calibrate(program, folder, out, more, recordings=None):
    """Lines of warnings."""
    command = [program, "calibrate", "--scene", folder / "believed.txtpb", "-o", out, "-r",
               *(recordings or [folder / "lifts"]), *more]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, (done.returncode, done.stderr)
    return done.stdout, done.stderr


def number(found, name):
    """The parameter or nuisance of that name."""
    return next(n for n in found["parameters"] + found["nuisances"] if n["name"] == name)


def is_inside(found, name, value):
    n = number(found, name)
    return n["low90"] <= value <= n["high90"] or math.isclose(n["value"], value)

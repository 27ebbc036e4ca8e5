"""A small sheet on a board for tests of `mismatch simulate`, and the program run on it."""
import subprocess

import numpy as np

SCENE = """format_version: 1
name: "sheet on a board"
gravity_m_per_s2: 9.80665
tissue {
  pose { translation_m { z: 0.0015 } }
  grid { count_x: 16 count_y: 16 pitch_m: 0.003 }
  density_kg_per_m3: 1000
  thickness_m: 0.003
  anchor_max_y_m: -0.0195
  static_friction: 0.3
  dynamic_friction: 0.3
  model: TISSUE_REFERENCE
  material { young_modulus_pa: 60000 poisson_ratio: 0.45 damping_per_s: 5 law: LAW_NEO_HOOKE }
  reference { elements_x: 8 elements_y: 8 elements_z: 1 friction_slip_speed_m_per_s: 1e-3 newton_tolerance: 1e-9 }
}
tool { base { translation_m { x: 0.1427 y: 0 z: 0.1584 } } roll_deg: 30 tip_offset_m: 0.0102 contact: false }
camera { position_m { z: 0.25 } axis { z: -1 } up { y: 1 } vertical_fov_deg: 60 exposure_fov_deg: 7 exposure_pixels: 64 }
rigid_body { name: "board" role: ROLE_BOARD half_space: true }
rigid_body { name: "tumour" role: ROLE_TUMOUR pose { translation_m { x: 0.05 y: 0.05 z: 0.006 } } sphere_radius_m: 0.005 }
workspace_min_m { x: -0.1 y: -0.1 z: 0.0005 }
workspace_max_m { x: 0.1 y: 0.1 z: 0.12 }
tool_start_m { x: 0 y: 0 z: 0.1 }
target_m { x: 0 y: 0 z: 0.1 }
tumour_point_m { x: 0.05 y: 0.05 z: 0.011 }
start_grid { rows: 1 columns: 1 centre_m { x: 0 y: 0 z: 0.1 } }
robot_grid { rows: 1 columns: 1 centre_m { x: 0 y: 0 z: 0.1 } }
"""


def run(program, folder, out, more, code=0, commands=("commands",)):
    command = [program, "simulate", "--scene", folder / "scene.txtpb", "--commands", *[folder / c for c in commands],
               "-o", folder / out, "--cloud-rate", "10", *more]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == code, (more, done.returncode, done.stderr)
    return done.stderr


def markers(folder, count=256):
    rows = np.loadtxt(folder / "markers.csv", delimiter=",", skiprows=1)
    return rows[:, 0], rows[:, 1:].reshape(len(rows), -1, 3)[:, :count]  # of the upper face


def write_lift(folder, height, jump=0.0, start=(0.018, 0.018, 0.0015), rate=50):
    """A smooth lift: a kink of the path has no derivative by a delay. From 0.4 s on the tip is `jump` aside."""
    rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
    for k in range(round(0.8 * rate) + 1):
        t = k / rate
        u = min(max((t - 0.08) / 0.6, 0), 1)
        s = u**3 * (10 - 15 * u + 6 * u * u)
        tip = np.array(start) + s * np.array((-0.003, -0.006, height)) + (t > 0.399) * np.array((jump, 0, 0))
        rows.append(",".join(f"{x:.9g}" for x in (t, *tip, 0.4 if t < 0.079 else 0)))
    folder.mkdir()
    (folder / "tool.csv").write_text("\n".join(rows) + "\n")

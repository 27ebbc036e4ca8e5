"""Runs the recordings of a case by the installed program `mismatch simulate` ($OMENTUM_MISMATCH, else that of the path), which is
asked as anybody asks it: a scene with the effect switched on, commands, surfaces back; stored as fenics_truth.py says.

Scene coordinates: the sheet's centre at rest is (0, 0, half its thickness), x across, y away from the clamp, z up."""
import os
import shutil
import subprocess
import tempfile

import numpy as np

import fenics_truth as common
import protocol
from protocol import DURATION

PITCH = 0.001  # [m] of the places whose motion the program writes; sheets are whole millimetres wide and long
CELLS = 10  # along each side of the truth that is stored; the program's mesh is its own
MESH = "tolerance_m: 1e-3"  # of the program, which makes it by itself


def program():
    found = shutil.which(os.environ.get("OMENTUM_MISMATCH", "mismatch"))
    return found and os.path.abspath(found)


def draw_case(effect, seed):
    case = protocol.draw_case(effect, seed, "own")
    case["base"].update(law="neo-Hooke", rate_time_s=0.0)
    if effect == "adhesion":  # a spring up to half of `break_m`, then falling to nothing; the same work
        p = case["parameters"]
        reach = 3 * p["d0"]
        case["parameters"] = {"G": p["G"], "k": 4 * p["G"] / reach**2, "break": reach}
    return case


def effects_of(case, recording):
    """-> texts of scene.tissue.effects and scene.arm."""
    b, effect, p = case["base"], case["effect"], case["parameters"]
    x, y = case["where"].get("centre_m", [0, 0])
    pinch = np.array(case["pinches_m"][protocol.RECORDINGS[recording][0]]) + case["jitter_m"][recording]
    if effect in ("inclusion", "soft_spot"):
        return f"inclusion {{ x_m: {x} y_m: {y} radius_m: {p['r']} stiffness_change: {p['k'] - 1} }}", ""
    if effect == "anisotropy":
        return f"anisotropy {{ fibre_ratio: {p['Ef_over_E']} angle_deg: {np.degrees(p['angle'])} }}", ""
    if effect.startswith("obstacle"):
        z = p["protrusion"] - p["radius"] if effect == "obstacle_below" else b["thickness_m"] + p["gap"] + p["radius"]
        return f"obstacle {{ x_m: {x} y_m: {y} z_m: {z} radius_m: {p['radius']} }}", ""
    if effect == "anchor_detachment":
        start, end = case["where"]["edge_interval_m"]
        return f"anchor {{ free_from_m: {start} free_to_m: {end} }}", ""
    if effect == "anchor_compliance":
        return f"anchor {{ compliance_m2_per_n: {1 / p['K_per_length']} }}", ""
    if effect == "grasp_offset":
        x, y = common.pad_place(case, recording) - pinch
        return f"grasp_offset {{ x_m: {x} y_m: {y} }}", ""
    if effect == "jaw_orientation":
        return f"jaw_roll_deg: {np.degrees(p['roll'])}", ""
    if effect == "adhesion":
        half = case["where"]["half_size_m"]
        return (f"adhesion {{ stiffness_pa_per_m: {p['k']} break_m: {p['break']} x_m: {x} y_m: {y} half_x_m: {half[0]} "
                f"half_y_m: {half[1]} }}"), ""
    if effect == "viscoelastic":
        return f"viscoelastic {{ share: {p['g']} time_s: {p['tau']} }}", ""
    if effect == "strain_stiffening":
        return f"strain_stiffening: {p['c2_over_mu']}", ""
    if effect == "tool_backlash":
        return "", f"tip_backlash {{ x: {p['b']} y: {p['b']} z: {p['b']} }}"
    if effect == "actuation_delay":
        return "", f"transport_delay_s: {p['tau']}"
    if effect == "grasp_slip":
        pull = p["Fs_share"] * b["young_Pa"] * b["thickness_m"] * b["width_m"] * .05
        return f"grasp_slip {{ speed_m_per_s: {p['v0']} force_n: {pull} total_m: {p['total']} }}", ""
    return "", ""


def scene(case, recording, mesh):
    b = case["base"]
    count = [int(round(b[key] / PITCH)) + 1 for key in ("width_m", "length_m")]
    tissue, arm = effects_of(case, recording)
    shaft = -np.array(case["shaft"])
    return f"""format_version: 1
gravity_m_per_s2: 9.81
tissue {{
  pose {{ translation_m {{ z: {b["thickness_m"] / 2} }} }}
  grid {{ count_x: {count[0]} count_y: {count[1]} pitch_m: {PITCH} }}
  density_kg_per_m3: {b["density_kg_per_m3"]} thickness_m: {b["thickness_m"]}
  anchor_max_y_m: {b["strip_m"] - b["length_m"] / 2}
  static_friction: {b["friction"]} dynamic_friction: {b["friction"]}
  model: TISSUE_REFERENCE
  material {{ young_modulus_pa: {b["young_Pa"] * case["young_factor"][recording]} poisson_ratio: {b["poisson"]}
    damping_per_s: {b["mass_rate_per_s"]} law: LAW_NEO_HOOKE }}
  reference {{ {mesh} }}
  effects {{ {tissue} }}
}}
tool {{ base {{ translation_m {{ x: 0.1427 y: 0 z: 0.1584 }} }} roll_deg: 0 tip_offset_m: 0.0102 contact: false
  grip {{ shape: GRIP_RECTANGLE hold: HOLD_PAD half_x_m: {b["pad_m"][0] / 2} half_y_m: {b["pad_m"][1] / 2} }}
  shaft_direction {{ x: {shaft[0]} y: {shaft[1]} z: {shaft[2]} }} }}
rigid_body {{ name: "board" role: ROLE_BOARD half_space: true }}
arm {{ {arm} }}
"""


def write_commands(folder, case, recording):
    b = case["base"]
    pinch = np.array(case["pinches_m"][protocol.RECORDINGS[recording][0]]) + case["jitter_m"][recording]
    start = np.append(pinch - np.array([b["width_m"], b["length_m"]]) / 2, b["thickness_m"] / 2)
    t = np.arange(0, DURATION + 1e-9, .01)
    rows = np.column_stack([t, start + protocol.path(case, recording, t), np.where(t < protocol.CLOSED - 1e-9, .6, 0)])
    os.makedirs(folder)
    np.savetxt(os.path.join(folder, "tool.csv"), rows, fmt="%.7f", delimiter=",", comments="",
               header="t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad")
    with open(os.path.join(folder, "recording.txtpb"), "w", encoding="ascii") as f:
        f.write('name: "r"\ntool_rate_hz: 100\n')


def table(path):
    with open(path, encoding="ascii") as f:
        f.readline()
        return np.array([np.array(line.split(","), float) for line in f])


def on_lines(places, lines_x, lines_y):
    """[..., x, y, xyz] at every PITCH, linear between, at places on the lines."""
    def along(v, at, axis):
        k = np.minimum((at / PITCH + 1e-6).astype(int), v.shape[axis] - 2)
        share = (at / PITCH - k).reshape([-1] + [1] * (v.ndim - axis - 1))
        return np.take(v, k, axis) * (1 - share) + np.take(v, k + 1, axis) * share
    return along(along(places, lines_x, places.ndim - 3), lines_y, places.ndim - 2)


def run_recording(case, recording, mesh=MESH, cells=CELLS, progress=lambda text: None):
    """-> dictionary of arrays."""
    b = case["base"]
    folder = tempfile.mkdtemp(prefix="own")
    try:
        with open(os.path.join(folder, "scene.txtpb"), "w", encoding="ascii") as f:
            f.write(scene(case, recording, mesh))
        write_commands(os.path.join(folder, "commands"), case, recording)
        done = subprocess.run([program(), "simulate", "--scene", "scene.txtpb", "--commands", "commands", "-o", "out", "--cloud-rate", "0",
                               "--rate", "20", "--threads", "1"], cwd=folder, capture_output=True, text=True, check=False)
        progress(done.stderr.strip()[-200:])
        if done.returncode:
            raise RuntimeError(f"mismatch simulate ended with {done.returncode}: {(done.stderr or done.stdout).strip()[-300:]}")
        rows = table(os.path.join(folder, "out", "markers.csv"))
        pull = table(os.path.join(folder, "out", "force.csv"))
    finally:
        shutil.rmtree(folder)
    shape = [int(round(b[key] / PITCH)) + 1 for key in ("width_m", "length_m")]
    # As docs/formats.md 3 says: the upper face at the places of the grid, then the lower.
    at = rows[:, 1:].reshape(len(rows), 2, *shape, 3)[:, ::-1]
    grid = np.stack(np.meshgrid(*[PITCH * np.arange(n) for n in shape], indexing="ij"), -1) - np.array([b["width_m"], b["length_m"]]) / 2
    rest = np.stack([np.concatenate([grid, np.full((*shape, 1), z)], -1) for z in (0, b["thickness_m"])])
    if np.abs(at[0] - rest)[..., :2].max() > .002:
        raise RuntimeError("markers.csv has the places of the grid in another order than along y first, then along x")
    xs, ys = np.linspace(0, b["width_m"], cells + 1), np.linspace(0, b["length_m"], cells + 1)
    half = lambda v: np.sort(np.concatenate([v, (v[1:] + v[:-1]) / 2]))
    moved = on_lines(at - rest, half(xs), half(ys))
    frames = common.FRAME * np.arange(int(round(DURATION / common.FRAME)) + 1)
    which = np.abs(rows[:, :1] - frames).argmin(0)
    return {"xs": xs, "ys": ys, "move": common.encode(np.rint(moved[which] / common.STEP_M).astype(np.int64)), "frame_s": frames,
            "force_N": pull[:, 1:4].astype(np.float32), "step_s": pull[:, 0]}


def run_case(effect, seed, folder, cells=None, recordings=range(9), progress=print):
    case = draw_case(effect, seed)
    if not program():
        raise SystemExit("--plant own needs the program mismatch, in $OMENTUM_MISMATCH or on the path")
    try:
        common.store(case, lambda case, k: run_recording(case, k, cells=cells or CELLS, progress=progress), folder, recordings, progress)
    except RuntimeError as stopped:
        raise SystemExit(f"{folder}: {stopped}") from None

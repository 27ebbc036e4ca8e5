#!/usr/bin/env python3
"""The fabrics of the set `cloth_lift`, dragged and lifted by a corner: a shell is fitted to the clouds of one repeat and compared
with those of the other. `mismatch calibrate` begins with tissue on a clamp; these lie free, so the fit stands here; what is
imported and simulated is `mismatch`.

OMENTUM_REAL_DATA=... /usr/bin/python3 cloth_calibration.py MISMATCH SCRATCH [--fabrics paper tan ...] [--evaluations 160]    (Debian: python3-scipy)

Fitted: side of the square, which way its diagonal points, stiffness, friction, time between frames, and where the fused clouds
stand against the robot, whose registration its authors tuned by hand. The clouds begin as scraps of what the cameras told from
the table, so only frames from FIRST on count. The sheet does not meet itself.
"""
import argparse
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
from scipy.optimize import minimize
from scipy.spatial import cKDTree

HERE = Path(__file__).parent
FIRST = 10  # frame: from here on most of the fabric is seen
FAR = 0.03  # [m] a point farther from the surface is none of the fabric
COUNT = 21  # places along a side
DENSITY, THICKNESS = 300.0, 1e-3  # of a light fabric; only E t^2 / (rho g) and the way down count
BELOW = 0.008  # [m] above the table: below it colour does not tell fabric from table
SCENE = """format_version: 1
gravity_m_per_s2: 9.80665
tissue {{
  pose {{ translation_m {{ x: {centre[0]} y: {centre[1]} z: {centre[2]} }}
    x_axis {{ x: {c} y: {s} z: 0 }} y_axis {{ x: {ms} y: {c} z: 0 }} }}
  grid {{ count_x: {count} count_y: {count} pitch_m: {pitch} }}
  density_kg_per_m3: {density}
  thickness_m: {thickness}
  anchor_max_y_m: -10
  static_friction: {friction}
  dynamic_friction: {friction}
  model: TISSUE_ELASTIC
  material {{ young_modulus_pa: {young} poisson_ratio: 0.3 damping_per_s: 5 law: LAW_COROTATED }}
  elastic {{ substeps: 5 iterations: 2 }}
  effects {{ grasp_turn_rad_per_n_m: 1e5 }}
}}
tool {{ contact: false }}
rigid_body {{ name: "table" role: ROLE_BOARD pose {{ translation_m {{ z: {table} }} }} half_space: true }}
"""
NAMES = ("side_mm", "turn_deg", "ln_E_kPa", "friction", "s_per_frame", "frames_late", "x_mm", "y_mm", "z_mm")
START = np.array([260, 0, 6, 0.3, 0.3, 1, 0, 0, 0.0])
STEP = np.array([25, 15, 1.5, 0.15, 0.1, 1, 10, 10, 4])


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    return done.returncode, done.stderr


def read_recording(folder):
    """Clouds by frame, and the way of the gripper [frame][xyz]."""
    index = [row.split(",") for row in (folder / "clouds.csv").read_text().splitlines()[1:]]
    clouds = []
    for _, name in index:
        header, body = (folder / name).read_bytes().split(b"end_header\n", 1)
        kind = "<f8" if b"property double x" in header else "<f4"
        count = int(header.split(b"element vertex ")[1].split()[0])
        per_point = len(body) // count // np.dtype(kind).itemsize
        clouds.append(np.frombuffer(body, kind).reshape(count, per_point)[:, :3].astype(float))
    tool = np.genfromtxt(folder / "tool.csv", delimiter=",", names=True)
    return clouds, np.stack([tool[f"tip_commanded_{a}_m"] for a in "xyz"], 1)


def dense(places):
    """A grid of places with three more between neighbours."""
    def along(v):
        w = np.arange(4)[:, None, None] / 4
        fine = (1 - w) * v[:-1, None] + w * v[1:, None]
        return np.concatenate([fine.reshape(-1, *v.shape[1:]), v[-1:]])
    return along(along(places).swapaxes(0, 1)).reshape(-1, 3)


class Cloth:
    def __init__(self, program, scratch, path, table):
        self.program, self.scratch, self.path, self.table, self.count = program, scratch, path, table, 0

    def simulate(self, x):
        """Places of the sheet in the frames [frame][along x][along y][xyz], or what failed."""
        side, turn, ln_young, friction, wait, late = x[:6]
        self.count += 1
        folder = self.scratch / f"cloth{self.count}"
        (folder / "commands").mkdir(parents=True)
        pitch = 1e-3 * side / (COUNT - 1)
        angle = np.radians(turn - 45)  # the diagonal from the held corner is at 45 degrees of B
        c, s = np.cos(angle), np.sin(angle)
        lower = self.table + 0.5 * THICKNESS
        corner = np.array([*self.path[0, :2], lower])
        half = (0.5e-3 * side - 0.5 * pitch) * np.array([c - s, s + c])  # the jaws hold it half a cell inside
        words = SCENE.format(centre=[corner[0] + half[0], corner[1] + half[1], lower], c=c, s=s, ms=-s, count=COUNT, pitch=pitch,
                             density=DENSITY, thickness=THICKNESS, friction=friction, young=1e3 * np.exp(ln_young),
                             table=self.table)
        (folder / "scene.txtpb").write_text(words)
        rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
        step, frames = 0.02, len(self.path)
        begin = 0.06
        way = self.path - self.path[0] + corner
        for k in range(int(np.ceil((begin + wait * (frames - 1)) / step)) + 2):
            u = np.clip((k * step - begin) / wait, 0, frames - 1)
            tip = [np.interp(u, np.arange(frames), way[:, a]) for a in range(3)]
            rows.append(f"{k * step:.6g},{tip[0]:.9g},{tip[1]:.9g},{tip[2]:.9g},{0.4 if k * step < 0.03 else 0}")
        (folder / "commands" / "tool.csv").write_text("\n".join(rows) + "\n")
        code, said = run(self.program, "simulate", "--scene", folder / "scene.txtpb", "--commands", folder / "commands", "-o",
                         folder / "out", "--rate", 50, "--cloud-rate", 0, "--patch-radius", 1.6 * pitch)
        if code:
            return said
        data = np.loadtxt(folder / "out" / "markers.csv", delimiter=",", skiprows=1)
        places = data[:, 1:].reshape(len(data), -1, 3)[:, : COUNT * COUNT]
        when = begin + wait * (np.arange(frames) - late)
        at = np.clip(np.searchsorted(data[:, 0], when), 0, len(data) - 1)
        shutil.rmtree(folder)
        return places[at].reshape(frames, COUNT, COUNT, 3)


def distances(clouds, sheets, shift, table):
    """Mean distance of the points of each frame from the sheet, of the sheet from the points, and the share of points that are
    far from it [frame][3]. What lies on the table does not count."""
    rows = []
    for points, sheet in zip(clouds, sheets):
        model = dense(sheet) + shift
        seen = points[points[:, 2] > table + BELOW]
        model = model[model[:, 2] > table + BELOW]
        if len(seen) < 50 or len(model) < 50:
            rows.append([FAR, FAR, 1])
            continue
        d = cKDTree(model).query(seen)[0]
        back = cKDTree(seen).query(model)[0]
        near = d < FAR
        rows.append([np.minimum(d, FAR).mean(), np.minimum(back, FAR).mean(), 1 - near.mean()])
    return np.array(rows)


def calibrate(cloth, clouds, evaluations):
    def cost(u):
        x = START + STEP * u
        if not (100 < x[0] < 500 and 0.02 < x[4] < 1.5 and 0 <= x[3] < 2 and 0 < x[2] < 12 and -1 < x[5] < 4):
            return 10 * FAR
        sheets = cloth.simulate(x)
        if isinstance(sheets, str):
            return 10 * FAR
        d = distances(clouds[FIRST:], sheets[FIRST:], 1e-3 * x[6:], cloth.table)
        return float((d[:, 0] + d[:, 1]).mean())
    place = np.zeros(len(START))
    for size in (1, 0.4):  # a second simplex where the first has shrunk
        first = place + size * np.vstack([np.zeros(len(START)), np.eye(len(START))])
        best = minimize(cost, place, method="Nelder-Mead",
                        options={"maxfev": evaluations, "initial_simplex": first, "xatol": 0.01, "fatol": 1e-6})
        place = best.x
    return START + STEP * place


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--fabrics", nargs="+", default=["paper", "tan", "navy", "polka", "redblack"])
    parser.add_argument("--evaluations", type=int, default=160)
    args = parser.parse_args()
    data = os.environ.get("OMENTUM_REAL_DATA")
    if not data or not (Path(data) / "cloth_lift").is_dir():
        raise SystemExit("OMENTUM_REAL_DATA: no set cloth_lift there: skipped")
    args.scratch.mkdir(parents=True)
    code, said = run(args.program, "import", Path(data) / "cloth_lift", "--map", HERE / "maps" / "cloth_lift.txtpb", "-o",
                     args.scratch / "in")
    assert code == 0, said
    for fabric in args.fabrics:
        seen = []
        for repeat in ("", "2"):
            folder = args.scratch / "seen" / (fabric + repeat)
            code, said = run(args.program, "export", args.scratch / "in" / f"{fabric}{repeat}.mcap", "-o", folder)
            assert code == 0, said
            seen.append(read_recording(folder))
        table = float(np.percentile(np.concatenate([c[:, 2] for c in seen[0][0][FIRST:]]), 0.5))
        cloth = Cloth(args.program, args.scratch / fabric, seen[0][1], table)
        x = calibrate(cloth, seen[0][0], args.evaluations)
        print(f"{fabric}: " + ", ".join(f"{n} {v:.3g}" for n, v in zip(NAMES, x)) + f", {cloth.count} simulations", flush=True)
        sheets = cloth.simulate(x)
        for words, clouds in (("fitted", seen[0][0]), ("other repeat", seen[1][0])):
            d = distances(clouds[FIRST:], sheets[FIRST:], 1e-3 * x[6:], table)
            print(f"  {words}: points {1e3 * d[:, 0].mean():.1f} mm from the sheet ({1e3 * d[:, 0].min():.1f} - "
                  f"{1e3 * d[:, 0].max():.1f} by frame), sheet {1e3 * d[:, 1].mean():.1f} mm from points, "
                  f"{100 * d[:, 2].mean():.1f} % of points farther than 30 mm")
        apart = [np.minimum(cKDTree(a[a[:, 2] > table + BELOW]).query(b[b[:, 2] > table + BELOW])[0], FAR).mean()
                 for a, b in zip(seen[0][0][FIRST:], seen[1][0][FIRST:])]
        print(f"  repeats: {1e3 * np.mean(apart):.1f} mm apart ({1e3 * min(apart):.1f} - {1e3 * max(apart):.1f})", flush=True)


if __name__ == "__main__":
    main()

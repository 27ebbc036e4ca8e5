"""Recordings of the lifts that DOLFINx computed (tests/reference/run_lifts.py), as a robot and a depth camera
would have made them: a case folder of docs/formats.md 3. Shares no code with the simulation.

/usr/bin/python3 lift_recordings.py OUT [--moving] [--lifts 0 1 ...] [--wrong-side N ...] [--shift-mm X Y Z]
    [--believed-thickness-mm T] [--force] [--believed-density D] [--seed K] [--folder FOLDER]

--folder: of the lifts; results/lifts_calculix has those of CalculiX (run_calculix_lifts.py), at rest only.
At rest: a cloud at the end of each hold; --moving: ten a second. --force: a sensor at 100 Hz with a zero and a gain of
its own. Unknown to whoever reads them: E, friction, registration of the camera, its clock, where the jaws closed.
"""
import argparse
from pathlib import Path

import numpy as np

LIFTS = Path(__file__).parents[1] / "reference" / "results" / "lifts"
HOLDS = ((0.8, 1.6, 2.6), (1.2,), (1.6,))  # [s] of each five lifts (tests/reference/run_lifts.py)
CAMERA = np.array([0.03, 0.26, 0.32])
LOOKS_AT = np.array([0.0, -0.005, 0.012])
PIXELS, HALF_WIDTH = (60, 52), 0.17  # of the picture, and of the picture plane at unit depth
NOISE = 1e-3  # [m] along the ray
CLOCK = 0.023  # [s]: clouds show what was so long before their time stamp
TURN_DEG, SHIFT = np.array([0.4, -0.3, 0.5]), np.array([0.0012, -0.0009, 0.0008])
FORCE_NOISE, FORCE_ZERO, FORCE_GAIN, FORCE_CLOCK = 3e-3, 0.01, 0.01, -0.012  # [N], [N], 1, [s]
PINCH = 8e-4  # [m] standard deviation of where the jaws closed against what the robot says, along x and y

BELIEF = """kind: sheet
sheet_size_x_m: {size}
sheet_size_y_m: {size}
sheet_thickness_m: {thickness}
young_modulus_nominal_Pa: {young}
young_modulus_uncertainty_factor: {factor}
poisson_ratio_nominal: 0.45
density_nominal_kg_per_m3: {density}
sheet_origin_x_m: {half}
sheet_origin_y_m: -{half}
sheet_origin_z_m: 0
sheet_axis_x_in_W: 0 1 0
sheet_axis_y_in_W: -1 0 0
clamp_strip_width_m: 0.003
board_plane_normal: 0 0 1
board_plane_z_m: 0
board_friction_nominal: 0.25
gravity_m_per_s2: 9.80665
camera_position_W_m: {camera}
camera_view_direction_W: {view}
camera_registration_uncertainty: 2 mm, 0.7 deg
sensor_noise_class: depth camera, 1 mm
clock_offset_uncertainty_s: 0.05
"""


def holds_of(number):
    return HOLDS[number // 5]


def frames_of(lift):
    """Nodes at rest and in every frame, those of a face by x, then y. The files have them so but for
    x that differ by rounding: there the y of two columns are mixed."""
    rest = lift["rest_m"]
    half = len(rest) // 2
    order = np.concatenate([start + np.lexsort(np.round(rest[start:start + half, 1::-1], 9).T)
                            for start in (0, half)])
    frames = float(lift["unit_m"]) * np.cumsum(lift["frames_differences"], axis=0, dtype=np.int64)
    return rest[order], frames[:, order]


def refined(nodes, side):
    """Nodes of both faces with twice as many intervals, on the parabolas of the 27-node bricks: they
    bend too much for triangles between the nodes alone."""
    def along(values, axis):
        v = np.moveaxis(values, axis, 0)
        a, b, c = v[:-2:2], v[1:-1:2], v[2::2]
        fine = np.empty((2 * len(v) - 1, *v.shape[1:]))
        fine[::2] = v
        fine[1::4] = 0.375 * a + 0.75 * b - 0.125 * c
        fine[3::4] = -0.125 * a + 0.75 * b + 0.375 * c
        return np.moveaxis(fine, 0, axis)

    faces = nodes.reshape(2, side, side, 3)
    return along(along(faces, 1), 2).reshape(-1, 3)


def faces_of(rest):
    """Triangles of the closed surface: both faces on one grid, then the rims."""
    half = len(rest) // 2
    nx = len(np.unique(np.round(rest[:half, 0], 9)))
    ny = half // nx
    x, y = rest[:half, :2].reshape(nx, ny, 2).transpose(2, 0, 1)
    assert np.ptp(x, axis=1).max() < 1e-9 and (np.diff(y, axis=1) > 0).all(), "no grid"
    grid = np.arange(half).reshape(nx, ny)
    a, b, c, d = (g.ravel() for g in (grid[:-1, :-1], grid[1:, :-1], grid[1:, 1:], grid[:-1, 1:]))
    upper = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    lower = upper[:, ::-1] + half
    rims = []
    for edge in (grid[:, 0], grid[-1, :], grid[::-1, -1], grid[0, ::-1]):
        p, q = edge[:-1], edge[1:]
        rims += [np.stack([p, p + half, q + half], 1), np.stack([p, q + half, q], 1)]
    return np.concatenate([upper, lower] + rims)


def first_hits(rays, points, triangles):
    """Range of the first hit of each ray of the camera; inf where there is none (Moeller and Trumbore).
    A triangle is tried with the rays of the rectangle of the picture that it lies in."""
    place = picture_of(points)[triangles]
    size = np.array(PIXELS)
    low = np.clip(np.ceil(place.min(axis=1) - 1e-6), 0, size).astype(int)
    high = np.clip(np.floor(place.max(axis=1) + 1e-6), -1, size - 1).astype(int)
    width, height = np.maximum(high - low + 1, 0).T
    count = width * height
    of = np.repeat(np.arange(len(triangles)), count)
    number = np.arange(len(of)) - np.repeat(np.cumsum(count) - count, count)
    ray = (low[of, 1] + number // width[of]) * PIXELS[0] + low[of, 0] + number % width[of]
    a, b, c = (points[triangles[of, k]] for k in range(3))
    e1, e2, d, s = b - a, c - a, rays[ray], CAMERA - a
    dot = lambda p, q: np.einsum("ij,ij->i", p, q)
    h, q = np.cross(d, e2), np.cross(s, e1)
    det = dot(h, e1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v, t = dot(h, s) / det, dot(d, q) / det, dot(e2, q) / det
    hit = (np.abs(det) > 1e-18) & (u >= -1e-9) & (v >= -1e-9) & (u + v <= 1 + 1e-9) & (t > 0)
    nearest = np.full(len(rays), np.inf)
    np.minimum.at(nearest, ray[hit], t[hit])
    return nearest


def camera_axes():
    z = (LOOKS_AT - CAMERA) / np.linalg.norm(LOOKS_AT - CAMERA)
    x = np.cross(z, [0, 0, 1])
    x /= np.linalg.norm(x)
    return x, np.cross(z, x), z


def half_size():
    return HALF_WIDTH * np.array([1, PIXELS[1] / PIXELS[0]])


def picture_of(points):
    """Column and row of points, the middle of the first pixel at 0."""
    x, y, z = camera_axes()
    d = points - CAMERA
    plane = np.stack([d @ x, d @ y], 1) / (d @ z)[:, None]
    return (plane / half_size() + 1) / 2 * np.array(PIXELS) - 0.5


def camera_rays():
    x, y, z = camera_axes()
    half = half_size()
    u, v = (half[k] * (2 * (np.arange(PIXELS[k]) + 0.5) / PIXELS[k] - 1) for k in range(2))
    rays = z + u[None, :, None] * x + v[:, None, None] * y  # row by row
    rays = rays.reshape(-1, 3)
    return rays / np.linalg.norm(rays, axis=1)[:, None], z


def hidden_by_shaft(rays, tip):
    """Rays that pass within 5 mm of the shaft, which stands up from 10 mm above the tip."""
    along = np.array([0, 0, 1.0])
    w = CAMERA - tip
    b, d, e = rays @ along, rays @ w, along @ w
    bottom = 1 - b * b
    s = (b * e - d) / bottom
    height = np.clip((e - b * d) / bottom, 0.010, 0.3)
    s = height * b - d
    gap = np.linalg.norm(w + s[:, None] * rays - height[:, None] * along, axis=1)
    return (gap < 0.005) & (s > 0)


def turn(degrees):
    x, y, z = np.radians(degrees)
    c, s = np.cos, np.sin
    rx = np.array([[1, 0, 0], [0, c(x), -s(x)], [0, s(x), c(x)]])
    ry = np.array([[c(y), 0, s(y)], [0, 1, 0], [-s(y), 0, c(y)]])
    rz = np.array([[c(z), -s(z), 0], [s(z), c(z), 0], [0, 0, 1]])
    return rz @ ry @ rx


def write_ply(path, points):
    header = (f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\n"
              "property float y\nproperty float z\nend_header\n")
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def write_force(path, lift, random):
    """Of the tissue on the tool; nothing before the jaws close."""
    step, force = float(lift["step_s"]), lift["force_N"]
    times = np.arange(-5 * step, (len(force) - 1) * step, 0.01)
    seen = np.stack([np.where(times < 0, 0, np.interp(times, step * np.arange(len(force)), f)) for f in force.T], 1)
    seen = (1 + random.normal(0, FORCE_GAIN)) * seen + random.normal(0, FORCE_ZERO, 3)
    seen += random.normal(0, FORCE_NOISE, seen.shape)
    rows = np.column_stack([times + FORCE_CLOCK, seen])
    np.savetxt(path, rows, fmt="%.6g", delimiter=",", header="t_s,fx_N,fy_N,fz_N", comments="")


def write_belief(folder, size, thickness, density, young, factor):
    words = lambda v: " ".join(f"{x:.9g}" for x in v)
    folder.mkdir(parents=True)
    (folder / "scene_believed.txt").write_text(
        BELIEF.format(size=size, half=size / 2, thickness=thickness, density=density, young=young, factor=factor,
                      camera=words(CAMERA), view=words(camera_rays()[1])))


def write_tool(path, tips, step):
    rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
    for k in range(-5, len(tips)):
        rows.append(f"{k * step:.6g},{','.join(f'{x:.9g}' for x in tips[max(k, 0)])},{0.4 if k < 0 else 0}")
    path.write_text("\n".join(rows) + "\n")


def write_recording(folder, lift, tips, frames, clock, turned, shift, random):
    """Of the file `lift`: `tips` is the way of the jaws as the robot tells it, `frames` are the numbers of those
    the camera saw; its points are turned about the camera and shifted, and bear a time `clock` too late."""
    (folder / "clouds").mkdir(parents=True)
    step, times = float(lift["step_s"]), lift["times_s"]
    write_tool(folder / "tool.csv", tips, step)
    rays, _ = camera_rays()
    rest, states = frames_of(lift)
    up = np.array([0, 0, rest[:, 2].max()])  # W lies on the board, B in the middle of the sheet
    side = int(round(np.sqrt(len(rest) // 2)))
    triangles = faces_of(refined(rest, side))
    index = ["t_s,file"]
    for k in frames:
        seen = first_hits(rays, refined(states[k], side) + up, triangles)
        tip = lift["path_m"][int(round(times[k] / step))] + up
        seen[hidden_by_shaft(rays, tip)] = np.inf
        hit = np.isfinite(seen)
        depth = seen[hit] + random.normal(0, NOISE, hit.sum())
        cloud = CAMERA + depth[:, None] * rays[hit]
        write_ply(folder / "clouds" / f"{k:06}.ply", CAMERA + (cloud - CAMERA) @ turned.T + shift)
        index.append(f"{times[k] + clock:.6g},clouds/{k:06}.ply")
    (folder / "clouds.csv").write_text("\n".join(index) + "\n")
    (folder / "recording.txtpb").write_text(
        f'name: "{folder.name}"\ntool_rate_hz: {1 / step:.0f}\ncloud_rate_hz: 10\ntip_point: jaw_tip\n'
        "clock_offset_uncertainty_s: 0.05\nregistration_uncertainty_m: 0.002\nregistration_uncertainty_rad: 0.012\n")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("out", type=Path)
    parser.add_argument("--moving", action="store_true")
    parser.add_argument("--lifts", type=int, nargs="+", default=range(5))
    parser.add_argument("--wrong-side", type=int, nargs="+", default=[])
    parser.add_argument("--shift-mm", type=float, nargs=3, default=[0, 0, 0])
    parser.add_argument("--believed-thickness-mm", type=float, default=3)
    parser.add_argument("--force", action="store_true")
    parser.add_argument("--believed-density", type=float, default=1000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--folder", type=Path, default=LIFTS)
    args = parser.parse_args()
    write_belief(args.out, 0.09, 1e-3 * args.believed_thickness_mm, args.believed_density, 30000, 3)
    for number in args.lifts:
        random = np.random.default_rng([args.seed, number])
        lift = np.load(args.folder / f"lift{number}.npz")
        folder = args.out / f"lift{number}"
        path = lift["path_m"] + np.array([0, 0, 0.0015]) - np.append(random.normal(0, PINCH, 2), 0)
        if number in args.wrong_side:
            path[:, 0] *= -1
        far = np.abs(lift["times_s"][:, None] - holds_of(number)).min(axis=1)
        seen = np.flatnonzero((far < 1e-6) | args.moving)
        write_recording(folder, lift, path, seen, CLOCK, turn(TURN_DEG), SHIFT + 1e-3 * np.array(args.shift_mm), random)
        if args.force:
            write_force(folder / "force.csv", lift, np.random.default_rng([args.seed, number, 1]))


if __name__ == "__main__":
    main()

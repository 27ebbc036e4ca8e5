"""Writes one truth as a case folder of recordings, with a sensor drawn from a seed, and its label elsewhere."""
import hashlib
import json
import os
import shutil
import tempfile

import numpy as np

import fenics_truth
import protocol
import sensor

DAY = 1795737600  # of every file written [s since 1970], so that no date tells anything
CLOUD_TIMES = np.arange(.05, protocol.DURATION, .1)
HEADER = "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"


class Placement:
    """Box coordinates of the simulation to S and to W."""

    def __init__(self, base, rng):
        yaw = np.radians(rng.uniform(-6, 6))
        self.axis_x = np.array([np.cos(yaw), np.sin(yaw), 0])
        self.axis_y = np.array([-np.sin(yaw), np.cos(yaw), 0])
        self.width = base["width_m"]
        centre = np.append(rng.uniform(-.005, .005, 2), 0)
        self.origin = centre - self.axis_x * base["length_m"] / 2 - self.axis_y * base["width_m"] / 2

    def sheet(self, box):
        box = np.asarray(box, float)
        return np.stack([box[..., 1], self.width - box[..., 0], box[..., 2]], axis=-1)

    def turn(self, box):
        """Of directions, to W."""
        box = np.asarray(box, float)
        return box[..., 1:2] * self.axis_x - box[..., 0:1] * self.axis_y + box[..., 2:] * [0, 0, 1]

    def world(self, box):
        s = self.sheet(box)
        return self.origin + s[..., 0:1] * self.axis_x + s[..., 1:2] * self.axis_y + s[..., 2:] * [0, 0, 1]


def table(path, header, rows, formats):
    with open(path, "w") as f:
        f.write(header + "\n")
        for row in rows:
            f.write(",".join(form % value for form, value in zip(formats, row)) + "\n")


def nodes_of(stored, base):
    """Rest places of the nodes of both faces [face][x][y][xyz]."""
    half = lambda v: np.sort(np.concatenate([v, (v[1:] + v[:-1]) / 2]))
    x, y = np.meshgrid(half(stored["xs"]), half(stored["ys"]), indexing="ij")
    return np.stack([np.stack([x, y, np.full_like(x, z)], -1) for z in (0, base["thickness_m"])])


def camera_of(numbers, centre_W, axis_x):
    e, a = np.radians(numbers["elevation_deg"]), np.radians(numbers["azimuth_deg"])
    side = np.cross([0, 0, 1], axis_x)
    towards = np.cos(e) * (np.cos(a) * axis_x + np.sin(a) * side) + np.sin(e) * np.array([0, 0, 1])
    position = np.round(centre_W + numbers["distance_m"] * towards, 6)
    view = centre_W - position
    return sensor.Camera(position, view / np.linalg.norm(view), PITCH / numbers["distance_m"])


PITCH = sensor.PITCH_M


def write_recording(folder, case, k, stored, place, camera, numbers, with_force, rng):
    base, pinch = case["base"], protocol.RECORDINGS[k][0]
    os.makedirs(os.path.join(folder, "clouds"))
    mid = base["thickness_nominal_m"] / 2
    t = np.arange(0, protocol.DURATION + 1e-9, .02)
    tip = place.world(np.append(case["pinches_m"][pinch], mid) + protocol.path(case, k, t))
    table(os.path.join(folder, "tool.csv"), "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad",
          np.column_stack([t, tip, protocol.jaw_angle(t)]), ["%.3f", "%.6f", "%.6f", "%.6f", "%.3f"])
    clocks = np.clip(rng.normal(0, .008, 2), -.02, .02)  # of clouds and force against the tool's
    if with_force:
        force = np.stack([np.interp(t, stored["step_s"], stored["force_N"][:, a]) for a in range(3)], -1)
        force = place.turn(force) + numbers["force_bias_N"] + rng.normal(0, numbers["force_noise_N"], (len(t), 3))
        table(os.path.join(folder, "force.csv"), "t_s,fx_N,fy_N,fz_N", np.column_stack([t + clocks[1], force])[1:],
              ["%.4f", "%.4f", "%.4f", "%.4f"])
    move, rest = fenics_truth.decode(stored), nodes_of(stored, base)
    body = sensor.Body(stored["xs"], stored["ys"], base["strip_m"])
    true_tip = fenics_truth.tip_path(case, k)
    at = np.append(fenics_truth.pad_place(case, k), base["thickness_m"] / 2)
    error = fenics_truth.rotation(numbers["registration_rad"], np.linalg.norm(numbers["registration_rad"]))
    missing = rng.uniform(.2, .6)
    from_s = rng.uniform(.4, protocol.DURATION - .4 - missing)
    rows, hidden = [], []
    for frame, time in enumerate(CLOUD_TIMES):
        if from_s < time < from_s + missing:
            continue
        i = int(np.argmin(np.abs(stored["frame_s"] - time)))
        vertices = place.world(body.vertices(rest + move[i]))
        tool = sensor.tool_spheres(place.world(at + true_tip(time)), place.turn(case["shaft"]), numbers["tool_half_angle_deg"])
        pixel, depth, share = camera.frame(vertices, body, tool)
        points = sensor.observe(camera, numbers, pixel, depth, rng)
        points = points @ error.T + numbers["registration_m"]
        name = f"clouds/{frame:04d}.ply"
        with open(os.path.join(folder, name), "wb") as f:
            f.write(HEADER.format(len(points)).encode() + points.astype("<f4").tobytes())
        rows.append((time + clocks[0], name))
        hidden.append(share)
    table(os.path.join(folder, "clouds.csv"), "t_s,file", rows, ["%.4f", "%s"])
    force_line = "force_rate_hz: 50\n" if with_force else ""
    repeat = 'repeat_of: "r00"\n' if k in (0, 8) else ""
    with open(os.path.join(folder, "recording.txtpb"), "w") as f:
        f.write(f'name: "r{k:02d}"\ndate: "2026-11-27"\nscene: "scene_believed.txt"\n'
                f'notes: "{protocol.RECORDINGS[k][1]}; pinch point {pinch}"\nframe: "W"\nunits: "m, s, N, rad"\ntip_point: jaw_tip\n'
                f'tool_rate_hz: 50\ncloud_rate_hz: 10\n{force_line}held_out: {"true" if k in case["held_out"] else "false"}\n{repeat}')
    return {"clock_cloud_s": clocks[0], "clock_force_s": clocks[1], "missing_s": [from_s, from_s + missing],
            "hidden_share": [float(np.min(hidden)), float(np.max(hidden))]}


def believed(case, place, camera, numbers, with_force, rng):
    b = case["base"]
    young = b["young_Pa"] * np.exp(rng.uniform(-.75, .75))
    young = float(f"{young:.2g}")
    vector = lambda v: " ".join(f"{x:.6g}" for x in v)
    lines = [
        "# what the operator believes; SI units in the key names", f"sheet_size_x_m: {b['length_m']:g}", f"sheet_size_y_m: {b['width_m']:g}",
        f"sheet_thickness_m: {b['thickness_nominal_m']:g}", f"young_modulus_nominal_Pa: {young:g}", "young_modulus_uncertainty_factor: 3",
        "poisson_ratio_nominal: 0.46", "density_nominal_kg_per_m3: 1050", "material: soft silicone-like, isotropic, elastic as far as known",
        f"sheet_origin_x_m: {place.origin[0]:.6g}", f"sheet_origin_y_m: {place.origin[1]:.6g}", "sheet_origin_z_m: 0",
        f"sheet_axis_x_in_W: {vector(place.axis_x)}", f"sheet_axis_y_in_W: {vector(place.axis_y)}",
        f"clamped_edge: sheet x from 0 to {b['strip_m']:g} m, full width, rigid bar (not visible to the camera as tissue)",
        f"clamp_strip_width_m: {b['strip_m']:g}", "board_plane_normal: 0 0 1", "board_plane_z_m: 0", "board_friction_nominal: 0.3",
        "gravity_m_per_s2: 0 0 -9.81", f"gripper_patch_x_m: {b['pad_m'][1]:g}", f"gripper_patch_y_m: {b['pad_m'][0]:g}",
        "tip_reference: centre of the gripped patch, mid thickness"]
    for n, pinch in enumerate(case["pinches_m"]):
        p = np.append(pinch, 0)
        lines += [f"pinch_point_{n}_sheet_m: {vector(place.sheet(p)[:2])}", f"pinch_point_{n}_W_m: {vector(place.world(p))}"]
    lines += [
        f"camera_position_W_m: {vector(camera.position)}", f"camera_view_direction_W: {vector(camera.axes[2])}",
        "camera_registration_uncertainty: up to 2 mm, 1 deg",
        "sensor_noise_class: depth 0.5-1.5 mm sigma at 0.35 m growing with range squared, about 5 percent flying pixels, possible missing interval",
        f"sensor_depth_step_m: {numbers['step_m']:g}", "clock_offset_uncertainty_s: 0.02",
        "cloud_content: visible top surface of the sheet only, no correspondence"]
    if with_force:
        lines.append(f"force_sensor: at the tool tip, force of the tissue on the tool in W, noise about {numbers['force_noise_N']:.2g} N")
    lines.append(f"shaft_direction_W: {vector(place.turn(case['shaft']))}")
    return "\n".join(lines) + "\n", young


def label_of(case, name, seed, place, numbers, young, with_force, recordings):
    effects = []
    if case["effect"] != "null":
        where = dict(case["where"])
        b, p = case["base"], case["parameters"]
        if case["effect"].startswith("obstacle"):
            z = p["protrusion"] - p["radius"] if case["effect"] == "obstacle_below" else b["thickness_m"] + p["gap"] + p["radius"]
            box = [where["centre_m"][0] + b["width_m"] / 2, where["centre_m"][1] + b["length_m"] / 2, z]
            where["centre_W_m"] = place.world(box).tolist()
        effects = [{"name": case["effect"].split("_")[0] if case["effect"].startswith("obstacle") else case["effect"],
                    "variant": case["effect"], "parameters": p, "where": where}]
    return {"case": name, "engine": case["engine"], "effects": effects, "base": case["base"], "believed_young_Pa": young,
            "with_force": with_force, "held_out": [f"r{k:02d}" for k in case["held_out"]], "truth_seed": case["seed"], "seed": seed,
            "pinch_jitter_m": case["jitter_m"], "young_factor": case["young_factor"],
            "sheet_in_W": {"origin_m": place.origin.tolist(), "axis_x": place.axis_x.tolist(), "axis_y": place.axis_y.tolist()},
            "sensor": numbers, "recordings": recordings}


def write_case(truth, seed, folder, force=None, label_only=False):
    """The same seed gives the same bytes. label_only: the folder is there and is left alone. -> the label."""
    with open(os.path.join(truth, "truth.json")) as f:
        case = json.load(f)
    have = [k for k in range(9) if os.path.exists(os.path.join(truth, f"r{k:02d}.npz"))]
    if not have:
        raise SystemExit(f"{truth} holds no recording")
    if os.path.exists(folder) != label_only:
        raise SystemExit(f"{folder} is not there" if label_only else f"{folder} is there already")
    rng = np.random.default_rng([78, seed])
    place, numbers = Placement(case["base"], rng), sensor.draw(rng)
    with_force = bool(rng.random() < .5) if force is None else force
    b = case["base"]
    camera = camera_of(numbers, place.world([b["width_m"] / 2, b["length_m"] / 2, 0]), place.axis_x)
    text, young = believed(case, place, camera, numbers, with_force, rng)
    # A label is drawn as its case was, into a folder that does not stay.
    part = tempfile.mkdtemp() if label_only else folder.rstrip("/") + ".part"
    os.makedirs(part, exist_ok=label_only)
    with open(os.path.join(part, "scene_believed.txt"), "w") as f:
        f.write(text)
    recordings = {}
    for k in have:
        stored = np.load(os.path.join(truth, f"r{k:02d}.npz"))
        stored = {key: stored[key] for key in stored.files}
        recordings[f"r{k:02d}"] = write_recording(os.path.join(part, f"r{k:02d}"), case, k, stored, place, camera, numbers, with_force,
                                                  np.random.default_rng([79, seed, k]))
    for where, _, files in os.walk(part, topdown=False):
        for name in files:
            os.utime(os.path.join(where, name), (DAY, DAY))
        os.utime(where, (DAY, DAY))
    if label_only:
        shutil.rmtree(part)
    else:
        os.rename(part, folder)
    return label_of(case, os.path.basename(folder.rstrip("/")), seed, place, numbers, young, with_force, recordings)


def label_bytes(label):
    return json.dumps(label, indent=1, default=float).encode() + b"\n"


def write_label(label, labels):
    os.makedirs(labels, exist_ok=True)
    with open(os.path.join(labels, label["case"] + ".json"), "wb") as f:
        f.write(label_bytes(label))


def digest(folder):
    """SHA-256 of every file of a case, as lines of a manifest."""
    lines = []
    for where, folders, files in os.walk(folder):
        folders.sort()
        for name in sorted(files):
            path = os.path.join(where, name)
            with open(path, "rb") as f:
                lines.append(f"{hashlib.sha256(f.read()).hexdigest()}  {os.path.relpath(path, os.path.dirname(folder.rstrip('/')))}")
    return lines

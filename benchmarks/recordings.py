#!/usr/bin/env python3
"""Figures of `mismatch` with recordings: prints lines "name value unit  # remark".

/usr/bin/python3 recordings.py PROGRAM SCRATCH [--moving] [--skip-paper] [--skip-import] [--lifts N ...]
    [--tolerance-mm T] [--predict-tolerance-mm T] [--threads N] [--import-frames N] [--only-import] [--folder FOLDER]

Lifts off a board at three heights each, computed by DOLFINx (tests/reference/run_lifts.py) or, with --folder, by others,
are calibrated on. The held-out error is that of the true surface, without noise, against what the scene fitted without a pinch point predicts for its
commands: mean distance from the nodes of the upper face to the predicted surface.
"""
import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "mismatch"))
import lift_recordings as lifts  # noqa: E402

UP = np.array([0, 0, 0.0015])
# The arm of a believed scene does not reach every corner of the sheet; where it stands moves no tissue.
ARM = {"x": 0.12, "y": -0.02, "z": 0.12}


def point_to_triangles(q, a, b, c):
    """Distance of each point from the nearest triangle (Ericson 2005, 5.1.5), all pairs."""
    best = np.full(len(q), np.inf)
    for k in range(len(a)):
        ab, ac, ap = b[k] - a[k], c[k] - a[k], q - a[k]
        n = np.cross(ab, ac)
        area = n @ n
        u = np.cross(ab, ap) @ n / area  # of c
        v = np.cross(ap, ac) @ n / area  # of b
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        distance = np.where(inside, np.abs(ap @ n) / np.sqrt(area), np.inf)
        for p, r in ((a[k], b[k]), (b[k], c[k]), (c[k], a[k])):
            d = r - p
            t = np.clip((q - p) @ d / (d @ d), 0, 1)
            distance = np.minimum(distance, np.linalg.norm(q - p - t[:, None] * d, axis=1))
        best = np.minimum(best, distance)
    return best


def grid_triangles(side):
    index = np.arange(side * side).reshape(side, side)
    a, b, c, d = (g.ravel() for g in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]))
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def true_error(program, scene, recording, lift, scratch, model, times, tolerance):
    """Mean and rms distance of the true upper face from the simulated one, m."""
    out = scratch / f"predicted_{model}_{recording.name}"
    command = [program, "simulate", "--scene", scene, "--commands", recording, "-o", out, "--cloud-rate", 0,
               "--tolerance-mm", tolerance]
    command += [w for axis, at in ARM.items() for w in ("--set", f"scene.tool.base.translation_m.{axis}={at}")]
    if model != "cluster":
        command += ["--model", model]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(done.stderr)
    rows = np.loadtxt(out / "markers.csv", delimiter=",", skiprows=1)
    frames = lifts.frames_of(lift)[1] + UP
    half = frames.shape[1] // 2
    all_distances = []
    for t in times:
        seen = frames[np.abs(lift["times_s"] - t).argmin(), :half]
        points = rows[np.abs(rows[:, 0] - t).argmin(), 1:].reshape(-1, 3)
        count = len(points) // 2 if model == "reference" else len(points)
        points = points[:count]
        if model != "reference":  # middle surface: half the thickness below the upper face
            seen = 0.5 * (seen + frames[np.abs(lift["times_s"] - t).argmin(), half:])
        triangles = grid_triangles(int(round(np.sqrt(count))))
        all_distances.append(point_to_triangles(seen, *(points[triangles[:, k]] for k in range(3))))
    distances = np.concatenate(all_distances)
    return distances.mean(), np.sqrt((distances**2).mean())


def calibrate(program, case, out, more):
    begin = time.monotonic()
    done = subprocess.run([str(c) for c in [program, "calibrate", "-r", case, "-o", out, *more]],
                          stdout=subprocess.PIPE, text=True)
    if done.returncode:
        raise SystemExit(done.returncode)
    print("#", done.stdout.replace("\n", "\n# "))
    return time.monotonic() - begin, json.loads((out / "calibration.json").read_text())


def bench_import(program, scratch, frames):
    """A recording of so many raw depth images, 640 x 480."""
    folder = scratch / "depth"
    (folder / "depth").mkdir(parents=True)
    size = (480, 640)
    import struct
    import zlib

    def png(rows):
        def chunk(kind, data):
            return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        raw = b"".join(b"\0" + row.tobytes() for row in rows.astype(">u2"))
        return (b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", size[1], size[0], 16, 0, 0, 0, 0))
                + chunk(b"IDAT", zlib.compress(raw, 0)) + chunk(b"IEND", b""))

    random = np.random.default_rng(1)
    base = 3000 + random.integers(0, 50, size)
    index = ["t_s,file"]
    for k in range(frames):
        name = f"depth/{k:06}.png"
        (folder / name).write_bytes(png(base + k))
        index.append(f"{k / 30:.6f},{name}")
    (folder / "depth.csv").write_text("\n".join(index) + "\n")
    (folder / "recording.txtpb").write_text("camera { fx: 600 fy: 600 cx: 320 cy: 240 width: 640 height: 480 }\n")
    megabytes = sum(f.stat().st_size for f in (folder / "depth").iterdir()) / 1e6
    begin = time.monotonic()
    subprocess.run([str(program), "import", str(folder), "-o", str(scratch / "depth.mcap")], check=True,
                   stdout=subprocess.DEVNULL)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(f"recordings.import_mb_per_s {megabytes / (time.monotonic() - begin):.1f} MB/s  # {megabytes:.0f} MB of depth, "
          f"{used.ru_utime + used.ru_stime:.2f} core-seconds")
    peak = used.ru_maxrss / 1e3
    print(f"recordings.import_peak_mb {peak:.0f} MB", flush=True)


def write_bag(path, frames, size=(480, 640)):
    """A bag of ROS 2 of so many raw depth images in chunks of four, uncompressed, as rosbag2 writes them by default."""
    import struct

    def text(words):
        return struct.pack("<I", len(words)) + words

    def record(kind, content):
        return struct.pack("<BQ", kind, len(content)) + content

    def cdr(*parts):
        out = b"\0\1\0\0"
        for part in parts:
            if isinstance(part, str):
                part = struct.pack("<I", len(part) + 1) + part.encode() + b"\0"
                out += b"\0" * (-(len(out) - 4) % 4) + part
            elif isinstance(part, int):
                out += b"\0" * (-(len(out) - 4) % 4) + struct.pack("<I", part)
            else:
                out += part
        return out

    rule, header = "=" * 80 + "\nMSG: ", "std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
    size_fields = "std_msgs/Header header\nuint32 height\nuint32 width\n"
    image = f"{size_fields}string encoding\nuint8 is_bigendian\nuint32 step\nuint8[] data\n{rule}{header}"
    info = f"{size_fields}string distortion_model\nfloat64[] d\nfloat64[9] k\n{rule}{header}"
    begin = b""
    for number, (name, kind, definition) in enumerate((("/depth/image_raw", "Image", image),
                                                       ("/depth/camera_info", "CameraInfo", info)), 1):
        begin += record(3, struct.pack("<H", number) + text(f"sensor_msgs/msg/{kind}".encode()) + text(b"ros2msg")
                        + text(definition.encode()))
        begin += record(4, struct.pack("<HH", number, number) + text(name.encode()) + text(b"cdr") + struct.pack("<I", 0))
    start = 1_700_000_000 * 10**9

    def message(channel, t, data):
        return record(5, struct.pack("<HIQQ", channel, 0, t, t) + data)

    K = np.array([600, 0, 320, 0, 600, 240, 0, 0, 1], "<f8")
    data = cdr(1_700_000_000, 0, "camera", size[0], size[1], "plumb_bob", 0)
    begin += message(2, start, data + b"\0" * (-(len(data) - 4) % 8) + K.tobytes())
    random = np.random.default_rng(1)
    base = (300 + random.integers(0, 5, size)).astype("<u2")
    with open(path, "wb") as file:
        file.write(b"\x89MCAP0\r\n" + record(1, text(b"ros2") + text(b"")))
        chunk = begin
        for k in range(frames):
            t = start + k * 33_333_333
            pixels = (base + k % 1000).astype("<u2")
            chunk += message(1, t, cdr(t // 10**9, t % 10**9, "camera", size[0], size[1], "16UC1", b"\0", 2 * size[1],
                                       pixels.size * 2, pixels.tobytes()))
            if k % 4 == 3 or k + 1 == frames:
                file.write(record(6, struct.pack("<QQQI", 0, 0, len(chunk), 0) + text(b"") + struct.pack("<Q", len(chunk))
                                  + chunk))
                chunk = b""
        file.write(record(15, struct.pack("<I", 0)) + record(2, bytes(20)) + b"\x89MCAP0\r\n")


def bench_bag(program, scratch, frames):
    """A bag of so many raw depth images into a recording."""
    bag = scratch / "depth_bag.mcap"
    write_bag(bag, frames)
    begin = time.monotonic()
    child = subprocess.Popen([str(program), "import", str(bag), "-o", str(scratch / "from_bag.mcap")],
                             stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    _, status, used = os.wait4(child.pid, 0)
    if status:
        raise SystemExit(f"mismatch import {bag} failed")
    megabytes = bag.stat().st_size / 1e6
    print(f"recordings.bag_mb_per_s {megabytes / (time.monotonic() - begin):.1f} MB/s  # {megabytes:.0f} MB of depth, "
          f"{used.ru_utime + used.ru_stime:.2f} core-seconds")
    print(f"recordings.bag_peak_mb {used.ru_maxrss / 1e3:.0f} MB", flush=True)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=Path)
    parser.add_argument("scratch", type=Path)
    parser.add_argument("--moving", action="store_true")
    parser.add_argument("--skip-paper", action="store_true")
    parser.add_argument("--skip-import", action="store_true")
    parser.add_argument("--lifts", nargs="+", default=["0", "1", "2", "3", "4"])
    parser.add_argument("--tolerance-mm", default="0.6")
    parser.add_argument("--predict-tolerance-mm", default="0.6", help="of the mesh that predicts what was left out")
    parser.add_argument("--threads", default="2")
    parser.add_argument("--import-frames", type=int, default=300, help="6500 are 4 GB")
    parser.add_argument("--only-import", action="store_true")
    parser.add_argument("--folder", type=Path, default=lifts.LIFTS, help="of the lifts")
    args = parser.parse_args()
    if not args.skip_import:
        bench_import(args.program, args.scratch, args.import_frames)
        bench_bag(args.program, args.scratch, args.import_frames)
    if args.only_import:
        return
    case = args.scratch / "case"
    subprocess.run([sys.executable, lifts.__file__, str(case), "--folder", str(args.folder), "--lifts", *args.lifts,
                    *(["--moving"] if args.moving else [])], check=True)
    def times_of(number):
        holds = lifts.holds_of(number)
        return np.arange(0.2, holds[-1] + 0.4, 0.2) if args.moving else holds

    for method in ("reference", "paper")[: 1 if args.skip_paper else 2]:
        out = args.scratch / f"out_{method}"
        seconds, found = calibrate(args.program, case, out, ["--method", method, "--threads", args.threads,
                                                         "--tolerance-mm", args.tolerance_mm])
        name = "calibrate_s" if method == "reference" else "calibrate_paper_s"
        print(f"recordings.{name} {seconds:.1f} s")
        left = [r for r in found["fit"] if r["role"] == "left_out"]
        errors = [true_error(args.program, out / "left_out" / f"{r['recording']}.txtpb", case / r["recording"],
                             np.load(args.folder / f"{r['recording']}.npz"), args.scratch,
                             "reference" if method == "reference" else "cluster",
                             times_of(int(r["recording"][4:])), args.predict_tolerance_mm) for r in left]
        name = "held_out_mm" if method == "reference" else "held_out_paper_mm"
        each = ", ".join(f"{r['recording']} {1e3 * e[0]:.3f}" for r, e in zip(left, errors))
        print(f"recordings.{name} {1e3 * np.mean([e[0] for e in errors]):.4f} mm  # mean distance of the true surface; {each}",
              flush=True)


if __name__ == "__main__":
    main()

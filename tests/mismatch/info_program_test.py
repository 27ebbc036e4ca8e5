#!/usr/bin/env python3
"""`mismatch info` on lifts with clouds: repeats whose commands differ by millimetres are compared through the model of
their scene; tool, board and background are told from tissue; a contact sheet is drawn.

usage: info_program_test.py MISMATCH
"""
import pathlib
import re
import subprocess
import sys
import tempfile

import numpy as np

from simulate_program import write_lift
from small_lifts import BELIEVED, NOISE

ELASTIC = BELIEVED.replace("TISSUE_REFERENCE", "TISSUE_ELASTIC").replace("LAW_NEO_HOOKE", "LAW_COROTATED")


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, (command, done.stderr)
    return done.stdout


def write_ply(path, points):
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\n"
    path.write_text(head + "end_header\n" + "".join(f"{x:.7g} {y:.7g} {z:.7g}\n" for x, y, z in points))


def add_strangers(path, tip):
    """A shaft over the tip, the board beside the sheet, a table far off: as many points each as are added."""
    lines = path.read_bytes().split(b"end_header\n", 1)
    assert b"binary_little_endian" in lines[0]
    points = np.frombuffer(lines[1], "<f4").reshape(-1, 3)
    k = np.arange(100)
    shaft = tip + np.stack([0.004 * np.cos(k), 0.004 * np.sin(k), 0.012 + 0.0003 * k], 1)
    board = np.stack([0.035 + 0 * k, -0.03 + 0.0006 * k, 0 * k], 1)
    far = np.stack([0.5 + 0.001 * k, 0 * k, 0 * k], 1)
    write_ply(path, np.concatenate([points, shaft, board, far]))
    return len(points)


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "scene.txtpb").write_text(ELASTIC + f"depth_sensor {{ width_px: 80 height_px: 60 noise_m: {NOISE} }}\n")
        files, points = [], 0
        for k, (height, x) in enumerate(((0.012, 0.015), (0.016, 0.018))):
            write_lift(folder / f"commands{k}", height, start=(x, 0.018, 0.0015))
            case = folder / f"case{k}"
            run(program, "simulate", "--scene", folder / "scene.txtpb", "--commands", folder / f"commands{k}", "-o", case,
                "--seed", k + 1)
            tool = np.loadtxt(case / "tool.csv", delimiter=",", skiprows=1)
            for row in (case / "clouds.csv").read_text().splitlines()[1:]:
                t, file = row.split(",")
                at = np.array([np.interp(float(t), tool[:, 0], tool[:, 1 + axis]) for axis in range(3)])
                points += add_strangers(case / file, at)
            with open(case / "recording.txtpb", "a") as file:
                file.write('repeat_of: "lift"\n')
            files.append(folder / f"{k}.mcap")
            run(program, "import", case, "-o", files[-1])
        said = run(program, "info", *files, "--scene", folder / "scene.txtpb")
        shares = re.findall(r"tissue ([\d.]+) %, tool ([\d.]+) %, board ([\d.]+) %, background ([\d.]+) %", said)
        assert len(shares) == 2, said
        for tissue, tool, board, background in (map(float, s) for s in shares):
            assert abs(board - background) < 0.2 and -0.1 < tool - background < 2, said
            assert tissue > 60, said
        first = re.search(r"of the body at rest (\d+) % seen in the first frame", said)
        assert float(first.group(1)) > 85, said
        raw = float(re.search(r"floor of /markers: ([\d.e-]+) m", said).group(1))
        less = r"floor of /cloud less what the model makes of its own commands: ([\d.e-]+) m"
        model = float(re.search(less, said).group(1))
        assert raw > 3 * model, (raw, model)
        assert model < NOISE / 3, model  # what is left of the sensor's noise in the means of cells
        run(program, "info", files[0], "--contact-sheet", folder / "sheet.png")
        assert (folder / "sheet.png").read_bytes().startswith(b"\x89PNG")
        refused = subprocess.run([program, "info", *map(str, files), "--contact-sheet", str(folder / "no.png")],
                                 capture_output=True, text=True)
        assert refused.returncode == 2 and "allowed one" in refused.stderr, refused.stderr


main()

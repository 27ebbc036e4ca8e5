#!/usr/bin/env python3
"""`mismatch simulate` on a scene of a beam alone, without camera, workspace and task: it is held at a place and let go.

Law: without gravity and damping it swings about its shape at rest with the first frequency of a cantilever.

usage: held_program_test.py MISMATCH
"""
import math
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

LENGTH, THICKNESS, YOUNG, DENSITY = 0.045, 0.003, 60000.0, 1000.0  # of the free part
UNTIL = 0.2
BEAM = f"""format_version: 1
gravity_m_per_s2: 0
tissue {{
  grid {{ count_x: 4 count_y: 17 pitch_m: 0.003 }}
  density_kg_per_m3: {DENSITY}
  thickness_m: {THICKNESS}
  anchor_max_y_m: -0.021
  model: TISSUE_REFERENCE
  material {{ young_modulus_pa: {YOUNG} poisson_ratio: 0 damping_per_s: 0 law: LAW_NEO_HOOKE }}
  reference {{ elements_x: 1 elements_y: 15 elements_z: 1 }}
}}
tool {{ contact: false }}
held_start {{ y_m: 0.0225 radius_m: 0.003 position_m {{ x: 0 y: 0.0223 z: 0.003 }} until_s: {UNTIL} }}
"""


def simulate(program, folder, out, scene, more=("--cloud-rate", "0"), code=0):
    (folder / f"{out}.txtpb").write_text(scene)
    command = [program, "simulate", "--scene", folder / f"{out}.txtpb", "--commands", folder / "commands", "-o",
               folder / out, "--rate", "100", *more]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == code, (done.returncode, done.stderr)
    return done.stderr


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "commands").mkdir()
        rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
        rows += [f"{0.01 * k:.2f},0.3,0,0.1,1" for k in range(181)]
        (folder / "commands" / "tool.csv").write_text("\n".join(rows) + "\n")

        simulate(program, folder, "free", BEAM)
        data = np.loadtxt(folder / "free" / "markers.csv", delimiter=",", skiprows=1)
        time, points = data[:, 0], data[:, 1:].reshape(len(data), -1, 3)
        end = points[:, 16, 2] - points[0, 0, 2]  # height of a corner of the free end against the clamp
        held = time < UNTIL - 1e-6
        assert np.ptp(end[held]) < 1e-5, np.ptp(end[held])
        assert 0.0025 < end[0] < 0.0035, end[0]
        # Crossings of the shape at rest.
        down = [t0 + (t1 - t0) * a / (a - b) for t0, t1, a, b in zip(time, time[1:], end, end[1:]) if a > 0 >= b]
        frequency = (len(down) - 1) / (down[-1] - down[0])
        flexural = math.sqrt(YOUNG * THICKNESS**2 / (12 * DENSITY))
        expected = 1.8751**2 / (2 * math.pi * LENGTH**2) * flexural
        print(f"# first frequency {frequency:.3f} Hz, cantilever {expected:.3f} Hz")
        assert len(down) > 2 and abs(frequency / expected - 1) < 0.03, (down, expected)

        error = simulate(program, folder, "clouds", BEAM, ("--cloud-rate", "10"), code=2)
        assert "scene.camera: missing, clouds need it" in error, error
        off = BEAM.replace("y_m: 0.0225 radius", "y_m: 0.3 radius")
        error = simulate(program, folder, "off", off, code=2)
        assert "scene.held_start: no tissue within 0.003 m of (0, 0.3) m" in error, error


main()

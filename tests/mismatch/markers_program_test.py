#!/usr/bin/env python3
"""`mismatch calibrate` on markers alone, of a strip that is held at a place and let go, as `mismatch simulate` makes them: the
stiffness is inside its interval, which was 37 wide and is below 2, the place where it was held is found, what is on no
tissue is named.

usage: markers_program_test.py MISMATCH
"""
import json
import pathlib
import subprocess
import sys
import tempfile

import numpy as np

import small_lifts as small

YOUNG, BELIEVED, DAMPING, UNTIL = 9e4, 7e4, 4.0, 0.3
HELD = (0.0, 0.0212, 0.005)  # [m] where it was held; believed 2 mm lower
NOISE, SEED = 2e-5, 1        # [m]
SCENE = """format_version: 1
tissue {{
  grid {{ count_x: 4 count_y: 17 pitch_m: 0.003 }}
  density_kg_per_m3: 1000
  thickness_m: 0.004
  anchor_max_y_m: -0.021
  model: TISSUE_REFERENCE
  material {{ young_modulus_pa: {young} poisson_ratio: 0.45 damping_per_s: {damping} law: LAW_NEO_HOOKE }}
  reference {{ elements_x: 1 elements_y: 10 elements_z: 1 substeps: 4 }}
}}
tool {{ contact: false }}
held_start {{ y_m: 0.0225 radius_m: 0.003 position_m {{ x: 0 y: 0.0212 z: {z} }} until_s: {until} }}
"""
# Nodes of the upper face, 4 across, 17 along.
MARKERS = {"end_left": 16, "end_right": 67, "middle": 28}


def run(*command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout, done.stderr


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "true.txtpb").write_text(SCENE.format(young=YOUNG, damping=DAMPING, z=HELD[2], until=UNTIL))
        (folder / "believed.txtpb").write_text(SCENE.format(young=BELIEVED, damping=3, z=HELD[2] - 0.002, until=0))
        (folder / "commands").mkdir()
        rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad"]
        rows += [f"{0.01 * k:.2f},0.3,0,0.1,1" for k in range(122)]
        (folder / "commands" / "tool.csv").write_text("\n".join(rows) + "\n")
        run(program, "simulate", "--scene", folder / "true.txtpb", "--commands", folder / "commands", "-o", folder / "simulated",
            "--rate", 100, "--cloud-rate", 0)
        data = np.loadtxt(folder / "simulated" / "markers.csv", delimiter=",", skiprows=1)
        points = data[:, 1:].reshape(len(data), -1, 3)
        random = np.random.default_rng(SEED)
        columns = {"t_s": data[:, 0]}
        for marker, node in MARKERS.items():
            for axis in range(3):
                columns[f"{marker}_{'xyz'[axis]}_m"] = points[:, node, axis] + random.normal(0, NOISE, len(data))
        for axis in range(3):
            columns[f"wall_{'xyz'[axis]}_m"] = np.full(len(data), 0.1)
        (folder / "swing").mkdir()
        np.savetxt(folder / "swing" / "markers.csv", np.column_stack(list(columns.values())), delimiter=",",
                   header=",".join(columns), comments="", fmt="%.9f")
        (folder / "swing" / "recording.txtpb").write_text('name: "swing"\nmarkers_rate_hz: 100\nstart { held_markers: true }\n')
        said, warned = run(program, "calibrate", "--scene", folder / "believed.txtpb", "-r", folder / "swing", "-o", folder / "out",
                           "--tolerance-mm", "2", "--no-leave-out")
        found = json.loads((folder / "out" / "calibration.json").read_text())
        young = small.number(found, "scene.tissue.material.young_modulus_pa")
        print(f"# E {young['value'] / 1e3:.2f} kPa ({young['low90'] / 1e3:.2f} - {young['high90'] / 1e3:.2f}), true {YOUNG / 1e3:g}; "
              f"fit {1e3 * found['fit'][0]['rmse_model']:.3f} mm")
        assert young["low90"] < YOUNG < young["high90"], young
        assert young["high90"] / young["low90"] < 2, young
        assert small.is_inside(found, "scene.tissue.material.damping_per_s", DAMPING)
        assert small.is_inside(found, "swing: held.z", 0.002), small.number(found, "swing: held.z")
        assert found["fit"][0]["rmse_model"] < 3 * NOISE * 3**0.5 < found["fit"][0]["rmse_base"], found["fit"]
        assert not any("pinch" in n["name"] for n in found["nuisances"])
        assert "left out: wall" in warned and "let go at 0.30" in said.replace("0.29", "0.30"), (said, warned)


if __name__ == "__main__":
    main()

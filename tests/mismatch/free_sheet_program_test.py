#!/usr/bin/env python3
"""`mismatch calibrate` on a sheet that lies free on a table and is lifted by a corner, recorded by two cameras at once and counted
in frames, as `mismatch simulate` makes it: the shell is fitted by itself, and stiffness, size, turn and time between frames are
inside their intervals, the same on any number of threads.

usage: free_sheet_program_test.py MISMATCH [--sheets N]    N: of so many recordings prints which numbers are inside, and checks nothing
"""
import argparse
import json
import pathlib
import re
import subprocess
import tempfile

import numpy as np

import small_lifts as small

COUNT, SIDE, TABLE = 9, 0.10, 0.05  # places along a side; [m]
YOUNG, PITCH, TURN, PERIOD = 2.4e5, SIDE / (COUNT - 1), 8.0, 0.12  # true
BELIEVED = {"young": 4.8e5, "pitch": 1.05 * PITCH, "turn": 0.0}
JAWS, INSIDE = np.array([0.4, 0.1]), 0.006  # where they close; from both edges of the corner [m]
FRAMES, NOISE, POINTS = 13, 1e-3, 500
SHIFT = np.array([0.004, -0.003, 0.0])  # of the clouds against the robot [m]
SCENE = """format_version: 1
tissue {{
  pose {{ translation_m {{ x: {x:.9g} y: {y:.9g} z: {z:.9g} }} x_axis {{ x: {c:.12g} y: {s:.12g} z: 0 }} y_axis {{ x: {ms:.12g} y: {c:.12g} z: 0 }} }}
  grid {{ count_x: {count} count_y: {count} pitch_m: {pitch:.9g} }}
  density_kg_per_m3: 500
  thickness_m: 0.0005
  anchor_max_y_m: -1
  static_friction: 0.4
  dynamic_friction: 0.4
  model: TISSUE_ELASTIC
  material {{ young_modulus_pa: {young:.9g} poisson_ratio: 0.3 damping_per_s: 5 law: LAW_COROTATED }}
  elastic {{ substeps: 5 iterations: 2 }}
}}
tool {{ contact: false grip {{ half_x_m: 0.01 }} }}
rigid_body {{ name: "table" role: ROLE_BOARD pose {{ translation_m {{ z: {table} }} }} half_space: true }}
"""
PRIORS = """prior { path: "scene.tissue.grid.pitch_m" factor: 1.06 source: "a ruler" }
prior { path: "scene.tissue.pose.turn_deg" sd: 8 source: "by eye" }
prior { path: "scene.depth_sensor.registration_m" sd: 0.005 }
prior { path: "scene.depth_sensor.registration_deg" sd: 0.2 source: "else it is one with the turn of the sheet" }
"""


def scene(young, pitch, turn):
    """A square whose corner is near the jaws."""
    angle = np.radians(turn - 45)
    c, s = np.cos(angle), np.sin(angle)
    half = 0.5 * (COUNT - 1) * pitch - INSIDE
    middle = JAWS + half * np.array([c - s, s + c])
    return SCENE.format(x=middle[0], y=middle[1], z=TABLE + 0.00025, c=c, s=s, ms=-s, count=COUNT, pitch=pitch, young=young, table=TABLE)


def tool_table(period):
    """The way of the jaws, t in units of frames times `period`."""
    rows = ["t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m"]
    for k in range(4 * FRAMES - 3):
        u = k / 4 / (FRAMES - 1)
        way = 0.5 - 0.5 * np.cos(np.pi * u)
        rows.append(f"{period * k / 4:.9g},{JAWS[0] + 0.05 * way:.9g},{JAWS[1]:.9g},{TABLE + 0.00025 + 0.09 * way:.9g}")
    return "\n".join(rows) + "\n"


def run(*command, code=0):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == code, (done.returncode, done.stderr)
    return done.stdout, done.stderr


def write_ply(path, points):
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\nproperty float x\nproperty float y\nproperty float z\nend_header\n"
    path.write_bytes(header.encode() + points.astype("<f4").tobytes())


def record(program, folder, name, seed, held_out):
    """Clouds of the whole true sheet, a number a frame."""
    truth = folder / f"true_{name}"
    (truth / "commands").mkdir(parents=True)
    (truth / "scene.txtpb").write_text(scene(YOUNG, PITCH, TURN))
    (truth / "commands" / "tool.csv").write_text(tool_table(PERIOD))
    run(program, "simulate", "--scene", truth / "scene.txtpb", "--commands", truth / "commands", "-o", truth / "out", "--rate", 50,
        "--cloud-rate", 0)
    data = np.loadtxt(truth / "out" / "markers.csv", delimiter=",", skiprows=1)
    out = folder / "recordings" / name
    (out / "clouds").mkdir(parents=True)
    (out / "tool.csv").write_text(tool_table(1))
    (out / "recording.txtpb").write_text(f'name: "{name}"\ntool_rate_hz: 4\ncloud_rate_hz: 1\nrepeat_of: "lift"\n'
                                         + ("held_out: true\n" if held_out else ""))
    random = np.random.default_rng(seed)
    index = ["t_s,file"]
    for k in range(FRAMES):
        places = np.array([np.interp(PERIOD * k, data[:, 0], column) for column in data[:, 1:].T]).reshape(-1, 3)[: COUNT * COUNT]
        grid = places.reshape(COUNT, COUNT, 3)
        cell = random.integers(0, COUNT - 1, (POINTS, 2))
        share = random.random((POINTS, 2, 1))
        corner = lambda i, j: grid[cell[:, 0] + i, cell[:, 1] + j]
        points = ((1 - share[:, 0]) * ((1 - share[:, 1]) * corner(0, 0) + share[:, 1] * corner(0, 1))
                  + share[:, 0] * ((1 - share[:, 1]) * corner(1, 0) + share[:, 1] * corner(1, 1)))
        write_ply(out / "clouds" / f"{k:06d}.ply", points + SHIFT + random.normal(0, NOISE, points.shape))
        index.append(f"{k},clouds/{k:06d}.ply")
    (out / "clouds.csv").write_text("\n".join(index) + "\n")


def same_but_time(a, b):
    strip = lambda path: re.sub(r'"core_seconds": [^\n]*', "", path.read_text())
    return strip(a) == strip(b)


TRUTH = {"scene.tissue.material.young_modulus_pa": YOUNG, "scene.tissue.grid.pitch_m": PITCH, "scene.tissue.pose.turn_deg": TURN,
         "frame_period_s": PERIOD, "registration.x": SHIFT[0], "registration.y": SHIFT[1]}
BESIDE = {"registration.z": 0, "scene.tissue.material.damping_per_s": 5, "scene.tissue.effects.friction_change": 0}


def print_coverage(program, folder, sheets):
    inside = half_inside = numbers = 0
    for seed in range(1, sheets + 1):
        here = folder / str(seed)
        record(program, here, "lift", seed, False)
        (here / "believed.txtpb").write_text(scene(**BELIEVED))
        (here / "believed.prior.txtpb").write_text(PRIORS)
        run(program, "calibrate", "--scene", here / "believed.txtpb", "-r", here / "recordings", "-o", here / "out", "--frame-period-s",
            "0.15:0.03", "--skip-clouds", 1)
        found = json.loads((here / "out" / "calibration.json").read_text())
        for name, value in (TRUTH | BESIDE).items():
            n = small.number(found, name)
            off = abs(n["value"] - value) / (0.5 * (n["high90"] - n["low90"]))
            print(f"{seed} {name} {n['value']:.5g} ({n['low90']:.5g} - {n['high90']:.5g}), true {value:.5g}, {off:.2f} of half the interval off")
            inside, half_inside, numbers = inside + (off < 1), half_inside + (off < 0.5), numbers + 1
    print(f"{inside} of {numbers} inside, {half_inside} in half of it")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("--sheets", type=int, default=0)
    args = parser.parse_args()
    program = args.program
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        if args.sheets:
            return print_coverage(program, folder, args.sheets)
        record(program, folder, "lift", 1, False)
        record(program, folder, "lift2", 2, True)
        believed = folder / "believed.txtpb"
        believed.write_text(scene(**BELIEVED))
        (folder / "believed.prior.txtpb").write_text(PRIORS)
        command = [program, "calibrate", "--scene", believed, "-r", folder / "recordings", "--frame-period-s", "0.15:0.03"]
        more = ["--skip-clouds", 1]
        said, _ = run(*command, *more, "-o", folder / "one", "--threads", 1)
        assert "the shell is fitted" in said, said
        # A scene that has a camera, as those to train in, and clouds that are not that camera's.
        watched = folder / "watched.txtpb"
        watched.write_text(believed.read_text() + "camera { position_m { x: 0.45 y: 0.1 z: 0.5 } axis { z: -1 } up { y: 1 } far_m: 1 }\n")
        (folder / "watched.prior.txtpb").write_text(PRIORS)
        run(*(watched if word == believed else word for word in command), *more, "-o", folder / "two", "--threads", 2, "--fused")
        assert (folder / "one" / "scene.prior.txtpb").read_bytes() == (folder / "two" / "scene.prior.txtpb").read_bytes()
        assert same_but_time(folder / "one" / "calibration.json", folder / "two" / "calibration.json")
        found = json.loads((folder / "one" / "calibration.json").read_text())
        assert found["method"] == "shell"
        for number, value in TRUTH.items():
            n = small.number(found, number)
            print(f"# {number} {n['value']:.5g} ({n['low90']:.5g} - {n['high90']:.5g}), true {value:.5g}, believed {n['prior']['value']:.5g}")
        for number, value in TRUTH.items():
            n = small.number(found, number)
            assert small.is_inside(found, number, value), n
            assert n["high90"] - n["low90"] < 0.5 * (n["prior"]["high90"] - n["prior"]["low90"]), n
        for row in found["fit"]:
            print(f"# {row}")
            assert row["rmse_model"] < 1.5 * NOISE < row["rmse_base"] and row["far"] == 0, row
        assert {row["role"] for row in found["fit"]} == {"fitted", "held_out"}
        # What was fitted stands in the scene.
        scene_out = (folder / "one" / "scene.txtpb").read_text()
        assert f"pitch_m: {small.number(found, 'scene.tissue.grid.pitch_m')['value']:.6g}"[:16] in scene_out, scene_out

        def refused(*words):
            """The refusal, behind what is warned of: that is told before anything is simulated."""
            _, error = run(*command[:-2], *words, "-o", folder / "refused", code=2)
            return "".join(line for line in error.splitlines(keepends=True) if not line.startswith("warning: "))

        for period in ("0:0.1", "-1:0.1", "0.3", "0.3:0", "a:b"):
            error = refused(f"--frame-period-s={period}")
            assert f"--frame-period-s: {period}, needed SECONDS:STANDARD_DEVIATION" in error and error.count("\n") == 1, error
        error = refused("--method", "reference", "--frame-period-s", "0.15:0.03")
        assert "--frame-period-s: of --method shell alone" in error, error
        error = refused("--frame-period-s", "0.15:0.03", "--skip-clouds", FRAMES)
        assert "of which 13 are skipped: none is left" in error, error
        (folder / "believed.prior.txtpb").write_text('prior { path: "scene.tissue.grid.pich_m" sd: 0.1 }\n')
        error = refused("--frame-period-s", "0.15:0.03")
        assert "scene.tissue.grid.pich_m: no number of a scene" in error and error.count("\n") == 1, error


if __name__ == "__main__":
    main()

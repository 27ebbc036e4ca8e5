#!/usr/bin/env python3
"""mismatch simulate --columns: columns.npz as numpy reads it, against differences of runs of the program; several
recordings at a time.

usage: columns_program_test.py MISMATCH
"""
import pathlib
import sys
import tempfile

import numpy as np

from simulate_program import SCENE, markers, run, write_lift

# Name, what a scene with the difference is, the difference, largest relative error.
DIFFERENCES = [
    ("young_modulus", "scene.tissue.material.young_modulus_pa={}", (59400, 60600), 1200, 0.01),
    ("poisson.nu", "scene.tissue.material.poisson_ratio={}", (0.447, 0.453), 0.006, 0.03),
    ("density.factor", "scene.tissue.effects.density_change={}", (-0.01, 0.01), 0.02, 0.01),
    ("bending_stiffness.factor", "scene.tissue.effects.bending_change={}", (-0.01, 0.01), 0.02, 0.02),
    ("thickness", "scene.tissue.thickness_m={};scene.tissue.pose.translation_m.z={half};scene.tissue.reference.graded_thickness_m=0.003",
     (0.00297, 0.00303), 6e-5, 0.01),
    ("viscoelastic.g@tau=0.3", "scene.tissue.effects.viscoelastic={{ share: {} time_s: 0.3 }}", (0, 0.01), 0.01, 0.05),
    ("grasp_offset.x", "scene.tissue.effects.grasp_offset.x_m={}", (-2e-5, 2e-5), 4e-5, 0.01),
    ("actuation_delay.tau", "scene.arm.transport_delay_s={}", (0, 5e-4), 5e-4, 0.02),
    ("tool_compliance.C_z", "scene.arm.tip_compliance.z={}", (0, 1e-4), 1e-4, 0.05),
    ("contact_stiffness", "scene.tissue.reference.contact_stiffness_pa_per_m={}", (1.6e8, 2.4e8), 8e7, 0.05),
]


def check_differences(program, folder):
    names = [row[0] for row in DIFFERENCES]
    run(program, folder, "base", ["--columns", ",".join(names)])
    data = np.load(folder / "base" / "columns.npz")
    assert sorted(data) == ["force", "names", "t_s", "units", "upper", "uv_B"], sorted(data)
    assert list(data["names"]) == names and data["units"][0] == "Pa", data["names"]
    assert data["upper"].shape == (len(names), len(data["t_s"]), 256, 3) and data["uv_B"].shape == (256, 2)
    times, base = markers(folder / "base")
    frames = [int(np.argmin(abs(times - t))) for t in data["t_s"]]
    for k, (name, change, values, step, bound) in enumerate(DIFFERENCES):
        sides = []
        for side, value in enumerate(values):
            if value == 0:
                sides.append(base)
                continue
            sets = change.format(value, half=value / 2).split(";")
            run(program, folder, f"{k}_{side}", [word for s in sets for word in ("--set", s)])
            sides.append(markers(folder / f"{k}_{side}")[1])
        difference = (sides[1] - sides[0])[frames] / step
        error = np.linalg.norm(data["upper"][k] - difference) / np.linalg.norm(difference)
        print(f"# {name:26s} {100 * error:.3f} %")
        assert error < bound, (name, error)


def check_refusals(program, folder):
    for columns, said in (
        ("colour", "colour: no parameter of that name"),
        ("obstacle.radius", "obstacle.radius has no column: the scene has no obstacle"),
        ("obstacle.stiffness@r=0", "r must be above 0"),
        ("inclusion[0].x", "inclusion[0].x: no parameter of that name"),
        ("poisson.nu,poisson.nu", "poisson.nu is named twice"),
        ("viscoelastic.g@time=1", 'viscoelastic.g: "time=1", allowed key=value with a number and a key of: tau'),
        ("viscoelastic.g@tau=x", 'viscoelastic.g: "tau=x"'),
        ("inclusion.k@r=0", "r must be above 0"),
    ):
        error = run(program, folder, "refused", ["--columns", columns], code=2)
        assert said in error.splitlines()[-1], (columns, error)
    error = run(program, folder, "refused", ["--columns", "poisson.nu", "--model", "elastic", "--set", "scene.tissue.material.law=LAW_COROTATED"], code=2)
    assert "--columns: the tissue is not TISSUE_REFERENCE" in error, error


def check_several(program, folder):
    """Recordings side by side: the same bytes on any number of threads; one that fails leaves what there is of it."""
    write_lift(folder / "low", 0.01)
    write_lift(folder / "torn", 0.02, jump=1)
    every = ("commands", "low", "torn")
    columns = ["--columns", "young_modulus,density.factor"]
    for threads in (1, 3):
        run(program, folder, f"on{threads}", [*columns, "--threads", threads], code=1, commands=every)
    files = sorted(f.relative_to(folder / "on1") for f in (folder / "on1").rglob("*") if f.is_file())
    assert files == sorted(f.relative_to(folder / "on3") for f in (folder / "on3").rglob("*") if f.is_file())
    assert len(files) > 3 * 5, files
    for file in files:
        assert (folder / "on1" / file).read_bytes() == (folder / "on3" / file).read_bytes(), file
    assert "incomplete" not in (folder / "on1" / "low" / "recording.txtpb").read_text()
    said = (folder / "on1" / "torn" / "recording.txtpb").read_text()
    assert "incomplete:" in said and "the tissue fails under the commands at 0.4 s: Newton" in said, said
    data = np.load(folder / "on1" / "torn" / "columns.npz")
    ended = np.isnan(data["t_s"])
    assert 0 < ended.sum() < len(ended) and np.isfinite(data["upper"][:, ~ended]).all(), data["t_s"]
    error = run(program, folder, "same", [], code=2, commands=("low", "low"))
    assert "low has no name of its own" in error, error


def check_rates(program, folder):
    """A recording is simulated at its own rate; the motion does not depend on it."""
    (folder / "low" / "recording.txtpb").write_text("tool_rate_hz: 100\n")
    run(program, folder, "fast", [], commands=("low",))
    run(program, folder, "slow", ["--rate", "50"], commands=("low",))
    times, fast = markers(folder / "fast")
    slow_times, slow = markers(folder / "slow")
    assert len(times) == 81 and len(slow_times) == 41 and abs(times[1] - 0.01) < 1e-9, (len(times), len(slow_times))
    assert np.abs(slow_times - times[::2]).max() < 1e-9
    distance = np.sqrt(((fast[::2] - slow) ** 2).sum(axis=2).mean(axis=1)).max()
    print(f"# 100 Hz against 50 Hz {1e3 * distance:.4f} mm rms")
    assert distance < 5e-5, distance
    (folder / "low" / "recording.txtpb").write_text("tool_rate_hz: 5\n")
    error = run(program, folder, "refused", [], code=2, commands=("low",))
    assert "5 Hz, allowed 10 ... 1000" in error, error


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "scene.txtpb").write_text(SCENE)
        write_lift(folder / "commands", 0.02)
        check_differences(program, folder)
        check_refusals(program, folder)
        check_several(program, folder)
        check_rates(program, folder)


main()

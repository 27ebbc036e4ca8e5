#!/usr/bin/env python3
"""What no recording can tell apart (docs/mismatch.md 1): effects with equal sums give the same surfaces and parallel
columns. A lift of a hanging sheet, without force.

usage: classes_program_test.py MISMATCH
"""
import pathlib
import sys
import tempfile

import numpy as np

from simulate_program import SCENE, markers, run, write_lift

HANGING = SCENE.replace("half_space: true", "half_space: true pose { translation_m { z: -0.2 } }").replace(
    "z: 0.0005 }", "z: -0.15 }")
RATE = ["--rate", "100"]


def rms_mm(a, b):
    """Of the worst time."""
    return 1e3 * np.sqrt(((a - b) ** 2).sum(axis=2).mean(axis=1)).max()


def cosine(a, b):
    return float(a @ b / np.linalg.norm(a) / np.linalg.norm(b))


def main():
    program = sys.argv[1]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "scene.txtpb").write_text(HANGING)
        write_lift(folder / "aside", 0.01, start=(0, 0, 0.1))
        run(program, folder, "hanging", [], commands=("aside",))
        corner = markers(folder / "hanging")[1][0][14 * 16 + 14]
        write_lift(folder / "commands", 0.02, start=corner, rate=100)

        def surfaces(out, *sets):
            run(program, folder, out, RATE + [word for text in sets for word in ("--set", text)])
            return markers(folder / out)[1]

        give = [f"tool_compliance.C_{axis}" for axis in "xyz"]
        names = ["young_modulus", "density.factor", "actuation_delay.tau", "camera_time_offset.dt",
                 "grasp_compliance.C", *give]
        run(program, folder, "base", RATE + ["--columns", ",".join(names)])
        base = markers(folder / "base")[1]
        data = np.load(folder / "base" / "columns.npz")
        column = {str(n): data["upper"][k].ravel().astype(float) for k, n in enumerate(data["names"])}
        stiff = "scene.tissue.material.young_modulus_pa=72000"
        delayed = surfaces("delayed", "scene.arm.transport_delay_s=0.02")
        classes = {  # cosine of the columns, surfaces with equal sums apart, surfaces without [mm]
            "stiffness / density": (
                -cosine(column["young_modulus"], column["density.factor"]),
                rms_mm(surfaces("heavy", stiff, "scene.tissue.effects.density_change=0.2"), base),
                rms_mm(surfaces("stiff", stiff), base)),
            "latency": (
                cosine(column["actuation_delay.tau"], column["camera_time_offset.dt"]),
                rms_mm(delayed[2:], base[:-2]), rms_mm(delayed, base)),
            "total give": (
                cosine(column["grasp_compliance.C"], sum(column[n] for n in give)),
                rms_mm(surfaces("jaws", "scene.tissue.effects.grasp_compliance_m_per_n=0.002"),
                       surfaces("tool", "scene.arm.tip_compliance={ x: 0.002 y: 0.002 z: 0.002 }")),
                rms_mm(markers(folder / "jaws")[1], base)),
        }
        for group, (parallel, apart, without) in classes.items():
            print(f"# {group:20s} cosine {parallel:.6f}, apart {apart:.4f} mm of {without:.3f} mm")
            assert parallel > 0.999, group
            assert apart < 0.05 and without > 4 * apart, group


main()

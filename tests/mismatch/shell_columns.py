#!/usr/bin/env python3
"""Whether the derivatives of `reference` point where the shell goes: columns against central differences of runs of the
model `elastic`, cosine and ratio of lengths over the upper face, in a lift in the air and one off a board with friction.

/usr/bin/python3 shell_columns.py MISMATCH SCRATCH [NAME ...] [--pitch-mm 3]
"""
import argparse
import pathlib
import re

import numpy as np

from simulate_program import SCENE, markers, run, write_lift

EFFECTS = "scene.tissue.effects."
# Name, what is set, the two values, half their difference in the unit of the column.
DEGREE = np.pi / 180
ROWS = [
    ("young_modulus", "scene.tissue.material.young_modulus_pa={}", (57e3, 63e3), 3e3),
    ("poisson.nu", "scene.tissue.material.poisson_ratio={}", (0.43, 0.47), 0.02),
    ("damping", "scene.tissue.material.damping_per_s={}", (4, 6), 1),
    ("density.factor", EFFECTS + "density_change={}", (-0.05, 0.05), 0.05),
    ("gravity_tilt.tilt_x", EFFECTS + "gravity_tilt_x_deg={}", (-1, 1), DEGREE),
    ("gravity_tilt.tilt_y", EFFECTS + "gravity_tilt_y_deg={}", (-1, 1), DEGREE),
    ("bending_stiffness.factor", EFFECTS + "bending_change={}", (-0.1, 0.1), 0.1),
    ("thickness.a_x", EFFECTS + "thickness.x_per_m={}", (-2, 2), 2),
    ("thickness.a_y", EFFECTS + "thickness.y_per_m={}", (-2, 2), 2),
    ("rest_shape.kappa_x", EFFECTS + "rest_shape.curvature_x_per_m={}", (-1, 1), 1),
    ("rest_shape.kappa_y", EFFECTS + "rest_shape.curvature_y_per_m={}", (-1, 1), 1),
    ("rest_shape.twist", EFFECTS + "rest_shape.twist_per_m={}", (-1, 1), 1),
    ("rest_shape.stretch", EFFECTS + "rest_shape.stretch={}", (-0.01, 0.01), 0.01),
    ("strain_stiffening.c2_over_mu", EFFECTS + "strain_stiffening={}", (0, 0.4), 0.2),
    ("strain_stiffening.b", EFFECTS + "exponential_stiffening={}", (0, 2), 1),
    ("anisotropy.Ef_over_E@angle_deg=30", EFFECTS + "anisotropy={{ fibre_ratio: {} angle_deg: 30 }}", (0, 0.2), 0.1),
    ("viscoelastic.g@tau=0.3", EFFECTS + "viscoelastic={{ share: {} time_s: 0.3 }}", (0, 0.1), 0.05),
    ("structural_damping.eta", EFFECTS + "structural_damping={}", (0, 0.04), 0.02),
    ("plastic_set.Ep_over_E@ey=0.02", EFFECTS + "plastic_set={{ modulus_ratio: {} yield_strain: 0.02 }}", (0, 0.1), 0.05),
    ("mullins.softening@strain=0.05", EFFECTS + "mullins={{ softening: {} strain: 0.05 }}", (0, 0.1), 0.05),
    ("board_friction.factor", EFFECTS + "friction_change={}", (-0.1, 0.1), 0.1),
    ("adhesion.k@break_m=0.002", EFFECTS + "adhesion={{ stiffness_pa_per_m: {} break_m: 0.002 }}", (0, 4e4), 2e4),
    ("suction.c@reach_m=0.001", EFFECTS + "suction={{ drag_pa_s_per_m: {} reach_m: 0.001 }}", (0, 1e3), 500),
    ("grasp_offset.x", EFFECTS + "grasp_offset.x_m={}", (-1e-3, 1e-3), 1e-3),
    ("grasp_offset.y", EFFECTS + "grasp_offset.y_m={}", (-1e-3, 1e-3), 1e-3),
    ("grasp_compliance.C", EFFECTS + "grasp_compliance_m_per_n={}", (0, 4e-3), 2e-3),
    ("grasp_slip.v0", EFFECTS + "grasp_slip={{ speed_m_per_s: {} force_n: 0.1 }}", (0, 1e-3), 5e-4),
    ("jaw_orientation.roll", EFFECTS + "jaw_roll_deg={}", (-3, 3), 3 * DEGREE),
    ("added_mass.m@x=0:y=0.01:r=0.006", EFFECTS + "added_mass={{ mass_kg: {} x_m: 0 y_m: 0.01 radius_m: 0.006 }}",
     (0, 4e-4), 2e-4),
    ("inclusion.k@x=0:y=0:r=0.008", EFFECTS + "inclusion={{ x_m: 0 y_m: 0 radius_m: 0.008 stiffness_change: {} }}",
     (-0.1, 0.1), 0.1),
    ("air_drag.Cd", EFFECTS + "air_drag={}", (0, 4), 2),
    ("actuation_delay.tau", "scene.arm.transport_delay_s={}", (0, 0.02), 0.01),
    ("tool_compliance.C_z", "scene.arm.tip_compliance.z={}", (0, 4e-3), 2e-3),
    ("tool_backlash.b_z", "scene.arm.tip_backlash.z={}", (0, 2e-3), 1e-3),
]
NEEDS_BOARD = ("board_friction", "adhesion", "suction")
SIDE, THICKNESS = 0.045, 0.003  # [m]
BOARD = 'rigid_body { name: "board" role: ROLE_BOARD half_space: true }\n'


def upper_face(middle, side, slope_x=0, slope_y=0):
    """From the shell's middle surface [frame, place, xyz]: half the thickness along the normals of its grid, with the slopes of
    its map [1/m]."""
    grid = middle.reshape(len(middle), side, side, 3)
    normal = np.cross(np.gradient(grid, axis=1), np.gradient(grid, axis=2))
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    place = SIDE * (np.arange(side) / (side - 1) - 0.5)
    thickness = THICKNESS * (1 + slope_x * place[:, None] + slope_y * place[None, :])
    return (grid + 0.5 * thickness[None, :, :, None] * normal).reshape(middle.shape)


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("scratch", type=pathlib.Path)
    parser.add_argument("names", nargs="*")
    parser.add_argument("--pitch-mm", type=float, default=3)
    args = parser.parse_args()
    side = round(1e3 * SIDE / args.pitch_mm) + 1
    grid = f"grid {{ count_x: {side} count_y: {side} pitch_m: {1e-3 * args.pitch_mm} }}"
    scene = re.sub("grid {.*}", grid, SCENE, count=1)
    elements = [f"scene.tissue.reference.elements_{axis}={side}" for axis in "xy"]
    print("| parameter | lift | step moves the reference, mm rms | cosine | shell over column |\n|---|---|---|---|---|")
    for lift in ("air", "board"):
        rows = [row for row in ROWS if (not args.names or row[0].split("@")[0] in args.names)
                and (lift == "board" or not row[0].startswith(NEEDS_BOARD))]
        folder = args.scratch / lift
        folder.mkdir(parents=True)
        (folder / "scene.txtpb").write_text(scene if lift == "board" else scene.replace(BOARD, ""))
        # Held where the corner at rest is.
        write_lift(folder / "aside", 0.01, start=(0, 0, 0.1))
        run(args.program, folder, "rest", ["--set", *elements], commands=("aside",))
        corner = round(0.9 * (side - 1)) * (side + 1)
        write_lift(folder / "commands", 0.02, start=markers(folder / "rest", side**2)[1][0][corner])
        run(args.program, folder, "reference", ["--set", *elements, "--columns", ",".join(row[0] for row in rows)])
        data = np.load(folder / "reference" / "columns.npz")
        names = list(data["names"])
        for name, change, values, half in rows:
            sides = []
            for k, value in enumerate(values):
                out = f"{name.split('@')[0]}_{k}"
                run(args.program, folder, out, ["--model", "elastic", "--set", change.format(value)])
                times, middle = markers(folder / out, side**2)
                slopes = {"slope_" + name[-1]: value} if name.startswith("thickness.a_") else {}
                sides.append(upper_face(middle, side, **slopes))
            frames = [int(np.argmin(abs(times - t))) for t in data["t_s"]]
            shell = (sides[1] - sides[0])[frames] / (2 * half)
            column = data["upper"][names.index(name)]
            a, b = np.linalg.norm(shell), np.linalg.norm(column)
            rms = 1e3 * 2 * half * b / np.sqrt(column.size / 3)
            print(f"| {name} | {lift} | {rms:.3f} | {(shell * column).sum() / (a * b):.3f} | {a / b:.2f} |", flush=True)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""Prints a table of touches (docs/formats.md 8) as a robot without error makes it whose base stands at --base [m] in W,
unturned: 12 points on a board, every second one on a pin. --error moves what the robot tells, in W [m]: the registration
that is made of the table is then wrong by as much."""
import argparse

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--base", type=float, nargs=3, default=[0.1427, 0.0, 0.1584])
parser.add_argument("--tip-offset", type=float, default=0.0102)
parser.add_argument("--error", type=float, nargs=3, default=[0.0, 0.0, 0.0])
options = parser.parse_args()

print("name,world_x_m,world_y_m,world_z_m,control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z")
for k in range(12):
    point = [-0.075 + 0.05 * (k % 4), -0.08 + 0.08 * (k // 4), 0.04 if k % 2 else 0.0]
    # The tool points straight down: turned by half a turn about x_R.
    tip = [point[i] - options.base[i] + options.error[i] for i in range(3)]
    control = [tip[0], tip[1], tip[2] + options.tip_offset]
    numbers = ",".join(f"{v:.9f}" for v in point + control)
    print(f"point_{k + 1},{numbers},0,1,0,0")

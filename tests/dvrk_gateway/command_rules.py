"""Says of every command that left the gateway whether it was safe: rules and formulas of its own (docs/dvrk.md 1, 7)."""
import json
import math

import gateway_rig as rig

STEP_M, JUMP_M, JAW_STEP = 0.0005, 0.001, 0.04
PERIOD_S = 0.02
UNDER_WAY_S = 2 * PERIOD_S  # a goal may have been made before what the robot said since
ROUNDING = 1e-6
LIMITS = ((-1.588, 1.588), (-0.925025, 0.925025), (0.0, 0.24), (-4.53786, 4.53786), (-1.39626, 1.39626), (-1.39626, 1.39626))
CANNULA_M = 0.045
WRIST_M = 0.0091  # from the wrist-pitch axis to the control point
SHAFT_M = 0.4318 - 0.4162  # insertion less the distance of the wrist-pitch axis


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


def less(a, b, share=1.0):
    return tuple(x - share * y for x, y in zip(a, b))


def unit(a):
    length = math.sqrt(dot(a, a))
    return tuple(x / length for x in a)


def bend(begin, end, about):
    return math.atan2(dot(about, cross(begin, end)), dot(begin, end))


def column(rotation, k):
    return tuple(row[k] for row in rotation)


def joints_of(rotation, p, roll_near):
    """Shaft along the wrist centre, then angles between shaft, wrist-pitch axis and jaw; pi/2 for the robot's 1.5708."""
    yaw_axis = less((0, 0, 0), column(rotation, 0))
    link = unit(less(p, yaw_axis, dot(p, yaw_axis)))
    centre = less(p, link, WRIST_M)
    shaft = unit(centre)
    yaw = math.atan2(centre[0], -centre[2])
    pitch_axis = unit(cross(link, yaw_axis))
    roll = bend((-math.cos(yaw), 0, -math.sin(yaw)), pitch_axis, shaft)
    roll += 2 * math.pi * round((roll_near - roll) / (2 * math.pi))
    return (yaw, -math.asin(shaft[1]), math.sqrt(dot(centre, centre)) + SHAFT_M, roll, bend(shaft, link, pitch_axis),
            bend(link, column(rotation, 2), yaw_axis))


class CommandRules:
    """One gateway. Times in s of any one clock."""

    def __init__(self):
        self.wrong = []
        self.armed_at = None  # the operator asked
        self.forbidden_from = None  # something happened that must have stopped the arm by then
        self.holds = 0  # in a row
        self.goals = []  # (time, control, tip, jaw)
        self.setpoints = []  # (time, position)
        self.goal_count = 0

    def asked_to_arm(self, now):
        self.armed_at, self.forbidden_from = now, None
        self.holds = 0

    def heard(self, payload_by_name, now):
        pose = payload_by_name.get("setpoint_cp")
        if pose and pose.get("Valid"):
            self.setpoints.append((now, pose["Position"]))

    def setpoints_meant(self, now):
        """Those that a goal of this moment may follow: the newest that it must know, and all since."""
        known = [k for k, (heard, _) in enumerate(self.setpoints) if heard <= now - UNDER_WAY_S]
        self.setpoints = self.setpoints[known[-1] if known else 0:]
        return [position for _, position in self.setpoints]

    def judge(self, text, now):
        try:
            said = json.loads(text)
        except ValueError:
            return self.wrong.append("no JSON")
        if len(text) > 1000:
            self.wrong.append("longer than 1000 bytes")
        if said == {"hold": ""}:
            self.holds += 1
            self.goals = []
            if self.holds > 3:
                self.wrong.append("more than three holds")
            return None
        if set(said) != {"servo_cp", "jaw/servo_jp"}:
            return self.wrong.append(f"keys {sorted(said)}")
        self.goal_count += 1
        if said["servo_cp"].get("Velocity") != [0.0] * 3 or said["servo_cp"].get("VelocityAngular") != [0.0] * 3 or \
                said["jaw/servo_jp"].get("Velocity") != [0.0]:
            self.wrong.append("a velocity that is not stated as zero")
        if self.armed_at is None or self.holds:
            self.wrong.append("goal while not armed")
        if self.forbidden_from is not None and now > self.forbidden_from:
            self.wrong.append(f"goal {1e3 * (now - self.forbidden_from):.1f} ms behind the end of its time")
        return self.judge_goal(said["servo_cp"]["Goal"], said["jaw/servo_jp"]["Goal"][0], now)

    def judge_goal(self, goal, jaw, now):
        rotation, p = goal["Rotation"], goal["Translation"]
        rows = [abs(dot(rotation[i], rotation[j]) - (i == j)) for i in range(3) for j in range(3)]
        if max(rows) > 1e-8:
            return self.wrong.append("rotation")
        control = [b + x for b, x in zip(rig.BASE_M, p)]
        tip = [c + rig.TIP_M * z for c, z in zip(control, column(rotation, 2))]
        if any(t < low - ROUNDING or t > high + ROUNDING for t, low, high in zip(tip, *rig.BOX_M)):
            self.wrong.append(f"outside the box: {tip}")
        joints = joints_of(rotation, p, 0.0)
        if any(q < low - 1e-5 or q > high + 1e-5 for q, (low, high) in zip(joints, LIMITS)):
            self.wrong.append(f"joint limit: {joints}")
        if joints[2] - SHAFT_M < CANNULA_M - 1e-5:
            self.wrong.append("cannula")
        meant = self.setpoints_meant(now)
        if meant:
            there = [[b + x for b, x in zip(rig.BASE_M, setpoint["Translation"])] for setpoint in meant]
            if not self.goals:
                turned = column(meant[-1]["Rotation"], 2)
                self.goals.append((now, there[-1], [c + rig.TIP_M * z for c, z in zip(there[-1], turned)], None))
            if min(max(abs(a - b) for a, b in zip(control, at)) for at in there) > JUMP_M + 2 * STEP_M:
                self.wrong.append("jump from the set-point")
        if self.goals:
            _, control_before, tip_before, jaw_before = self.goals[-1]
            moved = max(abs(a - b) for a, b in zip((*control, *tip), (*control_before, *tip_before)))
            if moved > STEP_M + ROUNDING:
                self.wrong.append(f"step of {1e3 * moved:.3f} mm")
            if jaw_before is not None and abs(jaw - jaw_before) > JAW_STEP + 1e-9:
                self.wrong.append("jaw rate")
            begin, _, tip_begin, _ = self.goals[0]
            way = max(abs(a - b) for a, b in zip(tip, tip_begin))
            if way > STEP_M * ((now - begin) / PERIOD_S + 3):
                self.wrong.append(f"{1e3 * way:.2f} mm in {now - begin:.3f} s")
        if not -0.698 <= jaw <= 1.396:
            self.wrong.append("jaw range")
        self.goals.append((now, control, tip, jaw))
        return None

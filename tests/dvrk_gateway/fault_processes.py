#!/usr/bin/env python3
"""Random scripts of faults against running programs: dvrk_gateway, dvrk_double, and between them a network that this script is,
which judges every command. usage: fault_processes.py BIN_DIR SCRIPTS [FIRST]

Prints the reasons that stopped an arm, how long it took from a cause to the first hold, and, last,
scripts=N armed=A unsafe=U reasons=R/T: T counts those that a robot, a network and an operator can cause. Exit code 1 when
U > 0, R < T or A < N / 20.
"""
import concurrent.futures
import ctypes
import json
import os
import pathlib
import random
import re
import select
import signal
import socket
import sys
import tempfile
import time

import gateway_rig as rig
from command_rules import CommandRules

SO_TIMESTAMPNS = 35
PARALLEL = 2
READY_S = 40  # patience
STOP_S = 0.07  # a goal later than this behind its cause is unsafe
LATEST_HOLD_S = 0.05

# What the operator reads, by reason.
TEXTS = {
    "OPERATOR_STOP": "the operator stopped", "TICK_LATE": "the gateway stood still",
    "FOREIGN_SOURCE": "datagrams of another sender", "TIMESTAMP_BACKWARD": "Timestamp went back",
    "STALE": "stands still for|nothing came from the robot",
    "FAULT": "the robot is in FAULT", "NOT_ENABLED": "not ENABLED", "NOT_HOMED": "not homed",
    "BUSY": "busy with a motion", "INVALID": "is not valid", "JOINT_COUNT": "entries, needed",
    "NOT_ORTHONORMAL": "is not orthonormal by", "WRONG_INSTRUMENT": "another instrument or arm",
    "BASE_FRAME": "base frame given", "SETPOINT_APART": "from the last goals",
    "TRACKING": "measured_cp is .* from setpoint_cp", "EFFORT": "effort of", "POLICY_LATE": "no action of the policy",
    "JUMP": "m from setpoint_cp along",
}
# Before arming alone.
WAITING = {"NOTHING_RECEIVED": "no datagram of a robot yet", "OLD_SHAPES": "GetState. alone",
           "STREAM_MISSING": "was never received", "NO_REGISTRATION": "no registration", "IN_CANNULA": "insert the instrument"}


def shift(stream, metres):
    def change(name, payload):
        if name == stream:
            payload["Position"]["Translation"][0] += metres
    return change


def skew(name, payload):
    if name == "setpoint_cp":
        payload["Position"]["Rotation"][0][0] += 1e-3


def seven_joints(name, payload):
    if name == "measured_js":
        payload["Position"] = payload["Velocity"] = payload["Effort"] = [0.0] * 7


def strain(name, payload):
    if name == "measured_js":
        payload["Effort"] = [20.0] * 6


def lag(name, payload):
    if name == "measured_cp":
        payload["Timestamp"] += 1e-4  # read at another moment than the joints
        payload["Position"]["Translation"][1] += 0.008


def thread_stop(pid, stopped):
    """Stops one thread of a child of this process, or lets it go on."""
    libc = ctypes.CDLL(None, use_errno=True)
    libc.ptrace.argtypes = (ctypes.c_long, ctypes.c_long, ctypes.c_void_p, ctypes.c_void_p)
    if stopped:
        libc.ptrace(0x4206, pid, None, None)  # PTRACE_SEIZE
        libc.ptrace(0x4207, pid, None, None)  # PTRACE_INTERRUPT
        os.waitpid(pid, 0x40000000)  # __WALL: until it has stopped
    else:
        libc.ptrace(17, pid, None, None)  # PTRACE_DETACH


# What is done to the arm under way: how, and whether the arm must be held within 50 ms.
FAULTS = {
    "nothing": (lambda s: None, False),
    "theft": (lambda s: s.repeat(0.02, lambda: s.thief.sendto(b"{}", s.robot)), True),
    "restart": (lambda s: s.restart_robot(), True),
    "restart behind one address": (lambda s: s.double.type("restart\n"), True),
    "policy stalls": (lambda s: s.stall_policy(), True),
    "silence": (lambda s: setattr(s, "silent", True), True),
    "second robot": (lambda s: s.thief.sendto(b"{}", s.gateway_address), True),
    "operator stops by signal": (lambda s: s.gateway.send(signal.SIGUSR2), True),
    "operator stops by key": (lambda s: s.gateway.type(" "), True),
    "gateway stands still": (lambda s: s.freeze_gateway(), False),
    "fault": (lambda s: s.double.type("fault\n"), False),
    "disabled": (lambda s: s.double.type("disable\n"), False),
    "unhomed": (lambda s: s.double.type("unhome\n"), False),
    "new timestamps": (lambda s: s.double.type("timestamps\n"), False),
    "stream stops": (lambda s: s.double.type("missing measured_cp\n"), False),
    "stream invalid": (lambda s: s.double.type("invalid setpoint_cp\n"), False),
    "stream not finite": (lambda s: s.double.type("not-finite measured_js\n"), False),
    "console moves": (lambda s: s.repeat(0.1, lambda: s.to_robot({"move_jp": {"Goal": [-1, -0.3, 0.15, 0, 0, 0]}})), False),
    "withdrawn": (lambda s: s.withdraw(), False),
    "other instrument": (lambda s: setattr(s, "change", shift("local/measured_cp", 0.05)), False),
    "other base": (lambda s: setattr(s, "change", shift("measured_cp", 0.01)), False),
    "skewed": (lambda s: setattr(s, "change", skew), False),
    "seven joints": (lambda s: setattr(s, "change", seven_joints), False),
    "strained": (lambda s: setattr(s, "change", strain), False),
    "lags": (lambda s: setattr(s, "change", lag), False),
    "set-point jumps": (lambda s: setattr(s, "change", shift("setpoint_cp", 0.006)), False),
    "set-point apart": (lambda s: setattr(s, "change", shift("setpoint_cp", 0.0008)), False),
    "garbage": (lambda s: s.send_garbage(), False),
}
NEVER_ARMED = ("old shapes", "stream missing", "no registration", "in the cannula")


class Script:
    def __init__(self, programs, policy, registration, number, folder):
        self.programs, self.policy, self.registration, self.folder = programs, policy, registration, folder
        self.random = random.Random(number)
        kinds = list(FAULTS) + list(NEVER_ARMED)
        self.kind = kinds[number % len(kinds)]
        self.bad_network = self.kind in FAULTS and self.random.random() < 0.3
        self.rules = CommandRules()
        self.silent, self.change, self.thaw_at = False, None, None
        self.old_sides = []
        self.holds, self.caused_at, self.taken_at = [], None, None
        self.repeated, self.repeat_until = None, 0.0
        self.robot = None

    # --- what is done

    def repeat(self, seconds, what):
        """One datagram alone might be in one period of the robot with a goal, and before it: then it does nothing."""
        self.repeated, self.repeat_until = what, time.time() + seconds

    def to_robot(self, command):
        self.robot_side.sendto(json.dumps(command).encode(), self.robot)

    def withdraw(self):
        at = self.joints
        for depth in (0.13, 0.09, 0.055):
            if depth < at[2]:
                self.to_robot({"servo_jp": {"Goal": [*at[:2], depth, *at[3:]]}})
                time.sleep(0.011)  # each in a period of the robot's own

    def restart_robot(self):
        self.double.end(signal.SIGKILL)
        self.start_double()
        self.other_port()

    def other_port(self):
        """Another process sends from another port; what still goes to the old one is heard."""
        self.old_sides.append(self.gateway_side)
        self.gateway_side = rig.datagram_socket()
        self.gateway_side.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)

    def stall_policy(self):
        thread_stop(self.gateway.process.pid, True)
        self.stalled = True

    def freeze_gateway(self):
        self.gateway.send(signal.SIGSTOP)
        self.thaw_at = time.time() + 0.12

    def send_garbage(self):
        for size in (0, 1, 200, 1400, 60000):
            self.gateway_side.sendto(self.random.randbytes(size), self.gateway_address)

    # --- the network

    def start_double(self):
        options = []
        if self.bad_network:
            options = ["--loss", "0.05", "--duplication", "0.1", "--reordering", "0.1", "--jitter", "0.005", "--seed",
                       str(self.random.randrange(1000))]
        if self.kind == "old shapes":
            options += ["--shape", "2019"]
        if self.kind == "stream missing":
            options += ["--missing", "jaw/measured_js"]
        if self.kind == "in the cannula":
            options += ["--hardware-like"]
        self.double = rig.start_double(self.programs, self.folder, self.robot_side.getsockname()[1], options)

    def carry(self, until):
        """Datagrams both ways until that time; every command is judged."""
        while time.time() < until:
            if self.thaw_at and time.time() > self.thaw_at:
                self.gateway.send(signal.SIGCONT)
                self.thaw_at = None
            if time.time() < self.repeat_until:
                self.repeated()
            gateway_sides = [self.gateway_side, *self.old_sides]
            ready = select.select([self.robot_side, self.thief, *gateway_sides], [], [], 0.002)[0]
            if self.thief in ready:
                self.thief.recv(65536)
                self.taken_at = self.taken_at or time.time()
            if self.robot_side in ready:
                self.from_robot(*self.robot_side.recvfrom(65536))
            for side in gateway_sides:
                if side not in ready:
                    continue
                text, ancillary, _, _ = side.recvmsg(65536, 64)
                seconds, nanoseconds = (int.from_bytes(ancillary[0][2][k:k + 8], "little") for k in (0, 8))
                self.from_gateway(text, seconds + 1e-9 * nanoseconds)

    def from_robot(self, text, robot):
        self.robot = robot
        said = json.loads(text)
        if "measured_js" in said and said["measured_js"]["Valid"]:
            self.joints = said["measured_js"]["Position"]
        if self.change:
            for name, payload in said.items():
                self.change(name, payload)
            text = json.dumps(said).encode()
        self.rules.heard(said, time.time())
        if not self.silent:
            self.gateway_side.sendto(text, self.gateway_address)

    def from_gateway(self, text, at):
        self.rules.judge(text, at)
        if b"hold" in text:
            self.holds.append(at)
        if self.robot:
            self.robot_side.sendto(text, self.robot)

    # --- the script

    def arm(self):
        """Whether the gateway became ready and was armed; by signal or key."""
        deadline = time.time() + READY_S
        while time.time() < deadline:
            self.carry(time.time() + 0.05)
            text = self.gateway.text()
            words = rig.phases(text)
            if words and words[-1] == "active":
                return True
            if words and words[-1] == "ready":
                self.rules.asked_to_arm(time.time())
                self.gateway.type("a") if self.random.random() < 0.5 else self.gateway.send(signal.SIGUSR1)
            if self.kind in NEVER_ARMED and words and words[-1] == "waiting":
                deadline = min(deadline, time.time() + 4)
        return False

    def run(self):
        self.robot_side, self.gateway_side, self.thief = (rig.datagram_socket() for _ in range(3))
        self.gateway_side.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.gateway_address = ("127.0.0.1", rig.free_port())
        self.stalled = False
        rig.raise_process(0)
        self.start_double()
        try:
            if self.kind in FAULTS:
                self.robot = rig.lead_to_start(self.robot_side)
            registration = None if self.kind == "no registration" else self.registration
            self.gateway = rig.start_gateway(self.programs, self.folder, self.gateway_address[1], self.policy, registration)
            if self.kind in NEVER_ARMED:
                self.begin_silent()
            armed = self.arm()
            if armed and self.kind in FAULTS:
                self.disturb()
            if self.stalled:
                thread_stop(self.gateway.process.pid, False)
            self.gateway.send(signal.SIGTERM)
            self.carry(time.time() + 0.3)
            code = self.gateway.end()
            if code != 1:
                self.rules.wrong.append(f"the gateway ended with code {code}")
        finally:
            for program in (self.double, getattr(self, "gateway", None)):
                if program:
                    program.end(signal.SIGKILL)
        return self.result(armed)

    def begin_silent(self):
        """So that the gateway says that it hears nothing."""
        self.silent = True
        deadline = time.time() + READY_S
        while time.time() < deadline and "listening" not in rig.phases(self.gateway.text()):
            self.carry(time.time() + 0.05)
        self.silent = False

    def disturb(self):
        self.carry(time.time() + self.random.uniform(0.2, 1.2))
        stopped_before = "stopped:" in self.gateway.text()
        self.holds = []
        how, at_once = FAULTS[self.kind]
        self.caused_at = time.time()
        how(self)
        if at_once:
            self.rules.forbidden_from = self.caused_at + STOP_S
        if stopped_before:
            self.caused_at = None  # a stream that the network lost for too long
        self.carry(time.time() + 1.0)

    def result(self, armed):
        text = self.gateway.text()
        stops = [line for line in text.splitlines() if line.startswith("stopped:")]
        reasons = [name for name, words in TEXTS.items() if any(re.search(words, line) for line in stops)]
        reasons += [name for name, words in WAITING.items() if re.search(words, text)]
        # A stream is taken once the robot sends to the thief: its goals and the gateway's compete for it until then.
        begin = self.caused_at and (self.taken_at or self.caused_at)
        held = self.holds[0] - begin if self.holds and begin else None
        return {"kind": self.kind, "armed": armed, "wrong": self.rules.wrong, "reasons": reasons, "held_s": held,
                "goals": self.rules.goal_count}


def run_script(arguments):
    programs, policy, registration, number = arguments
    with tempfile.TemporaryDirectory() as scratch:
        try:
            return number, Script(programs, policy, registration, number, pathlib.Path(scratch)).run()
        except (RuntimeError, OSError) as error:
            return number, {"kind": "broken", "armed": False, "wrong": [str(error)], "reasons": [], "held_s": None,
                            "goals": 0}


def main():
    programs = rig.programs_folder(pathlib.Path(sys.argv[1]))
    count, first = int(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0
    reasons, held, armed, unsafe, goals = {}, {}, 0, 0, 0
    with tempfile.TemporaryDirectory() as scratch:
        policy = rig.make_policy(programs, pathlib.Path(scratch), 1 + os.getpid() % 200)
        registration = rig.make_registration(programs, pathlib.Path(scratch), policy)
        with concurrent.futures.ProcessPoolExecutor(PARALLEL) as pool:
            for number, result in pool.map(run_script, [(programs, policy, registration, first + n) for n in range(count)]):
                armed += result["armed"]
                goals += result["goals"]
                if result["wrong"]:
                    unsafe += 1
                    print(f"script {number} {result['kind']}: {'; '.join(result['wrong'][:3])}")
                for reason in result["reasons"]:
                    reasons[reason] = reasons.get(reason, 0) + 1
                if result["held_s"] is not None and FAULTS.get(result["kind"], (0, False))[1]:
                    held.setdefault(result["kind"], []).append(1e3 * result["held_s"])
    known = list(TEXTS) + list(WAITING)
    for name in known:
        print(f"{name:20} {reasons.get(name, 0)}")
    for kind, times in held.items():
        late = sum(t > 1e3 * LATEST_HOLD_S for t in times)
        print(f"held after {kind}: {len(times)} times, up to {max(times):.1f} ms, {late} later than 50 ms")
    # A few scripts cannot have every reason: so many kinds of faults there are.
    needed = len(known) if count >= len(FAULTS) + len(NEVER_ARMED) else 0
    print(f"{goals} goals judged")
    print(f"scripts={count} armed={armed} unsafe={unsafe} reasons={len(reasons)}/{len(known)}")
    return 0 if unsafe == 0 and len(reasons) >= needed and armed * 20 >= count else 1


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""A DDS library of others, with types written by hand as ROS 2 has them, reads what `dvrk_gateway --ros` publishes.

usage: ros_reader.py BIN_DIR     (CYCLONEDDS_URI from `learner --print-dds-env`; Python package cyclonedds)

Starts double and gateway and compares poses and states with what the double says. Exit code 1 with what differs.
"""
import os
import pathlib
import sys
import tempfile
import time
from dataclasses import dataclass

import gateway_rig as rig
from cyclonedds.core import Policy, Qos
from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.idl.annotations import final
from cyclonedds.idl.types import float64, int32, uint32
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

PATIENCE_S = 60
CLOCK_S = 10  # between a stamp and the clock of this process


@final
@dataclass
class Time(IdlStruct, typename="builtin_interfaces.msg.dds_.Time_"):
    sec: int32
    nanosec: uint32


@final
@dataclass
class Header(IdlStruct, typename="std_msgs.msg.dds_.Header_"):
    stamp: Time
    frame_id: str


@final
@dataclass
class Point(IdlStruct, typename="geometry_msgs.msg.dds_.Point_"):
    x: float64
    y: float64
    z: float64


@final
@dataclass
class Quaternion(IdlStruct, typename="geometry_msgs.msg.dds_.Quaternion_"):
    x: float64
    y: float64
    z: float64
    w: float64


@final
@dataclass
class Pose(IdlStruct, typename="geometry_msgs.msg.dds_.Pose_"):
    position: Point
    orientation: Quaternion


@final
@dataclass
class PoseStamped(IdlStruct, typename="geometry_msgs.msg.dds_.PoseStamped_"):
    header: Header
    pose: Pose


@final
@dataclass
class OperatingState(IdlStruct, typename="crtk_msgs.msg.dds_.OperatingState_"):
    header: Header
    state: str
    is_homed: bool
    is_busy: bool


def reader_of(participant, name, kind):
    qos = Qos(Policy.Reliability.Reliable(duration(seconds=1)), Policy.Durability.Volatile, Policy.History.KeepLast(1))
    return DataReader(participant, Topic(participant, name, kind, qos=qos), qos=qos)


def wait_for(reader, what, wanted):
    """The first sample that is wanted; what differs where none is in time."""
    deadline = time.monotonic() + PATIENCE_S
    seen = None
    while time.monotonic() < deadline:
        for sample in reader.take(N=10):
            if hasattr(sample, "header"):  # others say that the writer has gone
                seen = sample
                if wanted(sample):
                    return sample
        time.sleep(0.01)
    raise RuntimeError(f"{what}: the last one is {seen}")


def is_now(header):
    return abs(header.stamp.sec + 1e-9 * header.stamp.nanosec - time.time()) < CLOCK_S


def is_at_start(pose):
    """Of the control point in the arm's frame, with the tool down, where rig.lead_to_start() led it."""
    goal = [p - b for p, b in zip(rig.START_M, rig.BASE_M)]
    goal[2] += rig.TIP_M
    at = (pose.position.x, pose.position.y, pose.position.z)
    q = pose.orientation
    down = abs(abs(q.x) - 0.5 ** 0.5) + abs(abs(q.y) - 0.5 ** 0.5) + abs(q.z) + abs(q.w)
    return max(abs(a - b) for a, b in zip(at, goal)) < 1e-6 and q.x * q.y > 0 and down < 1e-6


def main():
    programs = rig.programs_folder(pathlib.Path(sys.argv[1]))
    domain = 1 + os.getpid() % 90
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch)
        policy = rig.make_policy(programs, folder, domain)
        port = rig.free_port()
        double = rig.start_double(programs, folder, port)
        gateway = None
        try:
            with rig.datagram_socket(port) as link:
                rig.lead_to_start(link)
            gateway = rig.start_gateway(programs, folder, port, policy, None,
                                        ["--run", "policy", "--domain", domain, "--ros", "--arm", "PSM1"])
            participant = DomainParticipant(domain)
            poses = reader_of(participant, "rt/PSM1/measured_cp", PoseStamped)
            states = reader_of(participant, "rt/PSM1/operating_state", OperatingState)
            pose = wait_for(poses, "measured_cp", lambda s: s.header.frame_id == "PSM1_base" and is_at_start(s.pose) and
                            is_now(s.header))
            wait_for(poses, "a newer measured_cp", lambda s: s.header.stamp != pose.header.stamp)
            state = wait_for(states, "operating_state", lambda s: s.state == "ENABLED" and s.is_homed and not s.is_busy and
                             is_now(s.header))
            double.type("fault\n")
            wait_for(states, "operating_state of a fault", lambda s: s.state == "FAULT")
        finally:
            for program in (gateway, double):
                if program:
                    program.end()
    print(f"rt/PSM1/measured_cp {pose.pose.position} in {pose.header.frame_id}, operating_state {state.state}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

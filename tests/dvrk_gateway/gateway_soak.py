#!/usr/bin/env python3
"""The gateway's periods beside busy cores: dvrk_gateway against dvrk_double. usage: gateway_soak.py BIN_DIR SECONDS [RUN]

RUN is the folder of a trained run; without it the policy is that of a few updates. Prints figures as "name value unit" and
what was seen behind #. Exit code 1: a period began more than 5 ms late or was missed, the arm was stopped, the p99 of the
latency is above 2 ms, or memory grew; 77, no verdict, where SCHED_FIFO is not granted or a core stood still for more than
5 ms under a thread of highest priority, as in a virtual machine. With the Python packages mcap and mcap-protobuf-support
each late period of the recording is held against those moments, and one that has none beside it is a verdict.
"""
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import time

try:
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory
except ImportError:
    make_reader = None

import gateway_rig as rig
from machine_watch import MachineWatch, can_watch

ARMED_S = 60  # patience
SETTLED_S = 20  # after which memory must stay as it is
GROWTH_KB = 512
LATE_S, BESIDE_S = 0.005, 0.005


def memory_kb(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1])
    return 0


def figures_of(text):
    """Of what the gateway prints at its end."""
    figures = {}
    found = re.search(r"^periods +(\d+), (\d+) late by more than 5 ms, (\d+) missed", text, re.MULTILINE)
    if not found:
        raise RuntimeError("the gateway printed no times: " + text[-500:])
    figures["periods"], figures["late"], figures["missed"] = (int(g) for g in found.groups())
    for name in ("jitter", "latency", "state age"):
        found = re.search(rf"^{name} +p50 ([0-9.]+) p99 ([0-9.]+) max ([0-9.]+) ms", text, re.MULTILINE)
        for quantile, value in zip(("p50", "p99", "max"), found.groups()):
            figures[f"{name.replace(' ', '_')}_{quantile}"] = float(value)
    return figures


def late_periods(recordings):
    """Due moment and begin [s since 1970] of each late period that was recorded; of missed ones the pause. None without reader."""
    if make_reader is None:
        return None
    late = []
    for path in recordings:
        start, before = 0.0, None
        with open(path, "rb") as file:
            for _, channel, message, sample in make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
                    topics=["/recording", "/latency"]):
                if channel.topic == "/recording":
                    start = 1e-9 * sample.start_unix_ns
                    continue
                at = start + 1e-9 * message.log_time
                if sample.jitter_s > LATE_S:
                    late.append((at - sample.jitter_s, at))
                elif before is not None and sample.period > before[0] + 1:
                    late.append((before[1], at))
                before = sample.period, at
    return late


def beside(span, stalls):
    """Whether the machine stood still for half of a span of time or more."""
    return any(begin < span[1] + BESIDE_S and end > span[0] - BESIDE_S and 2 * (end - begin) > span[1] - span[0]
               for begin, end in stalls)


def attend(gateway, seconds):
    """Arms whenever the gateway is ready. Returns its memory each minute, when it had settled and at the end [kB]."""
    begin = time.monotonic()
    settled = last = memory_kb(gateway.process.pid)
    minutes = []
    while time.monotonic() < begin + seconds:
        time.sleep(0.2)
        if gateway.process.poll() is not None:
            raise RuntimeError("the gateway ended: " + gateway.text()[-500:])
        words = rig.phases(gateway.text())
        if words and words[-1] == "ready":
            gateway.type("a")
        if words and words[-1] == "stopped":
            gateway.type("k")
        if "active" not in words and time.monotonic() > begin + ARMED_S:
            raise RuntimeError("not armed: " + gateway.text()[-500:])
        last = memory_kb(gateway.process.pid)
        if time.monotonic() < begin + min(SETTLED_S, seconds / 2):
            settled = last
        elif time.monotonic() > begin + 60 * (len(minutes) + 1):
            minutes.append(last)
    return minutes, settled, last


def end_by_signal(*_):
    """So that what was started is ended, too."""
    sys.exit(143)


def main():
    signal.signal(signal.SIGTERM, end_by_signal)
    if not can_watch():
        print("gateway_soak.py: SCHED_FIFO is refused here, as in a plain container: neither the gateway keeps its periods beside "
              "busy cores nor can it be seen when the machine itself stands still; run as root with CAP_SYS_NICE, or raise "
              "`ulimit -r` to 95", file=sys.stderr)
        return 77
    programs, seconds = rig.programs_folder(pathlib.Path(sys.argv[1])), float(sys.argv[2])
    busy, gateway = [], None
    with tempfile.TemporaryDirectory() as scratch:
        folder = pathlib.Path(scratch)
        policy = pathlib.Path(sys.argv[3]) if len(sys.argv) > 3 else rig.make_policy(programs, folder, 1 + os.getpid() % 200)
        registration = rig.make_registration(programs, folder, policy)
        port = rig.free_port()
        double = rig.start_double(programs, folder, port)
        try:
            with rig.datagram_socket(port) as link:
                rig.lead_to_start(link)
            gateway = rig.start_gateway(programs, folder, port, policy, registration)
            for _ in range(os.cpu_count() or 1):
                # Even where this program is killed they do not go on.
                busy.append(subprocess.Popen(["setpriv", "--pdeathsig", "KILL", "nice", "-n", "19", "sh", "-c",
                                              "while :; do :; done"]))
            machine = MachineWatch()
            minutes, settled, last = attend(gateway, seconds)
            gateway.end()
            stalls = machine.end()
        finally:
            for process in busy:
                process.kill()
                process.wait()
            if gateway:
                gateway.end()
            double.end()
        text = gateway.text()
        late = late_periods(sorted(folder.glob("recordings-*/*.mcap")))
    figures = figures_of(text)
    stops = rig.phases(text).count("stopped")
    print(f"gateway.latency_p99_ms {figures['latency_p99']} ms # p50 {figures['latency_p50']} max {figures['latency_max']}")
    print(f"gateway.jitter_p99_ms {figures['jitter_p99']} ms # p50 {figures['jitter_p50']} max {figures['jitter_max']}")
    print(f"gateway.missed_ticks {figures['late'] + figures['missed']} ticks # of {figures['periods']}, "
          f"{figures['late']} late by more than 5 ms")
    print(f"gateway.state_age_p99_ms {figures['state_age_p99']} ms # p50 {figures['state_age_p50']} "
          f"max {figures['state_age_max']}")
    long_ms = [1e3 * (end - begin) for begin, end in stalls if end - begin > LATE_S]
    print(f"gateway.machine_stood_still {len(long_ms)} times # a core for more than 5 ms, up to {max(long_ms, default=0.0):.1f} ms")
    own = [span for span in late or [] if not beside(span, stalls)]
    if late is not None:
        print(f"gateway.late_of_its_own {len(own)} periods # of {len(late)} late or missed; beside the others the machine stood still")
        for begin, end in own[:20]:
            print(f"# late of its own: {1e3 * (end - begin):.1f} ms at {time.strftime('%H:%M:%S', time.gmtime(end))}")
    print(f"# memory {settled} kB, each minute {' '.join(map(str, minutes))}, at the end {last} kB; "
          f"{text.count('episode ')} episodes, {stops} stops")
    told = [re.sub(r"[0-9][0-9.]*", "#", line) for line in text.splitlines() if line.startswith("stopped:") or "warn" in line]
    for line in sorted(set(told)):
        print(f"# {told.count(line)} x {line}")
    if last - settled > GROWTH_KB or own:
        return 1
    if figures["late"] + figures["missed"] == 0 and stops <= 0 and figures["latency_p99"] <= 2:
        return 0
    return 77 if "SCHED_FIFO was refused" in text or long_ms else 1


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""A training while somebody forges the protocol below DDS (forger.py): it goes on, and ends with the weights of an
undisturbed one. usage: forged_run.py BIN_DIR [--secured MAKE_SH] [--replay] [--seconds S] [--seed N]

The undisturbed training tells how many updates outlast the forgery on this machine. Prints how long after the last
forged datagram the next update came. Exit code 1: later than 15 s, or other weights; 77: --replay
without the right to hear the loopback interface (CAP_NET_RAW).
"""
import argparse
import json
import pathlib
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time

from sequences import TASK, Domain, Program

HERE = pathlib.Path(__file__).resolve().parent
AGAIN_S = 15
FEWEST_UPDATES = 60
PATIENCE_S = 240
SKIPPED = 77


class Run:
    """A learner and two workers."""

    def __init__(self, options, folder, domain, name, updates):
        sets = TASK | {"rollout.run_seed": options.seed, "run.runs_dir": folder, "run.domain": domain, "rollout.max_steps": updates * 192}
        secured = lambda role: ["--security-dir", folder / "keys" / role] if options.secured else []
        arguments = [options.bin / "learner", "--run", name, *secured("learner")]
        for knob, value in sets.items():
            arguments += ["--set", f"{knob}={value}"]
        self.summary = folder / name / "summary.json"
        self.learner = Program(f"{name}-learner", [str(a) for a in arguments], folder)
        self.workers = [Program(f"{name}-worker{i}", [str(a) for a in [options.bin / "sim_worker", "--run", name, "--domain",
                                                                     domain, "--lanes", "6", *secured("worker")]], folder)
                        for i in range(2)]

    def updates(self):
        found = re.findall(r"^update (\d+)/", self.learner.text(), re.M)
        return int(found[-1]) if found else 0

    def wait(self, done, what):
        began = time.monotonic()
        while not done():
            if not self.learner.alive():
                raise RuntimeError(f"the learner ended with {self.learner.process.returncode} while {what}: "
                                   + self.learner.text()[-800:])
            if time.monotonic() - began > PATIENCE_S:
                raise RuntimeError(f"{what}: not within {PATIENCE_S} s: " + self.learner.text()[-800:])
            time.sleep(0.05)
        return time.monotonic() - began

    def finish(self):
        self.learner.process.wait(PATIENCE_S)
        if self.learner.process.returncode != 0:
            raise RuntimeError(f"exit code {self.learner.process.returncode}: {self.learner.text()[-800:]}")
        return json.loads(self.summary.read_text())["weights_hash"]

    def end(self):
        for program in [self.learner, *self.workers]:
            program.end()


def calm_run(options, domain, folder, runs):
    """The weights of an undisturbed training that lasts twice as long as the forgery, and its number of updates."""
    updates = FEWEST_UPDATES
    while True:
        runs.append(run := Run(options, folder, domain, f"calm{updates}", updates))
        run.wait(lambda: run.updates() >= 2, "the calm run begins")
        began = time.monotonic()
        weights = run.finish()
        lasted_s = time.monotonic() - began
        run.end()
        if lasted_s > 2 * options.seconds:
            return weights, updates
        updates *= 4


def may_listen():
    try:
        socket.socket(socket.AF_PACKET, socket.SOCK_RAW).close()
    except PermissionError:
        return False
    return True


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--secured", type=pathlib.Path)
    parser.add_argument("--replay", action="store_true")
    parser.add_argument("--seconds", type=float, default=3)
    parser.add_argument("--seed", type=int, default=11, help="of the training and of what is forged")
    options = parser.parse_args()
    if options.replay and not may_listen():
        print("skipped: raw sockets are not allowed to this user")
        sys.exit(SKIPPED)
    domain = Domain()
    folder = pathlib.Path(tempfile.mkdtemp(prefix="omentum-forged-"))
    if options.secured:
        subprocess.run([options.secured, "--out", folder / "keys", "--role", "learner", "--role", "worker"], check=True,
                       stdout=subprocess.DEVNULL)
    runs = []
    try:
        calm, updates = calm_run(options, domain.number, folder, runs)
        runs.append(run := Run(options, folder, domain.number, "forged", updates))
        run.wait(lambda: run.updates() >= 2, "it begins")
        forger = subprocess.run([sys.executable, HERE / "forger.py", str(domain.number), str(options.seconds), str(options.seed)]
                                + (["--replay"] if options.replay else []), check=False, stdout=subprocess.PIPE, text=True)
        before = run.updates()
        again = run.wait(lambda: run.updates() > before or run.summary.exists(), "it goes on")
        forged = run.finish()
        rejoins = sum(worker.text().count("event=rejoin ") for worker in run.workers)
        print(f"{forger.stdout.strip()} update={before} again_s={again:.1f} rejoins={rejoins} "
              f"{'same' if calm == forged else 'OTHER'} weights")
        if forger.returncode != 0 or calm != forged or again > AGAIN_S:
            raise RuntimeError("no other participants were found" if forger.returncode else "a promise was broken")
    except (RuntimeError, subprocess.TimeoutExpired) as reason:
        print(f"BROKEN: {reason} (logs in {folder})")
        sys.exit(1)
    finally:
        for run in runs:
            run.end()
    shutil.rmtree(folder)


if __name__ == "__main__":
    main()

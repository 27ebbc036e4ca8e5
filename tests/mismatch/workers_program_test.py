#!/usr/bin/env python3
"""`mismatch simulate` and `mismatch calibrate` on the workers of a run, over real DDS between real processes: with one after
another one was killed over its work every file is the one of a run without workers, but for the time it took.

usage: workers_program_test.py MISMATCH SIM_WORKER [--long]    --long: with two workers that live, simulations, and by the shell
"""
import contextlib
import fcntl
import os
import pathlib
import re
import signal
import subprocess
import sys
import tempfile
import threading
import time

import free_sheet_program_test as free
import small_lifts as small

TRUTH = {"scene.tissue.material.young_modulus_pa": 42e3, "scene.depth_sensor.registration_m.z": 0.0015}
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007))
QUICK = ("--tolerance-mm", "6", "--no-leave-out")
RUN = "recordings"


@contextlib.contextmanager
def private_domain():
    """A DDS domain that no other test has: tests/support/domain.h, whose locks these are."""
    for k in range(90):
        domain = 1 + (os.getpid() + k) % 90
        lock = open(f"/tmp/omentum_test_domain_{domain}", "a")
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            lock.close()
            continue
        with lock:
            yield domain
        return
    raise RuntimeError("every test domain is taken")


class Worker:
    """A sim_worker; ends with the block."""

    def __init__(self, program, domain):
        self.process = subprocess.Popen([str(program), "--run", RUN, "--domain", str(domain)],
                                        stderr=subprocess.PIPE, text=True)
        self.lines = []
        self.asked = threading.Event()
        self.reader = threading.Thread(target=self.read, daemon=True)
        self.reader.start()

    def read(self):
        for line in self.process.stderr:
            self.lines.append(line)
            if "simulates_for" in line:
                self.asked.set()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGTERM)
        self.process.wait(60)
        self.reader.join(60)

    def did(self):
        """Results that it sent."""
        told = [re.search(r"worker_leaves .* segments=(\d+)", line) for line in self.lines]
        return sum(int(match.group(1)) for match in told if match)


def calibrate(program, folder, out, more):
    command = [program, "calibrate", "--scene", folder / "believed.txtpb", "-r", folder / "lifts", "-o", folder / out, *QUICK,
               *more]
    return subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def finish(process):
    begin = time.monotonic()
    out, err = process.communicate()
    print(f"# {time.monotonic() - begin:.1f} s, {re.search(r'([0-9]+) core-seconds', out).group(1)} core-seconds", flush=True)
    assert process.returncode == 0, err
    assert "simulated here instead" not in err, err
    return err


def finish_plainly(command):
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def without_time(path):
    text = path.read_text()
    assert "core_seconds" in text or path.suffix != ".json"
    return re.sub(r'"core_seconds": [^\n]*', "", text)


def assert_same(folder, one, other):
    for file in ("calibration.json", "scene.txtpb", "scene.prior.txtpb"):
        assert without_time(folder / one / file) == without_time(folder / other / file), (other, file)


def simulate(program, folder, out, more):
    lifts = [folder / "lifts" / f"lift{k}" for k in range(3)]
    command = [program, "simulate", "--scene", folder / "believed.txtpb", "--commands", *lifts, "-o", folder / out,
               "--tolerance-mm", 6, "--set", small.SMOOTH, "--columns", "young_modulus,grasp_offset.x", *more]
    done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert "simulated here instead" not in done.stderr, done.stderr
    return sorted(done.stdout.replace(str(folder / out), "").splitlines())


def calibrate_free_sheet(program, folder, out, more):
    """By the shell (docs/calibrate.md 9)."""
    command = [program, "calibrate", "--scene", folder / "believed.txtpb", "-r", folder / "recordings", "-o", folder / out,
               "--frame-period-s", "0.15:0.03", "--skip-clouds", 1, "--no-leave-out", *more]
    return subprocess.Popen([str(c) for c in command], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def check_two_workers(program, worker, folder, domain):
    """Calibrations by reference and shell and simulations, by workers that live."""
    on_bus = ["--run", RUN, "--domain", domain]
    with Worker(worker, domain) as first, Worker(worker, domain) as second:
        told = finish(calibrate(program, folder, "two", on_bus))
        assert "2 workers," in told, told
        assert_same(folder, "alone", "two")
        alone = simulate(program, folder, "sheets", [])
        assert simulate(program, folder, "sheets_two", on_bus) == alone
        for path in sorted((folder / "sheets").rglob("*.*")):
            other = folder / "sheets_two" / path.relative_to(folder / "sheets")
            assert path.read_bytes() == other.read_bytes(), path
        sheet = folder / "sheet"
        free.record(program, sheet, "lift", 1, False)
        (sheet / "believed.txtpb").write_text(free.scene(**free.BELIEVED))
        (sheet / "believed.prior.txtpb").write_text(free.PRIORS)
        finish(calibrate_free_sheet(program, sheet, "alone", []))
        told = finish(calibrate_free_sheet(program, sheet, "two", on_bus))
        assert "2 workers," in told, told
        assert_same(sheet, "alone", "two")
    assert first.did() > 0 and second.did() > 0, (first.did(), second.did())


def main():
    program, worker = (pathlib.Path(a) for a in sys.argv[1:3])
    with tempfile.TemporaryDirectory() as name, private_domain() as domain:
        folder = pathlib.Path(name)
        small.write_case(program, folder, TRUTH, OFFSETS, seed=1, mesh=("--tolerance-mm", "3"))
        finish(calibrate(program, folder, "alone", []))
        # One dies over its work, and nobody is left; then another one comes and does it all.
        with Worker(worker, domain) as doomed:
            process = calibrate(program, folder, "killed", ["--run", RUN, "--domain", domain])
            assert doomed.asked.wait(60)
            doomed.process.kill()
            doomed.process.wait(60)
            with Worker(worker, domain):
                told = finish(process)
        assert "is lost" in told and "1 worker," in told, told
        assert_same(folder, "alone", "killed")
        if "--long" in sys.argv[3:]:
            check_two_workers(program, worker, folder, domain)


if __name__ == "__main__":
    main()

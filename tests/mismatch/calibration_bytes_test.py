#!/usr/bin/env python3
"""What `mismatch calibrate` and `mismatch simulate --columns` write of three small lifts is byte for byte what is stored in
tests/golden/calibration_bytes.txt: by the reference, the shell and the paper's method, on one thread and on four (recordings
named in reverse), and on a worker of a run.

usage: calibration_bytes_test.py MISMATCH SIM_WORKER STORED [--methods reference,shell,paper] [--ways 1,4,worker]

OMENTUM_WRITE_GOLDEN=1 writes the hashes anew: CHANGELOG tag [BITS].
"""
import argparse
import contextlib
import hashlib
import os
import pathlib
import re
import tempfile

import small_lifts as small
import workers_program_test as workers

METHODS = {"reference": ("--tolerance-mm", "6"), "shell": (), "paper": ()}
TRUTH = {"scene.tissue.material.young_modulus_pa": 42e3, "scene.depth_sensor.registration_m.z": 0.0015}
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007))
COLUMNS = "young_modulus,grasp_offset.x,actuation_delay.tau"


def digest(path):
    content = path.read_bytes()
    if path.name == "calibration.json":  # the time it took is no result
        content, count = re.subn(rb'"core_seconds": [^\n]*', b"", content)
        assert count == 1, path
    return hashlib.sha256(content).hexdigest()[:16]


def digests(folder, names):
    """Of every file of those names, by its path."""
    files = sorted(path for name in names for path in folder.glob(name))
    assert files, (folder, names)
    return {path.relative_to(folder).as_posix(): digest(path) for path in files}


def calibrated(program, folder, out, method, more):
    lifts = sorted((folder / "lifts").iterdir(), reverse="4" in more)  # in any order
    small.calibrate(program, folder, folder / out, ["--method", method, *METHODS[method], *more], lifts)
    return digests(folder / out, ("calibration.json", "scene.txtpb", "scene.prior.txtpb", "left_out/*.txtpb"))


def simulated(program, folder, more):
    command = [program, "simulate", "--scene", folder / "believed.txtpb", "--commands", folder / "lifts" / "lift0", "-o", folder / "sheet",
               "--model", "reference", "--tolerance-mm", 6, "--set", small.SMOOTH, "--columns", COLUMNS, *more]
    workers.finish_plainly(command)
    return digests(folder / "sheet", ("columns.npz", "tool.csv", "markers.csv"))


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("program", type=pathlib.Path)
    parser.add_argument("worker", type=pathlib.Path)
    parser.add_argument("stored", type=pathlib.Path)
    parser.add_argument("--methods", default="reference,shell,paper")
    parser.add_argument("--ways", default="1,4,worker")
    args = parser.parse_args()
    found = {}
    with tempfile.TemporaryDirectory() as name, contextlib.ExitStack() as stack:
        folder = pathlib.Path(name)
        small.write_case(args.program, folder, TRUTH, OFFSETS, seed=1, mesh=("--tolerance-mm", "3"))
        found["columns"] = simulated(args.program, folder, [])
        for way in args.ways.split(","):
            more = ["--threads", way]
            if way == "worker":
                domain = stack.enter_context(workers.private_domain())
                stack.enter_context(workers.Worker(args.worker, domain))
                more = ["--run", workers.RUN, "--domain", domain]
            for method in args.methods.split(","):
                made = calibrated(args.program, folder, f"{method}_{way}", method, more)
                assert found.setdefault(method, made) == made, (method, way)
    lines = [f"{what} {path} {hashed}" for what, files in found.items() for path, hashed in files.items()]
    if os.environ.get("OMENTUM_WRITE_GOLDEN"):
        args.stored.write_text("\n".join(lines) + "\n")
        return
    stored = set(args.stored.read_text().splitlines())
    other = [line for line in lines if line not in stored]
    assert not other, "other bytes than stored:\n" + "\n".join(other)


if __name__ == "__main__":
    main()

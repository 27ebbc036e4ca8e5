#!/usr/bin/env python3
"""`mismatch explain` leaves the same bytes on one thread, on two with the recordings in another order, and on a worker of a run, but for
the time that it took.

usage: explain_bytes_test.py MISMATCH SIM_WORKER
"""
import json
import pathlib
import sys
import tempfile

import poor_recordings_test as poor
import workers_program_test as workers


def written(program, folder, recordings, *more):
    code, told, verdict, _ = poor.explain(program, folder, recordings, more)
    assert code == 0, told
    verdict.pop("core_seconds")
    verdict["warnings"] = [w for w in verdict["warnings"] if not w.startswith("workers")]
    out = folder / "out"
    files = [out / "scene.repaired.txtpb", out / "scene.base.txtpb", *sorted((out / "predictions").iterdir())]
    return {"verdict.json": json.dumps(verdict, sort_keys=True), **{f.name: f.read_bytes() for f in files}}


def main():
    program, sim_worker = (pathlib.Path(p) for p in sys.argv[1:])
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        recordings = poor.write_lifts(program, folder, 2, (0, 0.8))
        made = {"one thread": written(program, folder, recordings, "--threads", 1),
                "two threads": written(program, folder, recordings[::-1], "--threads", 2)}
        with workers.private_domain() as domain, workers.Worker(sim_worker, domain):
            made["a worker"] = written(program, folder, recordings, "--run", workers.RUN, "--domain", domain)
    first = made.pop("one thread")
    for way, files in made.items():
        assert files.keys() == first.keys(), (way, files.keys())
        different = [file for file in files if files[file] != first[file]]
        assert not different, (way, different)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""A training whose n-th write to its folder fails as on a full disk: every file is old, whole, or told.
usage: full_disk_run.py BIN_DIR SHIM.so [WRITES=8]

Of all writes of an undisturbed training so many fail, one in each run, evenly spread and the first and last among them.
After each: exit code 0, or 2 before anything began; weights, policy.onnx and metrics of the undisturbed training, but for
rows whose loss is told; the folder can be gone on from.
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

from sequences import TASK, Domain, Program

UPDATES = 6
PATIENCE_S = 120


class Broken(Exception):
    pass


class Disturbed:
    def __init__(self, bins, shim, folder, domain):
        self.bin, self.shim, self.folder, self.domain = bins, shim, folder, domain

    def train(self, name, failing):
        """Exit code and log of a learner with one worker; its failing-th write fails."""
        folder = self.folder / name
        folder.mkdir(exist_ok=True)
        sets = TASK | {"rollout.run_seed": 11, "run.runs_dir": folder, "run.domain": self.domain.number,
                       "rollout.max_steps": UPDATES * 192}
        arguments = [str(self.bin / "learner"), "--run", "full", "--unsaved-limit", "0"]
        for knob, value in sets.items():
            arguments += ["--set", f"{knob}={value}"]
        environment = {"LD_PRELOAD": str(self.shim), "OMENTUM_FAIL_UNDER": str(folder / "full"),
                       "OMENTUM_FAIL_WRITE": str(failing), "OMENTUM_FAIL_COUNT": str(folder / "count")}
        worker = Program(f"{name}-worker", [str(self.bin / "sim_worker"), "--run", "full", "--domain",
                                           str(self.domain.number), "--lanes", "6"], self.folder)
        try:
            done = subprocess.run(arguments, env=os.environ | environment, capture_output=True, text=True, timeout=PATIENCE_S,
                                  check=False)
        except subprocess.TimeoutExpired:
            raise Broken(f"write {failing}: the learner hangs") from None
        finally:
            worker.end()
        return done.returncode, done.stdout + done.stderr

    def files(self, name):
        folder = self.folder / name / "full"
        rows = (folder / "metrics.csv").read_text().splitlines()[1:]
        lines = (folder / "metrics.jsonl").read_text().splitlines()
        return {"hash": json.loads((folder / "summary.json").read_text())["weights_hash"],
                "policy": (folder / "policy.onnx").read_bytes(),
                "csv": [int(row.split(",")[0]) for row in rows], "jsonl": [json.loads(line)["update"] for line in lines]}


def main():
    bins, shim = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
    count = int(sys.argv[3]) if len(sys.argv) > 3 else 8
    broken = 0
    with tempfile.TemporaryDirectory() as name:
        disturbed = Disturbed(bins, shim, pathlib.Path(name), Domain())
        code, text = disturbed.train("calm", 0)
        if code != 0:
            sys.exit(f"undisturbed: exit code {code}: {text[-500:]}")
        calm = disturbed.files("calm")
        writes = int((disturbed.folder / "calm" / "count").read_text())
        chosen = sorted({1 + round(k * (writes - 1) / max(1, count - 1)) for k in range(count)})
        print(f"{writes} writes, of which fail {chosen}", flush=True)
        for failing in chosen:
            try:
                code, text = disturbed.train(f"w{failing}", failing)
                if code == 2:
                    if "No space left" not in text:
                        raise Broken(f"refused without the reason: {text[-300:]}")
                    code, text = disturbed.train(f"w{failing}", 0)  # what a supervisor does
                if code != 0:
                    raise Broken(f"exit code {code}: {text[-300:]}")
                left = disturbed.files(f"w{failing}")
                for what in ("hash", "policy"):
                    if left[what] != calm[what]:
                        raise Broken(f"another {what}")
                for what in ("csv", "jsonl"):
                    if left[what] != calm[what] and "metrics_incomplete" not in text:
                        raise Broken(f"metrics.{what} holds updates {left[what]}, and nobody says so")
                code, text = disturbed.train(f"w{failing}", 0)
                if code != 0 or "update " in text:
                    raise Broken(f"the finished run cannot be loaded: exit code {code}: {text[-300:]}")
            except Broken as reason:
                broken += 1
                print(f"write {failing}: BROKEN: {reason}", flush=True)
    print(f"{len(chosen) - broken} held, {broken} broken")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()

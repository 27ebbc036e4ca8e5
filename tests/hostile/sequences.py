#!/usr/bin/env python3
"""Random sequences of start, stop, kill -9, restart, deleted folder, full disk, second start, foreign writer, flood of
made-up workers, forged RTPS, second learner in another folder and a pipe in the place of a file on real processes. usage: sequences.py BIN_DIR SEQUENCES FIRST_SEED

Promises that every sequence is held to:
  - nothing is silent for more than 30 s while there is work and somebody to do it;
  - a learner beside another of the same run is refused (exit code 2), also one of another folder, and the first goes on;
  - a pipe in the place of a file is refused at once;
  - exit code 0 means that the last checkpoint and policy.onnx are there, and that the run can be loaded;
  - no checkpoint of another configuration lies in the folder of a run;
  - the weights are those of an undisturbed training of the same configuration.
"""
import fcntl
import json
import os
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

SILENCE_S = 30
UPDATES = 12
RUN = "hostile"
DISK_BYTES = 24 << 20

# Two configurations: --restart goes from one to the other.
TASK = {
    "scene.tissue.grid.count_x": 12, "scene.tissue.grid.count_y": 12, "scene.tissue.anchor_max_y_m": -0.014,
    "task.episode_steps": 60, "rollout.slots": 6, "rollout.steps_per_segment": 32, "rollout.max_steps": UPDATES * 192,
    "ppo.hidden": 16, "ppo.minibatch": 64, "ppo.epochs": 2, "evaluation.enabled": "false", "run.checkpoint_interval_s": 0,
}
SEEDS = (11, 12)


class Broken(Exception):
    pass


class Program:
    """A process with its output in one file."""

    def __init__(self, name, arguments, folder):
        self.name, self.log = name, folder / f"{name}.log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen(arguments, stdout=log, stderr=subprocess.STDOUT)

    def alive(self):
        return self.process.poll() is None

    def kill(self, how):
        if self.alive():
            self.process.send_signal(how)

    def end(self):
        self.kill(signal.SIGKILL)
        self.process.wait()

    def text(self):
        return self.log.read_text(errors="replace")


class Disk:
    """A small file system of its own where that is allowed; without, a full disk is not tried."""

    def __init__(self, path):
        self.path, self.ballast = path, path / "ballast"
        path.mkdir()
        mount = ["mount", "-t", "tmpfs", "-o", f"size={DISK_BYTES}", "tmpfs", str(path)]
        self.own = subprocess.run(mount, stderr=subprocess.DEVNULL, check=False).returncode == 0

    def fill(self):
        if not self.own:
            return
        with open(self.ballast, "wb", buffering=0) as file:
            try:
                while True:
                    file.write(bytes(4096))
            except OSError:
                pass

    def free(self):
        self.ballast.unlink(missing_ok=True)

    def remove(self):
        if self.own:
            subprocess.run(["umount", "-l", str(self.path)], check=True)


class Domain:
    """A DDS domain that no other test uses (tests/support/domain.h)."""

    def __init__(self):
        for number in range(1, 91):
            self.lock = open(f"/tmp/omentum_test_domain_{number}", "w")
            try:
                fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.number = number
                return
            except OSError:
                self.lock.close()
        raise Broken("every test domain is taken")


class Sequence:
    def __init__(self, programs, seed, hashes, folder, domain):
        self.bin, self.random, self.hashes = programs, random.Random(seed), hashes
        self.folder, self.domain = folder, domain
        self.disk = Disk(folder / "disk")
        self.run_dir = self.disk.path / RUN
        self.seed = SEEDS[0]
        self.programs, self.told = [], []
        self.learner = self.stranger = self.flood = None

    # --- what is done

    def start(self, name, arguments):
        program = Program(f"{len(self.programs):02}-{name}", arguments, self.folder)
        self.programs.append(program)
        return program

    def learner_arguments(self, seed, more=(), sets=None):
        sets = TASK | {"rollout.run_seed": seed, "run.runs_dir": self.disk.path, "run.domain": self.domain} | (sets or {})
        arguments = [self.bin / "learner", "--run", RUN, *more]
        for knob, value in sets.items():
            arguments += ["--set", f"{knob}={value}"]
        return arguments

    def start_learner(self):
        if not self.learner or not self.learner.alive():
            self.check_ended()
            # The folder was deleted under workers that remember its run: said once, then begun anew.
            anew = self.learner and "--restart begins anew" in self.learner.text()
            self.learner = self.start("learner", self.learner_arguments(self.seed, ["--restart"] if anew else []))

    def restart(self):
        """With either configuration; beside a live learner it is refused."""
        seed = self.random.choice(SEEDS)
        program = self.start("restart", self.learner_arguments(seed, ["--restart"]))
        if self.learner and self.learner.alive():
            self.expect_refused(program)
        else:
            self.check_ended()
            self.learner, self.seed = program, seed

    def second_start(self):
        if self.learner and self.learner.alive() and "run=" in self.learner.text():
            self.expect_refused(self.start("second", self.learner_arguments(self.random.choice(SEEDS))))

    def expect_refused(self, program):
        first = self.learner
        try:
            code = program.process.wait(SILENCE_S)
        except subprocess.TimeoutExpired:
            raise Broken(f"{program.name} beside another learner does not end") from None
        # The first may have ended in between; then the second owned the folder, or waits for it.
        if code == 2 and ("in use by" in program.text() or "another configuration" in program.text()):
            return
        if not first.alive():
            self.learner = program
            return
        raise Broken(f"{program.name} beside another learner: exit code {code}")

    def start_worker(self):
        if len(self.workers()) < 3:
            self.start("worker", [self.bin / "sim_worker", "--run", RUN, "--domain", str(self.domain), "--lanes", "6"])

    def workers(self):
        return [p for p in self.programs if p.name.endswith("worker") and p.alive()]

    def stop_worker(self):
        if self.workers():
            self.random.choice(self.workers()).kill(self.random.choice([signal.SIGTERM, signal.SIGKILL]))

    def stop_learner(self):
        if self.learner:
            self.learner.kill(signal.SIGTERM)
            self.wait_for_end()

    def kill_learner(self):
        if self.learner:
            self.learner.kill(signal.SIGKILL)
            self.learner.process.wait()

    def delete_folder(self):
        shutil.rmtree(self.run_dir, ignore_errors=True)

    def fill_disk(self):
        self.disk.fill()

    def free_disk(self):
        self.disk.free()

    def foreign_writer(self):
        if self.stranger and self.stranger.alive():
            self.stranger.end()
        else:
            self.stranger = self.start("stranger", [self.bin / "dds_stranger", RUN, str(self.domain)])

    def flood_of_workers(self):
        if self.flood and self.flood.alive():
            self.flood.end()
        else:
            self.flood = self.start("flood-stranger", [self.bin / "dds_stranger", RUN, str(self.domain), "workers"])

    def forge_rtps(self):
        forger = pathlib.Path(__file__).with_name("forger.py")
        self.start("forger-stranger", [sys.executable, forger, str(self.domain), "2"])

    def learner_elsewhere(self):
        """Of the same run in another folder, beside one that trains."""
        first = self.learner
        if not first or not first.alive() or "update " not in first.text() or self.is_forged():
            return
        elsewhere = self.folder / f"elsewhere{len(self.programs)}"
        sets = {"run.runs_dir": elsewhere}
        second = self.start("elsewhere", self.learner_arguments(self.seed, sets=sets))
        try:
            code = second.process.wait(SILENCE_S)
        except subprocess.TimeoutExpired:
            code = None
        if code == 2 and "trains already" in second.text():
            if not first.alive() and "this one stops" in first.text():
                raise Broken(f"{first.name} ended for {second.name}, which ended too")
            return
        second.end()
        if first.alive():  # else there was none to hear any more
            raise Broken(f"{second.name} beside another learner: exit code {code}")

    def is_forged(self):
        return any(p.name.endswith("forger-stranger") and p.alive() for p in self.programs)

    def pipe(self):
        path = self.folder / f"pipe{len(self.programs)}"
        os.mkfifo(path)
        for arguments in ([self.bin / "learner", "--run", "piped", "--set", f"run.runs_dir={self.folder}", "--initialise-from",
                           path], [self.bin / "sim_worker", "--check-config", path]):
            program = self.start("pipe", arguments)
            try:
                code = program.process.wait(SILENCE_S)
            except subprocess.TimeoutExpired:
                raise Broken(f"{program.name} waits for a pipe") from None
            if code != 2 or "pipe" not in program.text():
                raise Broken(f"{program.name}: exit code {code}: {program.text()[-200:]}")

    def pause(self):
        time.sleep(self.random.uniform(0, 1))

    # --- what must hold

    def check_ended(self):
        """A learner that has ended by itself said the truth."""
        if not self.learner or self.learner.alive():
            return
        code, text = self.learner.process.returncode, self.learner.text()
        if code == 0 and "trained steps=" not in text:
            raise Broken(f"{self.learner.name}: exit code 0 without a training")
        if code == 1 and not any(word in text for word in ("NOT SAVED", "this one stops", "--restart begins anew")):
            raise Broken(f"{self.learner.name}: exit code 1 without a reason: {text[-400:]}")
        early = code == -signal.SIGTERM and not text  # stopped before its main() began
        if code not in (0, 1, 2, 130, -signal.SIGKILL) and not early:
            raise Broken(f"{self.learner.name}: exit code {code}: {text[-400:]}")
        if code == 2 and "No space left" not in text:
            raise Broken(f"{self.learner.name}: refused: {text[-400:]}")

    def wait_for_end(self, with_worker=False):
        """Until the learner ends; Broken when nobody says anything for too long. A learner alone waits for a worker."""
        heard, size = time.monotonic(), -1
        while self.learner.alive():
            if with_worker and not self.workers():
                self.start_worker()
            now = sum(p.log.stat().st_size for p in self.programs if not p.name.endswith("stranger"))
            if now != size:
                heard, size = time.monotonic(), now
            if time.monotonic() - heard > SILENCE_S:
                raise Broken(f"{self.learner.name}: silent for {SILENCE_S} s: {self.learner.text()[-400:]}")
            time.sleep(0.02)

    def finish(self):
        """Lets the training end in peace and looks at what it left."""
        self.disk.free()
        for _ in range(3):
            self.start_learner()
            self.wait_for_end(with_worker=True)
            if self.learner.process.returncode == 0:
                break
        self.check_ended()
        if self.learner.process.returncode != 0:
            raise Broken(f"no end with exit code 0: {self.learner.text()[-600:]}")
        self.check_folder()
        self.learner = None
        self.start_learner()  # loads the last checkpoint, has nothing left to train
        self.wait_for_end()
        if self.learner.process.returncode != 0:
            raise Broken(f"the finished run cannot be loaded: {self.learner.text()[-400:]}")
        if self.learner.text().count("update ") > 0:
            raise Broken("the finished run trained again: its last checkpoint was lost")
        self.check_folder()

    def check_folder(self):
        summary = json.loads((self.run_dir / "summary.json").read_text())
        if summary["weights_hash"] != self.hashes[self.seed]:
            raise Broken(f"weights {summary['weights_hash'][:16]} instead of {self.hashes[self.seed][:16]}")
        if not (self.run_dir / "policy.onnx").exists():
            raise Broken("no policy.onnx")
        other = f"run_seed: {sum(SEEDS) - self.seed}\n".encode()
        for path in [self.run_dir / "config.txtpb", *(self.run_dir / "checkpoints").iterdir()]:
            if other in path.read_bytes():
                raise Broken(f"{path.name} is of another configuration")
        metrics = self.run_dir / "metrics.csv"  # begun again with the next update where the folder was deleted
        rows = metrics.read_text().splitlines()[1:] if metrics.exists() else []
        updates = [int(row.split(",")[0]) for row in rows]
        if updates != sorted(set(updates)):
            raise Broken(f"metrics.csv holds updates {updates}")

    # --- the whole

    ACTIONS = ("start_learner start_learner start_learner start_worker start_worker stop_worker stop_learner kill_learner "
               "restart second_start delete_folder fill_disk free_disk foreign_writer flood_of_workers forge_rtps "
               "learner_elsewhere pipe pause pause").split()

    def play(self):
        try:
            for _ in range(self.random.randint(4, 12)):
                action = self.random.choice(self.ACTIONS)
                self.told.append(action)
                getattr(self, action)()
                time.sleep(self.random.uniform(0, 0.5))
            self.finish()
        finally:
            for program in self.programs:
                program.end()
            self.disk.remove()


def undisturbed(programs, seed, domain):
    """Weights of a training that nobody disturbs."""
    with tempfile.TemporaryDirectory() as name:
        sequence = Sequence(programs, seed, {}, pathlib.Path(name), domain)
        try:
            sequence.seed = seed
            sequence.start_worker()
            sequence.start_learner()
            sequence.wait_for_end()
            return json.loads((sequence.run_dir / "summary.json").read_text())["weights_hash"]
        finally:
            for program in sequence.programs:
                program.end()
            sequence.disk.remove()


def main():
    programs, count, first = pathlib.Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3])
    domain = Domain()
    hashes = {seed: undisturbed(programs, seed, domain.number) for seed in SEEDS}
    broken, began = 0, time.monotonic()
    for number in range(first, first + count):
        folder = pathlib.Path(tempfile.mkdtemp(prefix="omentum-hostile-"))
        sequence = Sequence(programs, number, hashes, folder, domain.number)
        result = "held"
        try:
            sequence.play()
            shutil.rmtree(folder)
        except (Broken, OSError, ValueError) as reason:
            broken += 1
            result = f"BROKEN: {reason!r} (logs in {folder})"
        left = (time.monotonic() - began) / (number - first + 1) * (first + count - number - 1)
        print(f"{number} {' '.join(sequence.told)}: {result}; {left:.0f} s left", flush=True)
    print(f"{count - broken} held, {broken} broken{'' if sequence.disk.own else '; no full disk: mount is not allowed'}")
    sys.exit(1 if broken else 0)


if __name__ == "__main__":
    main()

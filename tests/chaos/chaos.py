#!/usr/bin/env python3
"""Faults on real processes: every row ends with a balanced ledger and the weights of the undisturbed run.
usage: chaos.py BIN_DIR [--short] [NAME ...]"""
import pathlib
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time

import system
from system import Broken, Host, Network, Skipped, Training

HERE = pathlib.Path(__file__).resolve().parent
SHORT_UPDATES, LONG_UPDATES = 600, 3000
TASK = {
    "scene.tissue.grid.count_x": 12, "scene.tissue.grid.count_y": 12, "scene.tissue.anchor_max_y_m": -0.014,
    "task.episode_steps": 60, "rollout.slots": 16, "rollout.steps_per_segment": 32, "rollout.run_seed": 5,
    "ppo.hidden": 16, "ppo.minibatch": 128, "ppo.epochs": 2, "evaluation.enabled": "false",
    "run.checkpoint_interval_s": 0,
}
NOTICED_S, PRODUCING_S, JOINED_S = 3, 3, 5


class Bench:
    """What the rows share: programs, a folder, and the weights of the undisturbed run."""

    def __init__(self, bins, folder, short):
        self.bin, self.folder, self.short = bins, folder, short
        self.updates = SHORT_UPDATES if short else LONG_UPDATES
        self.sets = TASK | {"rollout.max_steps": self.updates * 16 * 32}
        self.random = random.Random(1)
        self.hash = ""
        self.count = 0

    def training(self, network=None, environment=None, folder=None):
        self.count += 1
        return Training(self.bin, folder or self.folder / f"{self.count:02}", self.sets, network, environment)

    def undisturbed(self):
        run = self.training()
        began = time.monotonic()
        try:
            run.start_learner()
            run.start_worker()
            run.start_worker()
            self.hash, _ = run.finish(None, 600)
        finally:
            run.end()
        return time.monotonic() - began

    def kills(self, most):
        """Updates at which something is killed: spread over the run by a seeded law."""
        count = 5 if self.short else most
        return sorted(self.random.sample(range(3, self.updates // 2), count))


# ------------------------------------------------------------------------------- processes that die

def worker_kill(bench, run):
    learner = run.start_learner()
    workers = [run.start_worker(), run.start_worker()]
    noticed = []
    for update in bench.kills(20):
        run.wait_for_update(update)
        time.sleep(bench.random.random() * 0.05)
        if run.updates() > bench.updates * 6 // 10:
            break  # the run would be over before the lease is
        before = len(learner.text())
        victim = bench.random.randrange(2)
        workers[victim].kill()
        workers[victim] = run.start_worker()
        noticed.append(learner.wait_for("event=worker_lost", 10, before))
    _, ledger = run.finish(bench.hash)
    if max(noticed) > NOTICED_S:
        raise Broken(f"a lost worker was noticed after {max(noticed):.1f} s, allowed {NOTICED_S}")
    again = ledger["regranted"] + ledger["cancelled"]  # a copy that came first cancels the lost grant
    return f"{len(noticed)} kills, noticed within {max(noticed):.2f} s, {again} tasks granted again"


def learner_kill(bench, run):
    run.start_learner()
    run.start_worker()
    run.start_worker()
    producing = []
    for update in bench.kills(20):
        run.wait_for_update(update)
        time.sleep(bench.random.random() * 0.05)  # any phase: also while it saves or publishes
        run.learner.kill()
        done = run.updates()
        run.start_learner()
        producing.append(run.wait_for_update(1, 30) if done < bench.updates else 0)
    run.finish(bench.hash)
    if max(producing) > PRODUCING_S + 1:
        raise Broken(f"producing again after {max(producing):.1f} s")
    return f"{len(producing)} kills, producing again within {max(producing):.2f} s of the restart"


def all_kill(bench, run):
    run.start_learner()
    workers = [run.start_worker(), run.start_worker()]
    producing = []
    for update in bench.kills(20)[::2]:
        run.wait_for_update(update)
        for program in [run.learner, *workers]:
            program.kill()
        run.start_learner()
        workers = [run.start_worker(), run.start_worker()]
        producing.append(run.wait_for_update(1, 30))
    run.finish(bench.hash)
    return f"{len(producing)} times, producing again within {max(producing):.2f} s"


# ------------------------------------------------------------------------- the wrong learner, or two

def empty_folder(bench, run):
    run.start_learner()
    run.start_worker()
    run.wait_for_update(5)
    run.learner.kill()
    shutil.move(run.run_dir, run.folder / "kept")
    time.sleep(1.1)  # learners that start within a second have one epoch, and no worker can tell
    wrong = run.start_learner()
    code = wrong.wait(30)
    lines = [line for line in wrong.text().splitlines() if " error " in line]
    if code != 1 or len(lines) != 1 or "--restart begins anew" not in lines[0]:
        raise Broken(f"code {code}: {wrong.text()[-300:]}")
    shutil.rmtree(run.run_dir)
    shutil.move(run.folder / "kept", run.run_dir)
    run.start_learner()
    run.finish(bench.hash)
    return "one line, exit code 1; the right folder goes on"


def two_learners(bench, run):
    """On two hosts a run can have two folders: the newer one is obeyed, and nobody returns to the older."""
    older = run.start_learner()
    run.start_worker()
    run.wait_for_update(5)
    kept = run.folder
    run.folder = kept / "elsewhere"
    run.folder.mkdir()
    older.signal(signal.SIGSTOP)  # it removes old checkpoints
    shutil.copytree(kept / "runs" / system.RUN, run.run_dir)
    older.signal(signal.SIGCONT)
    for lock in run.folder.glob("runs/.*lock"):
        lock.unlink()
    newer = run.start_learner()
    if older.wait(30) != 1 or "serves run" not in older.text():
        raise Broken(f"the older learner ended otherwise: {older.text()[-300:]}")
    run.wait_for_update(3)
    newer.kill()
    run.start_learner()
    run.finish(bench.hash)
    run.folder = kept
    return "the older one ended with one line and code 1, the newer one goes on after a kill"


# ------------------------------------------------------------------------------ processes that stop

def stop_for(bench):
    return 3 if bench.short else 20


def resident_kb(program):
    with open(f"/proc/{program.process.pid}/status", encoding="ascii") as file:
        return next(int(line.split()[1]) for line in file if line.startswith("VmRSS"))


def worker_stop(bench, run):
    learner = run.start_learner()
    stopped = run.start_worker()
    run.start_worker()
    run.wait_for_update(10)
    before, memory = run.updates(), resident_kb(learner)
    stopped.signal(signal.SIGSTOP)
    time.sleep(stop_for(bench))
    went_on = run.updates() - before
    grown = resident_kb(learner) - memory if learner.alive() else 0
    stopped.signal(signal.SIGCONT)
    run.finish(bench.hash)
    if went_on < 1:
        raise Broken("the other worker did not go on")
    return f"{went_on} updates in {stop_for(bench)} s meanwhile, learner {grown / 1000:+.1f} MB"


def learner_stop(bench, run):
    learner = run.start_learner()
    worker = run.start_worker()
    run.start_worker()
    run.wait_for_update(10)
    memory = resident_kb(worker)
    learner.signal(signal.SIGSTOP)
    time.sleep(stop_for(bench))
    grown = resident_kb(worker) - memory
    learner.signal(signal.SIGCONT)
    run.finish(bench.hash)
    return f"a worker's memory {grown / 1000:+.1f} MB in {stop_for(bench)} s"


def tool_stop(bench, run):
    """A reliable reader of the segments that stops: one lease of pause."""
    learner = run.start_learner()
    worker = run.start_worker()
    run.wait_for_update(10)
    tool = run.start("tool", [bench.bin / "chaos_reader", run.domain.number, system.RUN])
    tool.wait_for("reads", 20)
    before = run.updates()
    tool.signal(signal.SIGSTOP)
    time.sleep(stop_for(bench) + 3)
    went_on = run.updates() - before
    alarm = "name=reader_stopped" in worker.text()
    tool.kill()
    if went_on < 1 and learner.alive():
        raise Broken("nothing was learned while the tool stood still for longer than a lease")
    run.finish(bench.hash)
    if not alarm:
        raise Broken("no alarm")
    return f"{went_on} updates meanwhile, alarm raised"


# --------------------------------------------------------------------------------------- the network

def loss(bench, run):
    text = subprocess.run([bench.bin / "learner", "--print-dds-env"], capture_output=True, text=True, check=True).stdout
    uri = text.split("'", 1)[1].rsplit("'", 1)[0]
    run.environment = {"CYCLONEDDS_URI": uri.replace("</Internal>", "<Test><XmitLossiness>20</XmitLossiness></Test></Internal>")}
    run.start_learner()
    run.start_worker()
    run.start_worker()
    _, ledger = run.finish(bench.hash, 600)
    return f"2 % of the datagrams lost both ways: {ledger['regranted']} granted again, {ledger['duplicate']} duplicates"


def with_network(count):
    def wrap(row):
        def inner(bench, run):
            network = Network(count)
            try:
                return row(bench, run, network)
            finally:
                run.end()
                network.remove()
        inner.__name__ = row.__name__
        return inner
    return wrap


@with_network(2)
def reorder(bench, run, network):
    switch, relay_program = Host(network.switch), [sys.executable, HERE / "reorder_relay.py"]
    ports = network.unbridge()
    for host, names in [(switch, ports), *((host, ["eth0"]) for host in network.hosts)]:
        for name in names:
            subprocess.run(host.command([*relay_program, "--no-offload", name]), check=True)
    relay = run.start("relay", [*relay_program, *ports, 7], switch, [])
    relay.wait_for("ready", 10)
    hub, far = network.hosts
    run.options = ["--discovery", "mesh", "--peers", f"{hub.address},{far.address}"]
    run.start_learner(hub)
    run.start_worker(far)
    run.start_worker(far)
    _, ledger = run.finish(bench.hash, 600)
    return f"{relay.text().splitlines()[-1]}: {ledger['regranted']} granted again, {ledger['duplicate']} duplicates"


@with_network(2)
def two_hosts(bench, run, network):
    told = []
    hub, far = network.hosts
    for name in ("mesh", "hub"):
        part = bench.training()
        try:
            part.options = (["--discovery", "mesh", "--peers", f"{hub.address},{far.address}"] if name == "mesh" else
                            ["--discovery", "hub", "--hub", hub.address])
            part.start_learner(hub)
            part.start_worker(far)
            part.start_worker(far)
            part.wait_for_update(10)
            network.plug(far, False)
            time.sleep(3 if bench.short else 10)
            done = part.updates()
            network.plug(far, True)
            again = part.wait_for_update(done + 1, 60)
            part.finish(bench.hash, 600)
            told.append(f"{name}: trains on {again:.2f} s after the cut")
        finally:
            part.end()
    return "; ".join(told)


@with_network(3)
def learner_moved(bench, run, network):
    first, far, second = network.hosts
    name = "learner.chaos"
    run.options = ["--discovery", "hub", "--hub", name]
    worker = run.start_worker(far)
    worker.wait_for(f"waiting: host name {name}", 20)
    time.sleep(2 if bench.short else 20)
    joined = []
    for host in (first, second):
        for each in network.hosts:
            each.hosts(f"{host.address} {name}\n")
        run.start_learner(host)
        joined.append(run.learner.wait_for("event=worker_joined", 30))
        if host is first:
            run.wait_for_update(20)
            run.learner.kill()
    run.finish(bench.hash, 600)
    if max(joined) > JOINED_S + 1:
        raise Broken(f"joined after {max(joined):.1f} s, allowed {JOINED_S}")
    return f"joined {joined[0]:.2f} s after the name existed, {joined[1]:.2f} s after it moved"


# ------------------------------------------------------------------------------------ disk and builds

def disk_full(bench, run):
    disk = run.folder / "runs"
    disk.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(disk)]
    if subprocess.run(mount, stderr=subprocess.DEVNULL, check=False).returncode != 0:
        raise Skipped("a small file system needs root")
    try:
        learner = run.start_learner()
        run.start_worker()
        run.wait_for_update(10)
        with open(disk / "ballast", "wb", buffering=0) as ballast:
            try:
                while True:
                    ballast.write(bytes(4096))
            except OSError:
                pass
        learner.wait_for("event=checkpoint_not_saved", 20)
        (disk / "ballast").unlink()
        learner.wait_for("event=saved_again", 20)
        run.finish(bench.hash)
    finally:
        run.end()
        subprocess.run(["umount", "-l", str(disk)], check=True)
    return "warned, and the next checkpoint was written"


def other_build(bench, run):
    learner = run.start_learner()
    run.start("other", [bench.bin / "chaos_other_build", run.domain.number, system.RUN])
    learner.wait_for("differs from the learner's", 20)
    run.start_worker()
    run.finish(bench.hash)
    return "declined, reason shown: build differs from the learner's"


def workers_20(bench, run):
    del run
    for count in (1, 8, 20):  # two made the undisturbed run
        part = bench.training()
        try:
            part.start_learner()
            for _ in range(count):
                part.start_worker()
            part.finish(bench.hash, 600)
        finally:
            part.end()
    return "1, 2, 8 and 20 workers: the same hash"


def shell_row(file, name):
    """A row of a shell file: prints its detail; code 77 means skipped."""
    def row(bench, run):
        script = HERE / file
        if not script.exists():
            raise Skipped(f"{file} is not there")
        result = subprocess.run(
            ["bash", "-c", f". '{script}'; row_{name}"], capture_output=True, text=True, check=False,
            env=system.os.environ | {"BIN": str(bench.bin), "SCRATCH": str(run.folder)})
        detail = (result.stdout.strip().splitlines() or [result.stderr.strip()[-300:]])[-1]
        if result.returncode == 77:
            raise Skipped(detail)
        if result.returncode != 0:
            raise Broken(detail + " " + result.stderr.strip()[-200:])
        return detail
    return row


ROWS = {row.__name__: row for row in (
    worker_kill, learner_kill, all_kill, learner_moved, empty_folder, two_learners, worker_stop, learner_stop, tool_stop,
    loss, reorder, two_hosts, disk_full, other_build, workers_20)}
ROWS |= {name: shell_row("security.sh", name) for name in ("stranger", "wrong_role", "expired")}
ROWS |= {name: shell_row("containers.sh", name) for name in ("compose", "swarm")}
ROWS["slurm"] = shell_row("slurm.sh", "slurm")
CONTAINERS = ("compose", "swarm", "slurm")


def main():
    arguments = sys.argv[2:]
    short = "--short" in arguments
    names = [name for name in arguments if name != "--short"]
    unknown = [name for name in names if name not in ROWS]
    if unknown:
        print(f"chaos: no row {unknown[0]}; there are {' '.join(ROWS)}", file=sys.stderr)
        return 2
    names = names or [name for name in ROWS if not (short and name in CONTAINERS)]
    folder = pathlib.Path(tempfile.mkdtemp(prefix="omentum_chaos_"))
    bench = Bench(pathlib.Path(sys.argv[1]), folder, short)
    failed = False
    if set(names) - set(CONTAINERS):
        print(f"undisturbed {bench.undisturbed():.1f} s, weights {bench.hash[:8]}", flush=True)
    for name in names:
        began = time.monotonic()
        run = bench.training()
        try:
            state, detail = "ok", ROWS[name](bench, run)
        except Skipped as reason:
            state, detail = "skipped", reason
        except (Broken, OSError, subprocess.SubprocessError) as reason:
            state, detail, failed = "failed", reason, True
        finally:
            run.end()
        print(f"{name} {state} {' '.join(str(detail).split())} ({time.monotonic() - began:.1f} s)", flush=True)
    if failed:
        print(f"chaos: logs are in {folder}")
    else:
        shutil.rmtree(folder)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

"""Real processes of one run, and hosts of their own (network namespaces), for the rows of tests/chaos.sh."""
import fcntl
import json
import os
import pathlib
import re
import shutil
import signal
import subprocess
import time

RUN = "chaos"


class Broken(Exception):
    """A promise was not kept."""


class Skipped(Exception):
    """This machine cannot show it."""


class Domain:
    """A DDS domain that no other test uses (tests/support/domain.h)."""

    def __init__(self):
        for number in range(1, 90):
            self.lock = open(f"/tmp/omentum_test_domain_{number}", "w")
            try:
                fcntl.flock(self.lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self.number = number
                return
            except OSError:
                self.lock.close()
        raise Broken("every test domain is taken")


class Program:
    """A process with its output in one file."""

    def __init__(self, name, arguments, folder, environment=None):
        self.name, self.log = name, folder / f"{name}.log"
        with open(self.log, "wb") as log:
            self.process = subprocess.Popen([str(a) for a in arguments], stdout=log, stderr=subprocess.STDOUT,
                                            env=os.environ | (environment or {}))

    def alive(self):
        return self.process.poll() is None

    def signal(self, number):
        if self.alive():
            self.process.send_signal(number)

    def kill(self):
        self.signal(signal.SIGKILL)
        self.process.wait()

    def text(self):
        return self.log.read_text(errors="replace")

    def wait_for(self, pattern, timeout_s, after=0):
        """Seconds until the output, from character `after` on, holds the pattern."""
        began = time.monotonic()
        while not re.search(pattern, self.text()[after:]):
            if time.monotonic() - began > timeout_s:
                raise Broken(f"{self.name} does not say '{pattern}' within {timeout_s} s: {self.text()[-300:]}")
            time.sleep(0.02)
        return time.monotonic() - began

    def wait(self, timeout_s):
        try:
            return self.process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            raise Broken(f"{self.name} does not end within {timeout_s} s: {self.text()[-300:]}") from None


class Host:
    """A network namespace with one address. The plain machine where `name` is None."""

    def __init__(self, name=None, address=None):
        self.name, self.address = name, address

    def command(self, arguments):
        return ["ip", "netns", "exec", self.name, *arguments] if self.name else arguments

    def hosts(self, text):
        """What /etc/hosts says on this host, for processes that run already as well."""
        with open(f"/etc/netns/{self.name}/hosts", "r+", encoding="ascii") as file:
            file.truncate(0)
            file.write("127.0.0.1 localhost\n" + text)


class Network:
    """Hosts at one switch, which is a namespace of its own: no firewall of the machine sees their frames. Needs root."""
    made = 0

    def __init__(self, count):
        Network.made += 1
        self.name = f"omc{os.getpid()}x{Network.made}"
        self.switch, self.names, self.hosts = f"{self.name}sw", [], []
        if os.geteuid() != 0 or not shutil.which("ip") or self.ip("netns", "add", self.switch, check=False) != 0:
            raise Skipped("network namespaces need root and iproute2")
        self.ip("-n", self.switch, "link", "add", "bridge", "type", "bridge")
        self.ip("-n", self.switch, "link", "set", "bridge", "up")
        for i in range(count):
            self.add(f"10.231.0.{i + 1}")

    @staticmethod
    def ip(*arguments, check=True):
        return subprocess.run(["ip", *arguments], check=check, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL).returncode

    def add(self, address):
        port, name = f"port{len(self.names)}", f"{self.name}n{len(self.names)}"
        self.names.append(name)
        pathlib.Path(f"/etc/netns/{name}").mkdir(parents=True, exist_ok=True)
        pathlib.Path(f"/etc/netns/{name}/hosts").write_text("127.0.0.1 localhost\n", encoding="ascii")
        self.ip("netns", "add", name)
        self.ip("-n", self.switch, "link", "add", port, "type", "veth", "peer", "name", "eth0", "netns", name)
        self.ip("-n", self.switch, "link", "set", port, "mtu", "1450", "master", "bridge", "up")
        for arguments in (["link", "set", "lo", "up"], ["addr", "add", f"{address}/24", "dev", "eth0"],
                          ["link", "set", "eth0", "mtu", "1450"], ["link", "set", "eth0", "up"]):
            self.ip("-n", name, *arguments)
        self.hosts.append(Host(name, address))

    def plug(self, host, connected):
        self.ip("-n", self.switch, "link", "set", f"port{self.hosts.index(host)}", "up" if connected else "down")

    def unbridge(self):
        """Takes the ports from the bridge: something else carries the frames."""
        ports = [f"port{i}" for i in range(len(self.names))]
        for port in ports:
            self.ip("-n", self.switch, "link", "set", port, "nomaster")
        return ports

    def remove(self):
        for name in [*self.names, self.switch]:
            self.ip("netns", "del", name, check=False)
            shutil.rmtree(f"/etc/netns/{name}", ignore_errors=True)


class Training:
    """One run: a learner and workers, restarted as a supervisor would, until it is done."""

    def __init__(self, bins, folder, sets, network=None, environment=None):
        self.bin, self.folder, self.sets = bins, folder, sets
        self.options = network or []
        self.environment = environment
        self.domain = Domain()
        self.programs, self.workers, self.learner = [], [], None
        folder.mkdir(parents=True)

    @property
    def run_dir(self):
        return self.folder / "runs" / RUN

    def start(self, name, arguments, host=Host(), options=None):
        arguments = host.command([*arguments, *(self.options if options is None else options)])
        program = Program(f"{len(self.programs):02}-{name}", arguments, self.folder, self.environment)
        self.programs.append(program)
        return program

    def start_learner(self, host=Host(), more=(), options=None):
        arguments = [self.bin / "learner", "--run", RUN, *more]
        for knob, value in (self.sets | {"run.runs_dir": self.folder / "runs", "run.domain": self.domain.number}).items():
            arguments += ["--set", f"{knob}={value}"]
        self.learner = self.start("learner", arguments, host, options)
        return self.learner

    def start_worker(self, host=Host(), more=(), options=None):
        worker = self.start("worker", [self.bin / "sim_worker", "--run", RUN, "--domain", self.domain.number, *more],
                            host, options)
        self.workers.append(worker)
        return worker

    def updates(self):
        """Finished updates as the present learner tells."""
        found = re.findall(r"^update (\d+)/", self.learner.text(), re.M)
        return int(found[-1]) if found else 0

    def wait_for_update(self, number, timeout_s=60):
        began = time.monotonic()
        while self.updates() < number and self.learner.alive():
            if time.monotonic() - began > timeout_s:
                raise Broken(f"no update {number} within {timeout_s} s: {self.learner.text()[-300:]}")
            time.sleep(0.02)
        return time.monotonic() - began

    def finish(self, expected_hash, timeout_s=120):
        """The run ends with the weights of the undisturbed one and a balanced ledger."""
        code = self.learner.wait(timeout_s)
        if code != 0:
            raise Broken(f"the learner ended with code {code}: {self.learner.text()[-400:]}")
        summary = json.loads((self.run_dir / "summary.json").read_text())
        ledger = dict(re.findall(r"(\w+)=(\d+)", re.findall(r"info ledger (.*)", self.learner.text())[-1]))
        ledger = {name: int(value) for name, value in ledger.items()}
        ends = sum(ledger[n] for n in ("admitted", "duplicate", "stale", "invalid", "foreign", "overflow"))
        grants = sum(ledger[n] for n in ("admitted", "outstanding", "cancelled", "regranted"))
        if ledger["received"] != ends or ledger["granted"] != grants:
            raise Broken(f"the ledger does not balance: {ledger}")
        if expected_hash and summary["weights_hash"] != expected_hash:
            raise Broken(f"weights {summary['weights_hash'][:8]}, undisturbed {expected_hash[:8]}")
        return summary["weights_hash"], ledger

    def end(self):
        for program in self.programs:
            program.kill()

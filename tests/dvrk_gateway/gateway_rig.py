"""What tests and benchmark of the gateway on running programs share: a policy, a registration, a double and a gateway."""
import json
import os
import select
import signal
import socket
import subprocess
import time

BASE_M = (0.1427, 0.0, 0.1584)  # X_WR of scene omentum, which does not turn
BOX_M = ((-0.0916, -0.0825, 0.001), (0.0691, 0.1155, 0.119))
TIP_M = 0.0102  # of the jaw beyond the control point
DOWN = ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, -1.0))  # R_RC of a tool that points down
START_M = (-0.02, 0.055, 0.1)  # p_WT where an episode may begin
HOMED_S = 30  # patience


def make_policy(programs, folder, domain):
    """A run folder with the checkpoint of a few updates: how well it acts is of no matter here."""
    scratch = folder / "runs"
    learner = subprocess.Popen(
        [programs / "learner", "--run", "policy", "--preset", "omentum", "--set", f"run.runs_dir={scratch}", "--set",
         f"run.domain={domain}", "--set", "evaluation.enabled=false", "--set", "rollout.max_steps=20000"],
        stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    worker = subprocess.Popen([programs / "sim_worker", "--run", "policy", "--domain", str(domain)],
                              stdout=subprocess.DEVNULL, stderr=subprocess.STDOUT)
    try:
        if learner.wait(timeout=300) != 0:
            raise RuntimeError(f"the learner ended with code {learner.returncode}")
    finally:
        for process in (learner, worker):
            process.kill()
            process.wait()
    return scratch / "policy"


def make_registration(programs, folder, policy):
    """By exact touches, through the program that a user takes."""
    touches, file = folder / "touches.csv", folder / "registration.txtpb"
    lines = ["name,world_x_m,world_y_m,world_z_m,control_x_m,control_y_m,control_z_m,q_w,q_x,q_y,q_z"]
    half = 0.5 ** 0.5
    for number, point in enumerate([(-0.05, -0.05, 0.01), (0.05, -0.05, 0.03), (0.05, 0.08, 0.01), (-0.05, 0.08, 0.04),
                                    (0.0, 0.02, 0.06), (0.03, -0.02, 0.02)]):
        control = [p - b for p, b in zip(point, BASE_M)]
        control[2] += TIP_M
        lines.append(",".join([f"p{number}"] + [repr(v) for v in (*point, *control, 0.0, half, half, 0.0)]))
    touches.write_text("\n".join(lines) + "\n")
    subprocess.run([programs / "dvrk_gateway", "--policy", policy, "--registration", file, "register", "--touches", touches],
                   check=True, stdout=subprocess.DEVNULL)
    return file


def datagram_socket(port=0):
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", port))
    return link


def free_port():
    with datagram_socket() as link:
        return link.getsockname()[1]


def lead_to_start(link, tip=START_M):
    """As the operator does at the console: the homed tool goes to where an episode may begin. Returns the robot's address."""
    deadline = time.monotonic() + HOMED_S
    goal = [p - b for p, b in zip(tip, BASE_M)]
    goal[2] += TIP_M
    command = json.dumps({"move_cp": {"Goal": {"Rotation": DOWN, "Translation": goal}}}).encode()
    asked_at = 0.0
    state, pose = {}, {}
    while time.monotonic() < deadline:
        if not select.select([link], [], [], 1.0)[0]:
            continue
        text, robot = link.recvfrom(65536)
        try:
            said = json.loads(text)
        except ValueError:  # another process on this port
            continue
        state, pose = said.get("operating_state", state), said.get("setpoint_cp", pose)
        if not (pose.get("Valid") and state.get("IsHomed") and not state.get("IsBusy")):
            continue
        there = max(abs(a - b) for a, b in zip(pose["Position"]["Translation"], goal)) < 1e-6
        if there:
            return robot
        if time.monotonic() > asked_at + 0.5:  # a bad network may have lost it
            link.sendto(command, robot)
            asked_at = time.monotonic()
    raise RuntimeError("the double did not go to the start")


class Program:
    """A process with its output in a file; commands to it by signal and standard input."""

    def __init__(self, arguments, log, raised=False):
        self.log = log
        with open(log, "wb") as out:
            self.process = subprocess.Popen([str(a) for a in arguments], stdin=subprocess.PIPE, stdout=out,
                                            stderr=subprocess.STDOUT)
        if raised:
            raise_process(self.process.pid)

    def type(self, text):
        try:
            self.process.stdin.write(text.encode())
            self.process.stdin.flush()
        except BrokenPipeError:
            pass  # it has ended: who waits for it says so

    def send(self, number):
        if self.process.poll() is None:
            self.process.send_signal(number)

    def text(self):
        return self.log.read_text(errors="replace")

    def end(self, how=signal.SIGTERM, patience_s=20):
        """Its exit code; killed when it does not end."""
        self.send(how)
        try:
            return self.process.wait(timeout=patience_s)
        except subprocess.TimeoutExpired:
            self.process.kill()
            self.process.wait()
            return None


def raise_process(pid):
    """Above whatever loads the machine, where the system grants it; below the gateway's own threads."""
    try:
        os.sched_setscheduler(pid, os.SCHED_FIFO, os.sched_param(50))
    except PermissionError:
        pass


def start_double(programs, folder, port, options=()):
    # A robot is a machine of its own: what loads this one does not delay it.
    return Program([programs / "dvrk_double", "--port", port, "--home-at", "0.1", *options], folder / "double.log",
                   raised=True)


def start_gateway(programs, folder, port, policy, registration, options=()):
    limits = folder / "limits.txtpb"
    # Without a margin: the starts of the scene that are farthest away lie in it, and the policy is no trained one.
    limits.write_text("joint_margin: 0\n")
    registered = ["--registration", registration] if registration else []
    return Program([programs / "dvrk_gateway", "--robot", f"127.0.0.1:{port}", "--policy", policy, *registered, "--limits",
                    limits, "--episodes", 1000000, "--record", folder / f"recordings-{port}", *options], folder / "gateway.log")


def phases(text):
    """Words of the operator's screen, in order: ready, active, stopped ..."""
    words = ("listening", "waiting", "ready", "active", "stopped")
    return [line.split(":")[0].strip() for line in text.splitlines() if line.split(":")[0].strip() in words]


def programs_folder(path):
    """Where the programs find their presets when they are not below the source tree."""
    root = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))
    os.environ.setdefault("OMENTUM_DEPLOY_DIR", os.path.join(root, "deploy"))
    return path

#!/usr/bin/env python3
"""The paper's experiment against a robot that is a double with tissue under its jaw, in real time: starts both programs and
is the operator, who arms when the gateway is ready and acknowledges every stop. What follows -- goes to the double.

  tests/dvrk_gateway/experiment_on_double.py --policy RUN --out DIR [--mode twin] [--registration-error 0 0 0] [-- --set ...]

Exit code: that of the gateway."""
import argparse
import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).resolve().parents[2]
BIN = pathlib.Path(os.environ.get("OMENTUM_BIN", ROOT / "build/release/bin"))


def operator(gateway, double):
    """Types what a person would, and shows what the gateway says."""
    for line in gateway.stdout:
        print(line, end="", flush=True)
        if line.startswith("start ") and " of " in line:  # the tissue is laid anew for every trial
            double.stdin.write("lay\n")
            double.stdin.flush()
        key = "a" if line.startswith("press a to arm") else "k" if line.startswith("press k") else ""
        if key and gateway.poll() is None:
            try:
                gateway.stdin.write(key)
                gateway.stdin.flush()
            except BrokenPipeError:  # it is just ending
                pass
    return gateway.wait()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--policy", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--mode", default="twin")
    parser.add_argument("--starts", default="25")
    parser.add_argument("--port", default="48051")
    parser.add_argument("--registration-error", nargs=3, default=["0", "0", "0"], help="in W [m]")
    parser.add_argument("--limits", help="SafetyLimits for a machine that stands still now and then, as a virtual one")
    parser.add_argument("double", nargs="*", help="options of dvrk_double")
    options = parser.parse_args()
    folder = pathlib.Path(options.out)
    folder.mkdir(parents=True, exist_ok=True)

    touches = folder / "touches.csv"
    with touches.open("w") as table:
        subprocess.run([sys.executable, ROOT / "tests/dvrk_gateway/touches.py", "--error", *options.registration_error],
                       stdout=table, check=True)
    program = [BIN / "dvrk_gateway", "--robot", f"127.0.0.1:{options.port}", "--policy", options.policy,
               "--registration", folder / "registration.txtpb", *(["--limits", options.limits] if options.limits else [])]
    subprocess.run([*program, "register", "--touches", touches], stdout=subprocess.DEVNULL, check=True)
    with (folder / "double.log").open("w") as log:
        double = subprocess.Popen([BIN / "dvrk_double", "--port", options.port, "--tissue", "--at", "3 place",
                                   *options.double], stdin=subprocess.PIPE, stderr=log, text=True)
        try:
            gateway = subprocess.Popen([*program, "--mode", options.mode, "--record", folder / "recordings",
                                        "experiment", "--out", folder, "--starts", options.starts],
                                       stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
            return operator(gateway, double)
        finally:
            double.terminate()
            double.wait()


if __name__ == "__main__":
    sys.exit(main())

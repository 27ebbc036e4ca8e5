#!/usr/bin/env python3
"""Commands of docs/start stand as they are typed. A block ```sh run is run, block after block of a page in one folder; of every
other ```sh block the programs must be there and know each option, knob and preset that the page gives them.

A page that runs programs with runs/omentum finds a policy of a few updates there.

usage: start_commands_test.py ROOT BIN
"""
import contextlib
import os
import pathlib
import re
import shlex
import signal
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "dvrk_gateway"))
import gateway_rig

BLOCK = re.compile(r"^```sh( run)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# Of other people: their options are not ours to check.
FOREIGN = {"sudo", "docker", "docker-compose", "sbatch", "cmake", "ctest", "head", "ls", "sed", "grep", "timedatectl", "sysctl"}


class Options:
    """What programs say of themselves, asked once."""

    def __init__(self):
        self.texts = {}

    def help(self, program, *words):
        key = (str(program), *words)
        if key not in self.texts:
            done = subprocess.run([*key, "--help"], capture_output=True, text=True, timeout=60)
            assert done.returncode == 0, (key, done.returncode, done.stderr)
            self.texts[key] = done.stdout
        return self.texts[key]


def commands(block):
    """Words of each command: lines that go on are joined, of pipes each part counts, comments and files after > do not."""
    for line in block.replace("\\\n", " ").splitlines():
        for part in re.split(r"[|;&]+", re.sub(r">\s*\S+", "", line)):
            words = shlex.split(part, comments=True)
            while words and re.match(r"^[A-Z_]+=", words[0]):
                words.pop(0)
            if words:
                yield words


def check(root, binaries, options, knobs, words):
    while words[0] in ("sudo", "python3", "/usr/bin/python3"):
        words = words[1:]
    name = words[0]
    if name in FOREIGN or "/" not in name:
        assert name in FOREIGN, f"{name} is no program that a reader has"
        return
    program = binaries / pathlib.Path(name).name if name.startswith("build/release/bin/") else root / name
    assert program.is_file(), f"{name} is not there"
    if name.startswith(("deploy/slurm", "tests/run.sh", "./tests/run.sh")):
        return  # they pass their options on
    if program.suffix == ".py" or name.startswith("build/"):
        assert program.suffix == ".py" or os.access(program, os.X_OK), f"{name} cannot be run"
    flags = [w.split("=")[0] for w in words[1:] if re.match(r"^--?[a-zA-Z]", w)]
    if program.suffix == ".py":
        text = program.read_text(encoding="utf-8")
    else:
        text = options.help(program)
        subcommands = re.findall(r"^  (\S+)", text.partition("Subcommands:")[2], re.MULTILINE)
        text += "".join(options.help(program, word) for word in words[1:] if word in subcommands)
    for flag in flags:
        assert re.search(rf"(?<![\w-]){re.escape(flag)}(?![\w-])", text), f"{name} has no option {flag}"
    for flag, value in zip(words, words[1:]):
        if flag == "--preset":
            assert (root / "deploy/presets" / f"{value}.txtpb").is_file(), f"there is no preset {value}"
        if flag == "--set" and value.startswith("scene_file="):  # else it would be looked for among deploy/scenes
            scene = value.split("=", 1)[1]
            assert scene.startswith(("/", "$PWD/")) or (root / "deploy/scenes" / scene).is_file(), f"there is no scene {scene}"
        if flag == "--set" and not value.startswith("scene."):
            assert re.search(rf"(?<![\w.]){re.escape(value.split('=')[0])}(?![\w.])", knobs()), f"there is no knob {value}"


def run(block, folder):
    # What a block leaves in the background ends with it; files, for it would hold pipes open.
    with tempfile.TemporaryFile("w+") as said:
        shell = subprocess.Popen(["bash", "-euo", "pipefail", "-c", block], cwd=folder, stdout=said, stderr=said,
                                 start_new_session=True)
        try:
            code = shell.wait(timeout=300)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(shell.pid, signal.SIGKILL)
        said.seek(0)
        assert code == 0, f"code {code}\n{said.read()[-4000:]}"


def main():
    root, binaries = (pathlib.Path(a).resolve() for a in sys.argv[1:])
    options, faults, count = Options(), [], 0
    for page in sorted((root / "docs/start").glob("*.md")):
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            (folder / "build/release").mkdir(parents=True)
            (folder / "build/release/bin").symlink_to(binaries)
            for part in ("deploy", "tests", "benchmarks"):
                (folder / part).symlink_to(root / part)
            text = page.read_text(encoding="utf-8")
            if any(block[1] and "runs/omentum" in block[2] for block in BLOCK.finditer(text)):
                policy = gateway_rig.make_policy(binaries, folder, 1 + os.getpid() % 90)
                policy.rename(folder / "runs/omentum")
            for block in BLOCK.finditer(text):
                count += 1
                try:
                    for words in commands(block[2]):
                        check(root, binaries, options, lambda: options.help(binaries / "learner"), words)
                    if block[1]:
                        run(block[2], folder)
                except AssertionError as fault:
                    line = text.count("\n", 0, block.start()) + 1
                    faults.append(f"docs/start/{page.name}:{line}: {fault}")
    print("\n".join(faults) or f"{count} blocks stand")
    return 1 if faults or count == 0 else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""Commands of docs/start stand as they are typed, block after block of a page in one folder. A block ```sh run is run; one of
```sh long too with --long, and of ```sh terminals each line in a terminal of its own, until the first one ends. Of every block the
programs must be there and know each option, knob and preset that the page gives them, and the page must have built them before.

A page that runs programs with runs/omentum finds a policy of a few updates there. Rows of README and docs/results give commands
too: of these options, knobs and presets alone are looked up.

usage: start_commands_test.py ROOT BIN [--long] [--page NAME]
"""
import argparse
import contextlib
import os
import pathlib
import re
import shlex
import signal
import subprocess
import sys
import tempfile
import time

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[1] / "dvrk_gateway"))
import gateway_rig

BLOCK = re.compile(r"^```sh(?: (run|long|terminals))?\n(.*?)^```$", re.MULTILINE | re.DOTALL)
# What deploy/train.sh and deploy/setup.sh --no-tests build.
TRAINING = {"learner", "sim_worker", "report", "omentum"}
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

    def of_command(self, program, words):
        """With what it says of the subcommands among `words`."""
        text = self.help(program)
        subcommands = re.findall(r"^  (\S+)", text.partition("Subcommands:")[2], re.MULTILINE)
        return text + "".join(self.help(program, word) for word in words[1:] if word in subcommands)


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
    text = program.read_text(encoding="utf-8") if program.suffix == ".py" else options.of_command(program, words)
    check_words(root, name, text, knobs, words)


def check_words(root, name, text, knobs, words):
    """Options are in what a program says of itself, knobs, presets and scenes are there."""
    for flag in [w.split("=")[0] for w in words[1:] if re.match(r"^--?[a-zA-Z]", w)]:
        assert re.search(rf"(?<![\w-]){re.escape(flag)}(?![\w-])", text), f"{name} has no option {flag}"
    for flag, value in zip(words, words[1:]):
        if flag == "--preset":
            assert (root / "deploy/presets" / f"{value}.txtpb").is_file(), f"there is no preset {value}"
        if flag == "--set" and value.startswith("scene_file="):  # else it would be looked for among deploy/scenes
            scene = value.split("=", 1)[1]
            assert scene.startswith(("/", "$PWD/")) or (root / "deploy/scenes" / scene).is_file(), f"there is no scene {scene}"
        if flag == "--set" and not value.startswith("scene."):
            assert re.search(rf"(?<![\w.]){re.escape(value.split('=')[0])}(?![\w.])", knobs()), f"there is no knob {value}"


def note_built(words, built):
    """Adds to `built` the programs that a command builds; None stands for all of them."""
    name = "/".join(words[0].split("/")[-2:])
    if name == "deploy/train.sh" or (name == "deploy/setup.sh" and "--no-tests" in words):
        built |= TRAINING
    elif name == "deploy/setup.sh" and "--packages-only" not in words:
        built.add(None)
    elif words[0] == "cmake" and "--target" in words:
        built |= set(words[words.index("--target") + 1:])


def check_built(words, built):
    for word in words:
        name = word.removeprefix("build/release/bin/")
        assert name == word or name in built or None in built, f"the page does not say how {name} is built"


@contextlib.contextmanager
def shell(commands, folder, said):
    # What it leaves in the background ends with it; files, for it would hold pipes open.
    process = subprocess.Popen(["bash", "-euo", "pipefail", "-c", commands], cwd=folder, stdout=said, stderr=said,
                               start_new_session=True)
    try:
        yield process
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()


def run(kind, block, folder):
    terminals = block.replace("\\\n", " ").splitlines() if kind == "terminals" else [block]
    with tempfile.TemporaryFile("w+") as said, contextlib.ExitStack() as open_ones:
        first, *_ = [open_ones.enter_context(shell(commands, folder, said)) for commands in terminals]
        code = first.wait(timeout=300 if kind == "run" else 3000)
        said.seek(0)
        assert code == 0, f"code {code}\n{said.read()[-4000:]}"


def check_page(page, root, binaries, options, kinds):
    """Runs the blocks of these kinds; yields what is wrong, and of which line."""
    text = page.read_text(encoding="utf-8")
    built = set()
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        (folder / "build/release").mkdir(parents=True)
        (folder / "build/release/bin").symlink_to(binaries)
        for part in ("deploy", "tests", "benchmarks"):
            (folder / part).symlink_to(root / part)
        if any(block[1] in kinds and "runs/omentum" in block[2] for block in BLOCK.finditer(text)):
            policy = gateway_rig.make_policy(binaries, folder, 1 + os.getpid() % 90)
            policy.rename(folder / "runs/omentum")
        for block in BLOCK.finditer(text):
            begin = time.monotonic()
            try:
                for words in commands(block[2]):
                    check(root, binaries, options, lambda: options.help(binaries / "learner"), words)
                    note_built(words, built)
                    check_built(words, built)
                if block[1] in kinds:
                    run(block[1], block[2], folder)
                    print(f"{page.name}: {time.monotonic() - begin:.0f} s: {block[2].splitlines()[0]}", flush=True)
            except AssertionError as fault:
                line = text.count("\n", 0, block.start()) + 1
                yield f"docs/start/{page.name}:{line}: {fault}"


def check_rows(page, root, binaries, options):
    """Commands in the tables of a page of results; yields what is wrong. That files and programs made by hand are there, and
    tests behind ctest -R, is asked by tests/lint/pages.py."""
    text = page.read_text(encoding="utf-8")
    short = dict(re.findall(r"`(\S+)` stands for `([^`]+)`", text))
    for number, line in enumerate(text.splitlines(), 1):
        for command in re.findall(r"`([^`]+)`", line) if line.startswith("|") else []:
            name, _, arguments = command.partition(" ")
            for words in commands(f"{short.get(name, name)} {arguments}"):
                words = words[1:] if words[0].endswith("python3") else words
                script, program = root / words[0], binaries / pathlib.Path(words[0]).name
                is_script = script.suffix in (".sh", ".py") and script.is_file()
                if not is_script and not program.is_file():
                    continue  # a path in a sentence, a preset, what is made by hand
                try:
                    known = script.read_text(encoding="utf-8") if is_script else options.of_command(program, words)
                    check_words(root, words[0], known, lambda: options.help(binaries / "learner"), words)
                except AssertionError as fault:
                    yield f"{page.relative_to(root)}:{number}: {fault}"


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("root", type=pathlib.Path)
    parser.add_argument("bin", type=pathlib.Path)
    parser.add_argument("--long", action="store_true")
    parser.add_argument("--page", default="*", help="of these alone")
    args = parser.parse_args()
    kinds = {"run", "long", "terminals"} if args.long else {"run"}
    root, binaries, options = args.root.resolve(), args.bin.resolve(), Options()
    faults = [fault for page in (root / "README.md", *sorted((root / "docs/results").glob("*.md")))
              for fault in check_rows(page, root, binaries, options)]
    pages = sorted((root / "docs/start").glob(f"{args.page}.md"))
    faults += [fault for page in pages for fault in check_page(page, root, binaries, options, kinds)]
    print("\n".join(faults) or f"the blocks of {len(pages)} pages stand")
    return 1 if faults or not pages else 0


if __name__ == "__main__":
    sys.exit(main())

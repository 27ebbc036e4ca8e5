#!/usr/bin/env python3
"""Pages that a reader meets first stay short: README at most 70 lines of 160 characters with a picture; docs/start, docs/results
and what was rewritten for readers at most 200 characters a line; the results 300 lines in all, their rows claim, figure, machine,
command, and the files that a command names are there. Pictures are 200 kB at most, with the command that makes them.
Argument: repository root."""
import pathlib
import re
import sys

REWRITTEN = ["docs/calibrate.md", "docs/import.md"]
ROW = ["claim", "figure", "machine", "command"]
# Of a command only what is here: files, programs that a CMake list makes, tests behind -R up to what a list composes.
FILE = re.compile(r"^(?:\./)?((?:tests|benchmarks|deploy)/[\w./-]+)$")
PROGRAM = re.compile(r"^build/release/bin/(\w+)$")
MADE = re.compile(r"\b(?:add_executable|omentum_\w*test|omentum_\w*program)\(\s*(\w+)")


def long_lines(path, limit):
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if len(line) > limit:
            yield f"{number}: {len(line)} characters of {limit}"


def made(root):
    """Programs of the build, and the text in which names of tests stand."""
    lists = "".join(path.read_text(encoding="utf-8") for path in root.rglob("CMakeLists.txt") if "build" not in path.relative_to(root).parts)
    tests = lists + "".join(path.read_text(encoding="utf-8") for path in (root / "tests").rglob("*.cpp"))
    return set(MADE.findall(lists)), tests


def unknown(command, root, programs, tests):
    """What a command names and nobody has."""
    words = command.split()
    for word, behind in zip(["", *words], words):
        if (file := FILE.match(behind)) and not behind.endswith("/NAME") and not (root / file[1]).exists():
            yield file[1]
        if (program := PROGRAM.match(behind)) and program[1] not in programs:
            yield behind
        if word == "-R" and not re.search(rf"{re.escape(behind.split('_')[0])}", tests):
            yield f"a test {behind}"


def rows(path, programs, tests):
    head = None
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        if not line.startswith("|"):
            head = None
            continue
        cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")]
        if head is None:
            head = cells
            if cells != ROW:
                yield f"{number}: a table has the columns {', '.join(ROW)}"
        elif not set(line) <= set("|-"):
            if len(cells) != 4 or not all(cells):
                yield f"{number}: a row has {len(cells)} of 4 cells, or an empty one"
            for command in re.findall(r"`([^`]*)`", cells[-1]):
                for what in unknown(command, path.parents[2], programs, tests):
                    yield f"{number}: {what} is not in the repository"


def faults(root):
    readme = root / "README.md"
    text = readme.read_text(encoding="utf-8")
    if len(text.splitlines()) > 70:
        yield f"README.md: {len(text.splitlines())} lines of 70"
    if not re.search(r"!\[.+\]\(docs/pictures/", text):
        yield "README.md: has no picture of docs/pictures"
    for fault in long_lines(readme, 160):
        yield f"README.md:{fault}"
    results = [root / "docs/results.md", *sorted((root / "docs/results").glob("*.md"))]
    for path in [*sorted((root / "docs/start").glob("*.md")), *results, *(root / name for name in REWRITTEN)]:
        for fault in long_lines(path, 200):
            yield f"{path.relative_to(root)}:{fault}"
    lines = sum(len(path.read_text(encoding="utf-8").splitlines()) for path in results)
    if lines > 300:
        yield f"docs/results: {lines} lines of 300 in all"
    programs, tests = made(root)
    for path in results[1:]:
        for fault in rows(path, programs, tests):
            yield f"{path.relative_to(root)}:{fault}"
    makers = (root / "docs/pictures/README.md").read_text(encoding="utf-8")
    for path in sorted((root / "docs/pictures").glob("*.*")):
        if path.suffix != ".md" and path.stat().st_size > 200_000:
            yield f"{path.relative_to(root)}: {path.stat().st_size} bytes of 200,000"
        if path.suffix != ".md" and path.name not in makers:
            yield f"{path.relative_to(root)}: docs/pictures/README.md does not say how it is made"


def main():
    found = list(faults(pathlib.Path(sys.argv[1])))
    print("\n".join(found) or "short enough")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

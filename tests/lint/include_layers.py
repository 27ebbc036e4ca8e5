#!/usr/bin/env python3
"""Who may include whom (docs/architecture.md). Argument: repository root."""
import pathlib
import re
import sys

ALLOWED = {
    "core": {"core", "proto"},
    "sim_worker": {"sim_worker", "core", "proto"},
    "learner": {"learner", "core", "proto"},
    "mismatch": {"mismatch", "sim_worker", "core", "proto"},
    "report": {"report", "sim_worker", "core", "proto"},
    "benchmarks": {"benchmarks", "report", "sim_worker", "learner", "core", "proto"},
}
# Folders of the tests are named from the tests' own root as well.
TESTS = {"tests", "support", "contract", "fuzz", "learner", "sim_worker", "report", "mismatch", "core", "proto", "benchmarks"}
GENERATED_WIRE = ("core/wire.cpp", "core/wire_check.cpp", "core/wire_fields.h", "core/topics.cpp")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')


def problems_of(root, path):
    relative = path.relative_to(root).as_posix()
    package = relative.split("/")[0]
    for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
        match = INCLUDE.match(line)
        if not match:
            continue
        quoted, name = match.group(1) == '"', match.group(2)
        where = f"{relative}:{number}: includes {name}: "
        if package != "tests" and name.startswith("dds/") and not re.fullmatch(r"core/dds\.(h|cpp)|core/wire\.cpp", relative):
            yield where + "only core/dds.* and core/wire.cpp may see the DDS interface"
        if package != "tests" and name == "omentum.h" and relative not in GENERATED_WIRE:
            yield where + "only core/wire* and core/topics.cpp may see the generated wire types"
        if quoted and "/" in name:
            target = name.split("/")[0]
            allowed = TESTS if package == "tests" else ALLOWED[package]
            if target not in allowed:
                yield where + f"{package} may include {', '.join(sorted(allowed))}"
        if name.endswith("main.cpp"):
            yield where + "programs never include programs"


def main():
    root = pathlib.Path(sys.argv[1])
    found, files = [], 0
    for package in [*ALLOWED, "tests"]:
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".h", ".cpp", ".inl"):
                files += 1
                found += problems_of(root, path)
    print("\n".join(found) or f"{files} files keep to the table")
    return 1 if found or files == 0 else 0


if __name__ == "__main__":
    sys.exit(main())

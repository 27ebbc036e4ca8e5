#!/usr/bin/env python3
"""Who may include whom (docs/architecture.md). Argument: repository root."""
import pathlib
import re
import sys

# Between packages.
ALLOWED = {
    "core": {"core", "proto"},
    "sim_worker": {"sim_worker", "core", "proto"},
    "granting": {"granting", "core", "proto"},
    "learner": {"learner", "granting", "core", "proto"},
    "mismatch": {"mismatch", "report", "sim_worker", "granting", "core", "proto"},
    "report": {"report", "sim_worker", "core", "proto"},
    "monitor": {"monitor", "report", "sim_worker", "core", "proto"},
    "dvrk_gateway": {"dvrk_gateway", "report", "sim_worker", "core", "proto"},
    "benchmarks": {"benchmarks", "report", "sim_worker", "learner", "core", "proto"},
}
# Within sim_worker: a folder includes itself and what stands before it. "models" is models.h, "" is main.cpp.
SIM_WORKER = ["lanes", "geometry", "instrument", "scene", "tissue", "cluster", "shell", "solid", "coupled", "reference",
              "models", "camera", "backend", "playback", "bus", ""]
# No model includes another model, except coupled, which joins two.
MODELS = {"cluster", "shell", "solid", "coupled", "reference"}
JOINED = {"coupled": {"shell", "solid"}}
# Within dvrk_gateway the same; "" are the files of the program itself.
DVRK_GATEWAY = ["protocol", "dvrk_double", "safety", "loop", "recording", "backend", "bus", ""]
# Within mismatch the same: recordings know nothing of simulation. "" are the programs, which lie in the folders of what
# they run, and may include all.
MISMATCH = ["recording", "import", "ros", "intake", "catalogue", "evidence", "simulate", "scene", "seen", "fit", "calibrate", "explain", ""]
MISMATCH_PROGRAM = ("main.cpp", "_program.h", "_program.cpp")
# Folders of the tests are named from the tests' own root as well.
TESTS = {"tests", "support", "contract", "fuzz", "granting", "learner", "sim_worker", "report", "mismatch", "monitor", "dvrk_gateway", "core", "proto", "benchmarks"}
GENERATED_WIRE = ("core/wire.cpp", "core/wire_fields.h")
INCLUDE = re.compile(r'^\s*#\s*include\s*([<"])([^>"]+)[>"]')


def folder_of(path):
    """Of a file of sim_worker, by its path from the root."""
    parts = path.split("/")[1:]
    if len(parts) > 1:
        return parts[0]
    return "models" if parts[0].startswith("models.") else ""


def problem_within_sim_worker(source, target):
    here, there = folder_of(source), folder_of(target)
    if there not in SIM_WORKER or here not in SIM_WORKER:
        return f"sim_worker has the folders {', '.join(SIM_WORKER[:-1])}"
    if SIM_WORKER.index(there) > SIM_WORKER.index(here):
        return f"{here} stands before {there}"
    if here in MODELS and there in MODELS and there != here and there not in JOINED.get(here, set()):
        return f"the model {here} may not know {there}"
    return None


def problem_within_dvrk_gateway(source, target):
    here, there = (path.split("/")[1] if path.count("/") > 1 else "" for path in (source, target))
    if there not in DVRK_GATEWAY or here not in DVRK_GATEWAY:
        return f"dvrk_gateway has the folders {', '.join(DVRK_GATEWAY[:-1])}"
    if DVRK_GATEWAY.index(there) > DVRK_GATEWAY.index(here):
        return f"{here} stands before {there or 'the program'}"
    return None


def mismatch_folder(path):
    parts = path.split("/")[1:]
    return "" if len(parts) == 1 or parts[-1].endswith(MISMATCH_PROGRAM) else parts[0]


def problem_within_mismatch(source, target):
    here, there = mismatch_folder(source), mismatch_folder(target)
    if there not in MISMATCH or here not in MISMATCH:
        return "mismatch has the folders " + ", ".join(MISMATCH[:-1])
    if MISMATCH.index(there) > MISMATCH.index(here):
        return f"{here or 'the program'} stands before {there or 'the program'}"
    return None


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
            yield where + "only core/wire.cpp and core/wire_fields.h may see the generated wire types"
        if quoted and "/" in name:
            target = name.split("/")[0]
            allowed = TESTS if package == "tests" else ALLOWED[package]
            if target not in allowed:
                yield where + f"{package} may include {', '.join(sorted(allowed))}"
            within = {"sim_worker": problem_within_sim_worker, "dvrk_gateway": problem_within_dvrk_gateway,
                      "mismatch": problem_within_mismatch}
            if package == target and package in within:
                problem = within[package](relative, name)
                if problem:
                    yield where + problem
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

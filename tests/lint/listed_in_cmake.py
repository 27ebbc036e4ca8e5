#!/usr/bin/env python3
"""Every file under tests/ takes part: sources and scripts are named in a CMake list, headers are included, data is
named by a test. Every .cpp of the packages is named in the list of its folder. Argument: repository root."""
import pathlib
import re
import sys

# Used by people or by the tool of the same name, not by a test.
BY_HAND = {"tests/.clang-tidy", "tests/run.sh", "tests/chaos/containers.sh", "tests/chaos/slurm.sh", "tests/lint/run_tidy.sh", "tests/support/tsan.supp", "tests/reference/README.md", "tests/mismatch/plants/README.md", "tests/mismatch/prove.sh", "tests/mismatch/plants/refinement.py"}
# Folders whose files a test finds by composed names.
BY_FOLDER = {"corpus", "maps", "results", "truths"}


def main():
    root = pathlib.Path(sys.argv[1])
    missing = []
    for package in ("core", "granting", "sim_worker", "learner", "report", "mismatch", "monitor", "dvrk_gateway", "benchmarks"):
        lists = (root / package / "CMakeLists.txt").read_text()
        missing += [f"{path.relative_to(root)} is not in {package}/CMakeLists.txt"
                    for path in sorted((root / package).rglob("*.cpp"))
                    if not re.search(rf"(?<![\w/]){re.escape(path.relative_to(root / package).as_posix())}(?![\w.])", lists)]
    tests = [path for path in sorted((root / "tests").rglob("*")) if path.is_file() and "__pycache__" not in path.parts]
    cmake = "\n".join(path.read_text() for path in tests if path.name == "CMakeLists.txt")
    code = "\n".join(path.read_text() for path in tests if path.suffix in (".cpp", ".h", ".py", ".txt"))
    for path in tests:
        name = path.relative_to(root).as_posix()
        if name in BY_HAND or path.name == "CMakeLists.txt" or BY_FOLDER & set(path.parts):
            continue
        text = cmake if path.suffix in (".cpp", ".sh") or "lint" in path.parts else code
        word = path.stem if path.suffix == ".py" and re.search(rf"\bimport {path.stem}\b|\bfrom {path.stem}\b", code) else path.name
        if not re.search(rf"(?<![\w.]){re.escape(word)}(?!\w)", text):
            missing.append(f"{name} is used by no test")
    print("\n".join(missing) or f"{len(tests)} files are in use")
    return 1 if missing else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""What conceals an effect shares nothing with what looks for it: the plants import the standard library, numpy, DOLFINx,
MuJoCo and each other, and nobody imports a plant. Argument: repository root."""
import ast
import pathlib
import sys

LIBRARIES = {"numpy", "basix", "dolfinx", "ufl", "mpi4py", "petsc4py", "mujoco"}
PLANTS = "tests/mismatch/plants"
# Folders of the repository that a plant might reach into by a path.
OTHERS = ("sim_worker", "learner", "granting", "report", "dvrk_gateway", "tests/reference", "calibrate")


def imports_of(path):
    """(line, name of the package)"""
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name.split(".")[0]) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.lineno, (node.module or "").split(".")[0]


def main():
    root = pathlib.Path(sys.argv[1])
    plants = sorted((root / PLANTS).glob("**/*.py"))
    own = {path.stem for path in plants}
    found = []
    for path in plants:
        name = path.relative_to(root).as_posix()
        for line, package in imports_of(path):
            if package not in own | LIBRARIES | set(sys.stdlib_module_names):
                found.append(f"{name}:{line}: a plant may not import {package}")
        for line, text in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            found += [f"{name}:{line}: a plant may not reach into {other}" for other in OTHERS if other in text]
    for path in sorted((root / "tests").rglob("*.py")):
        if path in plants:
            continue
        name = path.relative_to(root).as_posix()
        found += [f"{name}:{line}: imports the plant {package}" for line, package in imports_of(path)
                  if package in own and not (path.parent / f"{package}.py").exists()]
    for package in ("mismatch", "sim_worker"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix in (".h", ".cpp", ".inl") and PLANTS in path.read_text(encoding="utf-8"):
                found.append(f"{path.relative_to(root)}: the diagnoser names the plants")
    print("\n".join(found) or f"{len(plants)} files of plants share nothing")
    return 1 if found or not plants else 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""Every key [Name05] in a source is explained in docs/references.md, and every relative link of a document leads
somewhere. Argument: repository root."""
import pathlib
import re
import sys

KEY = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{2})\]")
LINK = re.compile(r"\]\(([^)#:]+)(?:#[^)]*)?\)")


def main():
    root = pathlib.Path(sys.argv[1])
    known = set(KEY.findall((root / "docs/references.md").read_text(encoding="utf-8")))
    found = []
    for package in ("core", "granting", "sim_worker", "learner", "report", "mismatch", "monitor", "dvrk_gateway", "proto", "idl", "benchmarks", "tests", "deploy", "docs"):
        for path in sorted((root / package).rglob("*")):
            if path.suffix not in (".h", ".cpp", ".inl", ".proto", ".idl", ".txtpb", ".md"):
                continue
            for key in sorted(set(KEY.findall(path.read_text(encoding="utf-8"))) - known):
                found.append(f"{path.relative_to(root)}: [{key}] is not in docs/references.md")
    for path in [*sorted(root.glob("*.md")), *sorted((root / "docs").rglob("*.md"))]:
        for target in LINK.findall(path.read_text(encoding="utf-8")):
            if not (path.parent / target).exists():
                found.append(f"{path.relative_to(root)}: link to {target} leads nowhere")
    print("\n".join(found) or f"{len(known)} references")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

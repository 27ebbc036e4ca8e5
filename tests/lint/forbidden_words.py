#!/usr/bin/env python3
"""Tracked text holds no unfinished business, machine paths or package hosts, and no tabs or blanks at line ends.
Argument: repository root. Exit code 77 (skipped) outside a git checkout."""
import pathlib
import re
import subprocess
import sys

# Spelt in parts, so that this file passes its own check.
RULES = [
    (re.compile(r"\b(TO" r"DO|FIX" r"ME|XX" r"X)\b"), "unfinished business"),
    (re.compile(r"/(home|ro" r"ot|wo" r"rk|mnt|Users)/\w"), "path of one machine"),
    (re.compile(r"(deb\.deb" r"ian\.org|pypi\.org|files\.python" r"hosted)"), "package host"),
    (re.compile(r"<<<<" r"<<<|>>>>" r">>>"), "merge conflict"),
    (re.compile(r"[ \t]+$"), "blanks at the end of the line"),
]
TEXT = {".h", ".cpp", ".inl", ".proto", ".idl", ".txtpb", ".txt", ".md", ".py", ".sh", ".xml", ".yaml", ".json", ".glsl"}


def main():
    root = pathlib.Path(sys.argv[1])
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, check=False)
    if listing.returncode != 0:
        print("not a git checkout: nothing is tracked")
        return 77
    found = []
    for name in filter(None, listing.stdout.decode().split("\0")):
        path = root / name
        if not path.is_file() or (path.suffix not in TEXT and path.name not in ("Dockerfile", "run")):
            continue
        for number, line in enumerate(path.read_text(encoding="utf-8").splitlines(), 1):
            found += [f"{name}:{number}: {what}" for rule, what in RULES if rule.search(line)]
    print("\n".join(found) or "clean")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

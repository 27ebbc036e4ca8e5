#!/usr/bin/env python3
"""Every knob of proto/config.proto and of what it is made of, of proto/registration.proto and of proto/safety.proto is
read by some program. A knob is read where its accessor is called, a case names it, or a table gives its path. Names are
compared, not types: a knob that shares its name with another field can hide behind it. Argument: repository root; a
second one checks other sources than the packages'."""
import pathlib
import re
import sys

PROTOS = ("config", "scene", "effects", "tissue_effects", "registration", "safety")
PACKAGES = ("core", "sim_worker", "learner", "report", "mismatch", "dvrk_gateway")
FOR_PEOPLE = {
    "preset": "says in the printed configuration where it came from",
}
FIELD = re.compile(r"^\s*(?:optional |repeated |required )?[\w.]+ (\w+) = \d+\b")


def fields_of(text):
    inside = []  # kinds of the open braces
    for number, line in enumerate(text.splitlines(), 1):
        code = line.split("//")[0]
        field = FIELD.match(code)
        if field and inside and inside[-1] in ("message", "oneof"):
            yield number, field.group(1)
        opened = re.match(r"\s*(message|oneof|enum|extend)\b", code)
        if opened and "{" in code and "}" not in code:
            inside.append(opened.group(1))
        elif code.strip() == "}":
            inside.pop()


def is_read(name, code):
    camel = "".join(part.capitalize() for part in name.split("_"))
    return re.search(rf"(?:\.|->)\s*(?:has_)?{name}(?:_size)?\s*\(\s*\w*\s*\)|\bk{camel}\b", code) or \
        re.search(rf'"(?:\w+(?:\[\d+\])?\.)*{name}(?:\[\d+\])?(?:\.\w+)*"', code)


def main():
    root = pathlib.Path(sys.argv[1])
    folders = [pathlib.Path(sys.argv[2])] if len(sys.argv) > 2 else [root / package for package in PACKAGES]
    sources = [path for folder in folders for path in sorted(folder.rglob("*")) if path.suffix in (".h", ".cpp", ".inl")]
    code = "\n".join(re.sub(r"//[^\n]*", "", path.read_text(encoding="utf-8")) for path in sources)
    unread, count = [], 0
    for proto in PROTOS:
        for number, name in fields_of((root / "proto" / f"{proto}.proto").read_text(encoding="utf-8")):
            count += 1
            if name not in FOR_PEOPLE and not is_read(name, code):
                unread.append(f"proto/{proto}.proto:{number}: nothing reads {name}")
    print("\n".join(unread) or f"{count} knobs are read")
    return 1 if unread or count < 100 else 0


if __name__ == "__main__":
    sys.exit(main())

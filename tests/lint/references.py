#!/usr/bin/env python3
"""Every key [Name05] in a source is explained in docs/references.md, and every relative link of a document leads
somewhere, to the heading that it names as well. Argument: repository root."""
import pathlib
import re
import sys

KEY = re.compile(r"\[([A-Z][A-Za-z]+[0-9]{2})\]")
LINK = re.compile(r"\]\(([^)#:]*)(?:#([^)]*))?\)")


def anchors(text):
    """Of the headings of a page, as they are made where it is shown: small letters, blanks as hyphens, no other marks."""
    text = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    found = {}
    for heading in re.findall(r"^#+ +(.+?) *$", text, re.MULTILINE):
        name = re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")
        found[name] = found.get(name, -1) + 1
    return {f"{name}-{k}" if k else name for name, count in found.items() for k in range(count + 1)}


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
        text = path.read_text(encoding="utf-8")
        for target, anchor in LINK.findall(text):
            page = path.parent / target if target else path
            if not page.exists():
                found.append(f"{path.relative_to(root)}: link to {target} leads nowhere")
            elif anchor and page.suffix == ".md" and anchor not in anchors(page.read_text(encoding="utf-8")):
                found.append(f"{path.relative_to(root)}: {target} has no heading #{anchor}")
    print("\n".join(found) or f"{len(known)} references")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

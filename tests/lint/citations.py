#!/usr/bin/env python3
"""Every page that a comment, a knob or a document cites is in the repository, with the section and the row it names:
`docs/tissue.md 3.3`, `docs/mismatch.md 1 rows 26 and 28`, `[wire](wire.md) 4.3`, `decision 0014`. Argument: root."""
import pathlib
import re
import sys

FOLDERS = ("core", "granting", "sim_worker", "learner", "report", "mismatch", "monitor", "dvrk_gateway", "proto", "idl", "benchmarks", "tests", "deploy", "docs")
TEXT = {".h", ".cpp", ".inl", ".proto", ".idl", ".txtpb", ".txt", ".md", ".py", ".sh", ".xml", ".supp"}
# A citation may go on in the next line of a comment.
GAP = r"(?:[ ]|[ ]?\n[ \t]*(?:///<?|//|#)?[ ]?)"
NUMBER = r"\d+(?:\.\d+)*"
ROW = r"(?:[A-Z]\d+|\d+)"
PAGE = re.compile(
    rf"(?P<page>[\w./-]*\w\.md)\b\)?"
    rf"(?:{GAP}(?P<sections>{NUMBER}(?:,{GAP}{NUMBER})*)(?![\w.]*\d)"
    rf"(?:,?{GAP}(?:rows?{GAP}(?P<rows>{ROW}(?:{GAP}and{GAP}{ROW})*)|(?P<label>[A-Z]\d+)))?)?")
DECISION = re.compile(rf"(?:docs/decisions/|\bdecisions?{GAP})(?P<numbers>\d{{4}}(?:(?:,{GAP}|{GAP}and{GAP})\d{{4}})*)")


def headings(text):
    return set(re.findall(rf"^#+ ({NUMBER})\.? ", text, re.MULTILINE))


def section(text, number):
    """Text of a numbered section, without what follows at its level or above."""
    begin = re.search(rf"^(#+) {re.escape(number)}\.? ", text, re.MULTILINE)
    end = re.compile(rf"^#{{1,{len(begin[1])}}} ", re.MULTILINE).search(text, begin.end())
    return text[begin.end():end.start() if end else len(text)]


def faults(root, path, decisions):
    text = path.read_text(encoding="utf-8")
    for cited in PAGE.finditer(text):
        name = cited["page"]
        if "://" in text[max(0, cited.start() - 9):cited.start() + 1] or re.fullmatch(r"[*.]*\.md", name):
            continue
        page = root / name
        if not page.is_file() and path.suffix == ".md":
            page = path.parent / name
        line = text.count("\n", 0, cited.start()) + 1
        if not page.is_file():
            yield line, f"{name} is not in the repository"
            continue
        if not cited["sections"]:
            continue
        content = page.read_text(encoding="utf-8")
        numbers = re.findall(NUMBER, cited["sections"])
        for number in numbers:
            if number not in headings(content):
                yield line, f"{name} has no section {number}"
        for row in re.findall(ROW, cited["rows"] or cited["label"] or ""):
            if numbers[-1] in headings(content) and f"\n| {row} |" not in section(content, numbers[-1]):
                yield line, f"section {numbers[-1]} of {name} has no row {row}"
    for cited in DECISION.finditer(text):
        for number in re.findall(r"\d{4}", cited["numbers"]):
            if number not in decisions:
                yield text.count("\n", 0, cited.start()) + 1, f"decision {number} is not in docs/decisions"


def main():
    root = pathlib.Path(sys.argv[1])
    decisions = {path.name[:4] for path in (root / "docs/decisions").glob("*.md")}
    files = [*root.glob("*.md"), root / "CMakeLists.txt"]
    for folder in FOLDERS:
        files += [path for path in (root / folder).rglob("*") if path.suffix in TEXT and "corpus" not in path.parts]
    found = []
    for path in sorted(files):
        if path.resolve() == pathlib.Path(__file__).resolve():
            continue
        found += [f"{path.relative_to(root)}:{line}: {what}" for line, what in faults(root, path, decisions)]
    print("\n".join(found) or f"{len(files)} files cite pages that are here")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

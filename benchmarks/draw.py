#!/usr/bin/env python3
"""One page of all figures: what `benchmarks/run.sh --save` appended to benchmarks/results, each figure over time with the machine
it is of, and the rows of docs/results. Writes OUT/results.html and OUT/published.csv (page, section, claim, figure, machine, command).

usage: draw.py OUT
"""
import csv
import html
import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).resolve().parent.parent
COLUMNS = ["claim", "figure", "machine", "command"]
STYLE = "body { font: 14px sans-serif; margin: 2em } td, th { padding: .2em .8em; text-align: left; border-bottom: 1px solid #ddd } svg { vertical-align: middle }"


def published(root=ROOT):
    """Rows of the tables of docs/results whose columns are those of a claim."""
    for page in sorted((root / "docs/results").glob("*.md")):
        section, inside = "", False
        for line in page.read_text(encoding="utf-8").splitlines():
            if line.startswith("#"):
                section, inside = line.lstrip("# "), False
            cells = [cell.strip() for cell in line.strip().strip("|").split(" | ")] if line.startswith("|") else []
            if cells == COLUMNS:
                inside = True
            elif inside and cells and not set(line) <= set("|-"):
                yield [page.stem, section, *cells]
            elif not cells:
                inside = False


def measured():
    """Figures by name, and by machine within it: rows in the order of their dates."""
    figures = {}
    for path in sorted((ROOT / "benchmarks/results").glob("*.csv")):
        with path.open(newline="", encoding="utf-8") as file:
            for row in csv.DictReader(file):
                machine = f"{path.stem} {row['machine'] or ''}".strip()
                figures.setdefault((row["group"], row["name"], row["unit"]), {}).setdefault(machine, []).append(row)
    return figures


def curve(values):
    if len(values) < 2:
        return ""
    low, high = min(values), max(values)
    points = " ".join(f"{4 + 112 * k / (len(values) - 1):.1f},{20 - 16 * (v - low) / (high - low or 1):.1f}" for k, v in enumerate(values))
    return f'<svg width="120" height="24"><polyline points="{points}" fill="none" stroke="#06c"/></svg>'


def table(head, rows):
    cells = "".join(f"<th>{html.escape(h)}</th>" for h in head)
    return f"<table><tr>{cells}</tr>" + "".join("<tr>" + "".join(f"<td>{c}</td>" for c in row) + "</tr>" for row in rows) + "</table>"


def page(claims, figures):
    parts = [f"<!doctype html><meta charset='utf-8'><title>Omentum: results</title><style>{STYLE}</style><h1>Measured</h1>"]
    for group in sorted({key[0] for key in figures}):
        rows = []
        for (_, name, unit), machines in sorted((k, m) for k, m in figures.items() if k[0] == group):
            for machine, found in sorted(machines.items()):
                found = sorted(found, key=lambda row: row["date"])
                last = found[-1]
                rows.append([*map(html.escape, (name, f"{last['value']} {unit}", machine, last["date"][:10], last["commit"], last["load"] or "")),
                             curve([float(row["value"]) for row in found])])
        parts.append(f"<h2>benchmarks/run.sh {html.escape(group)}</h2>" + table(["figure", "newest", "machine", "date", "commit", "load", "all"], rows))
    parts.append("<h1>Published</h1>" + table(["page", "section", *COLUMNS], [map(html.escape, row) for row in claims]))
    return "\n".join(parts)


def main():
    if len(sys.argv) != 2 or sys.argv[1].startswith("-"):
        print(__doc__)
        return 0 if sys.argv[1:] in (["-h"], ["--help"]) else 2
    out = pathlib.Path(sys.argv[1])
    out.mkdir(parents=True, exist_ok=True)
    claims, figures = list(published()), measured()
    (out / "results.html").write_text(page(claims, figures), encoding="utf-8")
    with (out / "published.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file, lineterminator="\n").writerows([["page", "section", *COLUMNS], *claims])
    print(f"{out / 'results.html'}: {len(figures)} figures measured, {len(claims)} claims")
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""Scores verdicts against labels: ./score.py LABELS VERDICTS.

LABELS holds <case>.json as tests/mismatch/plants writes them, VERDICTS <case>/verdict.json. Prints one row per case and
engine sums: false alarms with power and abstention beside them, first name right, class right, wrong and certain; then
the same sums for two tools that know nothing: one always silent, one that names `inclusion` in every case.

  false alarm   a null with any status but no_mismatch_detectable
  top-1         the most probable member of the strongest effect has the label's name
  class         the label's name is in the class; a class outside the table counts 1 / members
  abstained     a concealed effect answered by no name
  certain wrong a name or class without the label's, its largest share .8 or more
"""
import argparse
import json
import math
import pathlib
import sys

# Effects that no recording of these protocols separates; fixed before any case was made.
ONE_CLASS = [
    {"actuation_delay", "camera_time_offset"}, {"grasp_compliance", "tool_compliance"}, {"density", "bending_stiffness"},
    {"anchor_detachment", "anchor_compliance"}, {"tool_backlash", "tool_friction"}]
SILENT = "no_mismatch_detectable"
NAMED = ("explained", "explained_as_class", "partly_explained")


def members_of(effect):
    """[(name, probability)], most probable first."""
    found = [(m["name"], float(m.get("probability", 0))) for m in effect.get("class", {}).get("members", [])]
    return sorted(found, key=lambda m: -m[1])


def classes(verdict):
    if verdict["status"] not in NAMED:
        return []
    return [m for m in map(members_of, verdict.get("effects", [])) if m]


def in_table(names):
    return len(names) == 1 or any(names <= group for group in ONE_CLASS)


def distance_mm(label, effect):
    at, true = (effect.get("where") or {}).get("centre_m"), label["effects"][0]["where"].get("centre_m")
    return None if not at or not true else 1e3 * math.dist(at[:2], true[:2])


def score(label, verdict):
    """One case -> numbers, to be summed."""
    null = not label["effects"]
    named = classes(verdict)
    out = {"null": null, "status": verdict["status"], "names": [[name for name, _ in c] for c in named], "mm": None,
           "false_alarm": null and verdict["status"] != SILENT, "abstained": not null and not named,
           "top1": 0.0, "class": 0.0, "size": len(named[0]) if named else 0, "wrong_certain": False}
    if null:
        out["wrong_certain"] = any(c[0][1] >= .8 for c in named)
        return out
    true = label["effects"][0]["name"]
    if named:
        first = named[0]
        names = {name for name, _ in first}
        out["top1"] = float(first[0][0] == true)
        if true in names:
            out["class"] = 1.0 if in_table(names) else 1 / len(names)
            out["mm"] = distance_mm(label, verdict["effects"][0])
        out["wrong_certain"] = first[0][1] >= .8 and true not in names
    return out


def silent(label):
    return {"status": SILENT, "effects": []}


def naming(label):
    return {"status": "explained", "effects": [{"class": {"members": [{"name": "inclusion", "probability": 1.0}]}}]}


def upper_bound(k, n):
    """One-sided 95 % bound of a share, exact (Clopper and Pearson), by bisection."""
    if n == 0 or k == n:
        return 1.0
    low, high = k / n, 1.0
    for _ in range(60):
        p = (low + high) / 2
        below = sum(math.comb(n, i) * p**i * (1 - p)**(n - i) for i in range(k + 1))
        low, high = (p, high) if below > .05 else (low, p)
    return high


def sums(rows):
    nulls, others = [r for r in rows if r["null"]], [r for r in rows if not r["null"]]
    total = lambda key, some: sum(float(r[key]) for r in some)
    n, m = len(nulls), len(others)
    alarms = int(total("false_alarm", nulls))
    sizes = [r["size"] for r in others if r["size"]]
    mm = sorted(r["mm"] for r in others if r["mm"] is not None)
    return (f"false alarms {alarms} of {n} (95 % below {upper_bound(alarms, n):.2f}); of {m} concealed: named {m - int(total('abstained', others))}, "
            f"abstained {int(total('abstained', others))}, top-1 {total('top1', others):.0f}, class {total('class', others):.2f}, "
            f"wrong and certain {int(total('wrong_certain', rows))}, mean size of the class "
            f"{sum(sizes) / len(sizes) if sizes else float('nan'):.2f}, median place {mm[len(mm) // 2] if mm else float('nan'):.1f} mm")


def read(folder, name):
    path = pathlib.Path(folder) / name / "verdict.json"
    if not path.exists():
        return {"status": "no verdict", "effects": []}
    return json.loads(path.read_text())


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("labels")
    parser.add_argument("verdicts")
    a = parser.parse_args()
    labels = [json.loads(path.read_text()) for path in sorted(pathlib.Path(a.labels).glob("*.json"))]
    if not labels:
        raise SystemExit(f"{a.labels} holds no label")
    rows = [score(label, read(a.verdicts, label["case"])) for label in labels]
    print(f"{'case':12} {'concealed':20} {'status':24} {'named':36} {'mm':>6}")
    for label, row in zip(labels, rows):
        true = label["effects"][0]["name"] if label["effects"] else "-"
        named = "; ".join("{" + ", ".join(c) + "}" if len(c) > 1 else c[0] for c in row["names"]) or "-"
        mm = f"{row['mm']:.1f}" if row["mm"] is not None else ""
        print(f"{label['case']:12} {true:20} {row['status']:24} {named:36} {mm:>6}")
    for engine in sorted({label["engine"] for label in labels}):
        some = [(label, row) for label, row in zip(labels, rows) if label["engine"] == engine]
        print(f"\n{engine}\n  tool          {sums([row for _, row in some])}")
        for name, baseline in (("always silent", silent), ("always naming", naming)):
            print(f"  {name} {sums([score(label, baseline(label)) for label, _ in some])}")
    return 0


if __name__ == "__main__":
    sys.exit(main())

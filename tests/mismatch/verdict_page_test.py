#!/usr/bin/env python3
"""report.html of `mismatch explain`: every section that its head leads to is there and says something, rows are as long as the heads
of their tables, cells of maps touch, and the commands under "Use it" run as they are printed in the folder of the page: RECORDINGS and OUT are folders of
the reader.

usage: verdict_page_test.py MISMATCH LEARNER
"""
import html
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

import poor_recordings_test as poor

# So that the test is short: the first would train, the second would simulate on a fine mesh.
SHORTER = {"learner": "--dry-run", "mismatch": "--tolerance-mm 4"}


def plain(markup):
    return html.unescape(re.sub(r"<[^>]*>", "", markup)).strip()


def check_sections(page, verdict):
    linked = re.findall(r'<a href="#(\w+)">', page.partition("</nav>")[0])
    sections = dict(re.findall(r'<section id="(\w+)">(.*?)</section>', page, re.DOTALL))
    assert list(sections) == linked and {"what", "fit", "limits", "use", "warnings"} <= set(linked), (linked, list(sections))
    for name, content in sections.items():
        assert len(plain(content)) > 20, (name, content)
    for table in re.findall(r"<table>(.*?)</table>", page, re.DOTALL):
        rows = [re.findall(r"<t[hd][^>]*>", row) for row in re.findall(r"<tr>(.*?)</tr>", table)]
        assert len({len(row) for row in rows}) == 1, table
    limits = plain(sections["limits"])
    assert len(verdict["detection_limits"]) > 3 and all(row["effect"] in limits for row in verdict["detection_limits"]), limits
    assert "delay of the arm" in limits and not re.search(r"@|\de-\d|numerics\.", limits), limits
    status = verdict["status"].replace("_", " ")
    assert f'<div class="value">{status}</div><div class="name">status' in page, "the status is words, which break"
    return sections


def check_maps(section):
    """Cells are as wide and as high as places are apart, but for the hairline between them."""
    maps = [figure for figure in re.findall(r"<figure.*?</figure>", section, re.DOTALL) if "x_B, mm" in figure]
    assert maps
    for figure in maps:
        cells = re.findall(r'<rect x="([-\d.]+)" y="([-\d.]+)" width="([\d.]+)" height="([\d.]+)" fill="[^"]*"><title>x ', figure)
        for at, size in ((0, 2), (1, 3)):
            places = sorted({float(cell[at]) for cell in cells})
            apart = min(b - a for a, b in zip(places, places[1:]) if b - a > 0.2)  # a tenth is the digit written
            assert abs(apart - float(cells[0][size]) - 0.4) < 0.2, (figure[:200], apart, cells[0])


def check_commands(section, programs, folder):
    commands = plain(re.search(r"<pre>(.*?)</pre>", section, re.DOTALL)[1]).splitlines()
    assert [command.split()[0] for command in commands] == list(SHORTER), commands
    path = os.pathsep.join([*(str(p.resolve().parent) for p in programs), os.environ["PATH"]])
    for command in commands:
        typed = command.replace("RECORDINGS", str(folder / "lifts")).replace("OUT", str(folder / "new"))
        done = subprocess.run(["bash", "-c", f"{typed} {SHORTER[command.split()[0]]}"], cwd=folder / "out",
                              env=os.environ | {"PATH": path}, capture_output=True, text=True)
        assert done.returncode == 0, (command, done.returncode, done.stderr)
    assert list((folder / "new" / "predictions").glob("*.npz")), list((folder / "new").iterdir())


def main():
    programs = [pathlib.Path(a) for a in sys.argv[1:]]
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        code, told, _, _ = poor.explain(programs[0], folder, poor.write_lifts(programs[0], folder, 1, (0, 0.8)))
        assert code == 0, told
        page = (folder / "out" / "report.html").read_text()
        sections = check_sections(page, json.loads((folder / "out" / "verdict.json").read_text()))
        check_maps(sections["what"])
        check_commands(sections["use"], programs, folder)


if __name__ == "__main__":
    main()

#!/usr/bin/env python3
"""`mismatch locate|name|model|show` on stored verdicts (tests/fuzz/corpus/verdict): each prints its part; a file that is
missing, cut off, of another version or no verdict is refused with one line and code 2.

usage: verdict_program_test.py MISMATCH
"""
import json
import pathlib
import re
import subprocess
import sys
import tempfile

CORPUS = pathlib.Path(__file__).parents[1] / "fuzz" / "corpus" / "verdict"
PARTS = ("locate", "name", "model", "show")


def run(program, part, out, code=0):
    done = subprocess.run([program, part, str(out)], capture_output=True, text=True)
    assert done.returncode == code, (part, done.returncode, done.stderr)
    return done.stdout if code == 0 else done.stderr


def expect(text, *parts):
    for part in parts:
        assert part in text, (part, text)


def check_parts(program, out):
    (out / "verdict.json").write_text((CORPUS / "class.json").read_text())
    said = {part: run(program, part, out) for part in PARTS}
    sentence = "The simulation leaves out a stiffer place (inclusion) or bending_stiffness at x = 2.0, y = 4.0 mm from the middle of the sheet"
    expect(said["locate"], "at x = 2.0, y = 4.0 mm", "(half of it within 1.5 mm)", "inclusion.k, z by place:", "12.6")
    rows = [line.split() for line in said["locate"].splitlines()]
    assert ["4.0", "-0.5", "12.6"] in rows and ["-5.0", "1.2", "3.4"] in rows and ["obstacle.height", "4.2", "1.00", "2.00"] in rows, rows
    expect(said["name"], sentence, "status: explained_as_class", "bending_stiffness", "0.20", "not confirmed: no recording was held out",
           "it rests on lift0 alone", "inclusion.k at x = 2.0, y = 4.0 mm: 64; rest_shape.twist: 9.5", "gain 132 nats, claimed above 50", "k = 4.5, r = 8.5 mm")
    expect(said["model"], "4.5", "3.1", "6.2", "8.5 mm", "stiffness there over that of the rest",
           "at the end of its range", "stiffness_change: 3.5", str(out / "scene.repaired.txtpb"))
    expect(said["show"], sentence, "noise floor, mm", "8.5 mm", "lift5", "0.55", "0.33", "inclusion.k", "1.4", "never", "nothing is trimmed below 5")
    assert run(program, "show", out / "verdict.json") == said["show"]
    steered = json.loads((CORPUS / "class.json").read_text()) | {"warnings": ["\x1b[2Jgone"]}
    (out / "verdict.json").write_text(json.dumps(steered))
    expect(run(program, "show", out), "warning: ?[2Jgone")

    (out / "verdict.json").write_text((CORPUS / "null.json").read_text())
    said = {part: run(program, part, out) for part in PARTS}
    for part in ("name", "show"):
        expect(said[part], "No mismatch is detectable", "status: no_mismatch_detectable")
    expect(said["locate"], "Nothing is named", "anchor_detachment.length, z by place:")
    expect(said["model"], "the base alone was refitted")
    expect(said["show"], "would be seen")
    rows = [re.split("  +", line.strip()) for line in said["show"].splitlines()]
    assert ["actuation_delay.tau", "10.2 ms", "10.3 ms", "0.448 ms", "delay of the arm"] in rows, rows
    assert any(row[:4] == ["adhesion.k", "0.0554 kPa/mm", "0.08 kPa/mm", "0.0576 kPa/mm"] for row in rows), rows


def check_refusals(program, out):
    whole = (CORPUS / "class.json").read_text()
    verdict = json.loads(whole)
    file = out / "verdict.json"

    def changed(**values):
        return json.dumps({key: value for key, value in (verdict | values).items() if value is not None})

    wrong = {
        whole[: len(whole) // 2]: "cut off",
        "": "cut off",
        "[1, 2]": "no JSON of a verdict",
        '{"format_version": 1, "method": "reference"}': "status is none of",
        "{}": "this is no verdict",
        changed(format_version=2): "format_version: 2, allowed 1",
        changed(format_version=None): "no format_version",
        changed(status="fine"): "status is none of explained",
        changed(effects=[]): "an effect without a name",
        changed(effects=[{"gain": 3}]): "an effect without a name",
        changed(effects="inclusion"): "no JSON of a verdict",
    }
    for text, part in wrong.items():
        file.write_text(text)
        for command in PARTS:
            told = run(program, command, out, code=2)
            assert told.startswith(f"mismatch: {file}: ") and part in told and told.count("\n") == 1, (text[:60], told)
    file.unlink()
    told = run(program, "show", out, code=2)
    assert told.startswith(f"mismatch: {file}: cannot be opened") and told.count("\n") == 1, told
    file.write_text(changed(of_a_later_revision={"a": [1]}))
    run(program, "show", out)


def main():
    with tempfile.TemporaryDirectory() as name:
        out = pathlib.Path(name)
        check_parts(sys.argv[1], out)
        check_refusals(sys.argv[1], out)


if __name__ == "__main__":
    main()

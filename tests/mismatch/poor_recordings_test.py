#!/usr/bin/env python3
"""`mismatch explain` on recordings that say little: what can still be said is said, what cannot is told in one line.

usage: poor_recordings_test.py MISMATCH CASE
"""
import json
import pathlib
import shutil
import subprocess
import sys
import tempfile

import explained_lifts as lifts
import small_lifts as small

MESHES = ("--tolerance-mm", 4, "--coarse-mm", 8)
SLOW = "anchor_detachment inclusion adhesion obstacle grasp_slip jaw_orientation viscoelastic anisotropy tool_compliance".split()


def write_lifts(program, folder, count, times):
    """The first lifts of explained_lifts.py with clouds at these times alone."""
    lifts.PINCHES, lifts.HELD_OUT = lifts.PINCHES[:count], -1
    lifts.write_case(program, folder, "null", mesh_mm=4, rate=5)
    for recording in sorted((folder / "lifts").iterdir()):
        head, *rows = (recording / "clouds.csv").read_text().splitlines()
        kept = [row for row in rows if min(abs(float(row.split(",")[0]) - t) for t in times) < 1e-6]
        assert len(kept) == len(times), (rows, times)
        (recording / "clouds.csv").write_text("\n".join([head, *kept]) + "\n")
    return [folder / "lifts" / f"lift{k}" for k in range(count)]


def explain(program, folder, recordings, more=(), limit=None):
    out = folder / "out"
    shutil.rmtree(out, ignore_errors=True)
    words = [program, "explain", "--scene", folder / "believed.txtpb", "-o", out, *MESHES,
             *[word for name in SLOW for word in ("--rule-out", name)], *more, "-r", *recordings]
    if limit:  # no file may grow beyond so many blocks of 512 bytes, as on a full disk
        words = ["/bin/sh", "-c", f"trap '' XFSZ; ulimit -f {limit}; exec \"$@\"", "sh", *words]
    done = subprocess.run([str(w) for w in words], capture_output=True, text=True)
    told = [line for line in done.stderr.splitlines() if not line.startswith("explain: ")]  # progress
    verdict = json.loads((out / "verdict.json").read_text()) if out.exists() else None
    return done.returncode, told, verdict, done.stdout


def refused(result, *parts):
    code, told, verdict, _ = result
    told = [line for line in told if not line.startswith("warning: ")]
    assert code == 2 and verdict is None and len(told) == 1, result
    for part in parts:
        assert part in told[0], (part, told)


def said(result, *parts):
    code, told, verdict, _ = result
    assert code == 0 and verdict["status"], result
    warnings = verdict["warnings"]
    for part in parts:
        assert any(part in line for line in warnings) and any(part in line for line in told), (part, warnings)
    return verdict


def append(recordings, text):
    for recording in recordings:
        with open(recording / "recording.txtpb", "a") as file:
            file.write(text)


def one(program, folder):
    verdict = said(explain(program, folder, write_lifts(program, folder, 1, (0, 0.8, 1.4))), "it locates and tests, and confirms nothing; record next")
    assert all(not effect.get("confirmed") for effect in verdict.get("effects", [])) and verdict["detection_limits"], verdict


def held_out(program, folder):
    recordings = write_lifts(program, folder, 2, (0, 0.8))
    append(recordings, "held_out: true\n")
    refused(explain(program, folder, recordings), "every recording is held out")


def no_camera(program, folder):
    recordings = write_lifts(program, folder, 1, (0, 0.8, 1.4))
    scene = folder / "believed.txtpb"
    scene.write_text(scene.read_text().replace(small.CAMERA, ""))
    said(explain(program, folder, recordings), "no camera pose is stated", "record next")


def at_rest(program, folder):
    verdict = said(explain(program, folder, write_lifts(program, folder, 1, (0,))), "before it is moved alone", "record clouds while it is lifted")
    limits = {row["effect"]: row for row in verdict["detection_limits"]}
    assert not limits["tool_backlash.b_z"].get("testable") or limits["tool_backlash.b_z"]["amplitude"] > 0.005, limits["tool_backlash.b_z"]


def nothing_grasped(program, folder):
    recordings = write_lifts(program, folder, 1, (0, 0.8))
    tool = recordings[0] / "tool.csv"
    head, *rows = tool.read_text().splitlines()
    tool.write_text("\n".join([head, *(row.rsplit(",", 1)[0] + ",0.4" for row in rows)]) + "\n")  # the jaws stay open
    said(explain(program, folder, recordings), "takes hold of the tissue")


def cut_off(program, folder):
    recordings = write_lifts(program, folder, 1, (0, 0.4, 0.8, 1.4))
    tool = recordings[0] / "tool.csv"
    rows = tool.read_text().splitlines()
    tool.write_text("\n".join(rows[: 1 + 46]) + "\n" + rows[47][:9])  # in the middle of the row of 0.92 s
    code, told, verdict, _ = explain(program, folder, recordings)
    if code == 2:  # of the row that is half there
        refused((code, told, verdict, ""), "tool.csv:48")
        tool.write_text("\n".join(rows[: 1 + 46]) + "\n")
    said(explain(program, folder, recordings), "its commands end at 0.90 s: 1 of its 4 frames", "record next")


def one_unreadable(program, folder):
    """Of three recordings in a folder one has a table that was cut off; of one alone that is a refusal."""
    lift = write_lifts(program, folder, 3, (0, 0.8))[1]
    rows = (lift / "tool.csv").read_text().splitlines()
    (lift / "tool.csv").write_text("\n".join(rows[:47]) + "\n" + rows[47][:9])
    told = f"{lift}/tool.csv:48"
    verdict = said(explain(program, folder, [folder / "lifts"]), told)
    assert [row["id"] for row in verdict["recordings"]] == ["lift0", "lift2"], verdict["recordings"]
    refused(explain(program, folder, [lift]), told)
    small.calibrate(program, folder, folder / "fitted", ("--no-leave-out", "--tolerance-mm", 4))
    warnings = json.loads((folder / "fitted" / "calibration.json").read_text())["warnings"]
    assert any(told in line and "left out" in line for line in warnings), warnings


def full_disk(program, folder):
    result = explain(program, folder, write_lifts(program, folder, 1, (0, 0.8)), limit=1)
    refused(result, "verdict.json", "cannot be written")
    assert "No mismatch is detectable" in result[3], result
    left = [p.name for p in folder.iterdir() if p.name.startswith("out")]
    assert not left, left


def another_scene(program, folder):
    recordings = write_lifts(program, folder, 1, (0, 0.8))
    scene = folder / "believed.txtpb"
    scene.write_text(scene.read_text().replace("pose { translation_m { z: 0.0015 } }", "pose { translation_m { x: 0.12 z: 0.0015 } }", 1))
    refused(explain(program, folder, recordings), "lift0", "no point of a cloud that can be tissue")


def slow_clock(program, folder):
    """The camera's clock of one recording runs at half speed."""
    recordings = write_lifts(program, folder, 3, (0, 0.8, 1.2))
    clouds = recordings[1] / "clouds.csv"
    head, *rows = clouds.read_text().splitlines()
    half = [f"{0.5 * float(row.split(',', 1)[0]):.6f},{row.split(',', 1)[1]}" for row in rows]
    clouds.write_text("\n".join([head, *half]) + "\n")
    code, told, verdict, _ = explain(program, folder, recordings)
    assert code == 0 and verdict["status"] == "bad_recording" and "lift1" in verdict["reason"], (verdict["status"], verdict.get("reason"))


def main():
    with tempfile.TemporaryDirectory() as name:
        globals()[sys.argv[2]](pathlib.Path(sys.argv[1]), pathlib.Path(name))


if __name__ == "__main__":
    main()

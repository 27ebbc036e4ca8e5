#!/usr/bin/python3
"""Case folders from the truths that are kept here: the format to the letter, the same bytes from the same seed, nothing
that tells what was concealed. Needs numpy alone."""
import json
import os
import pathlib
import subprocess
import sys
import tempfile

try:
    import numpy as np
except ImportError:
    print("no numpy here")
    sys.exit(77)

sys.dont_write_bytecode = True
HERE = pathlib.Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))
import fenics_truth
import plants
import protocol


def run(*words):
    out = subprocess.run([sys.executable, "-B", HERE / "plants.py", *map(str, words)], capture_output=True, text=True, check=False)
    if out.returncode:
        sys.exit(out.stdout + out.stderr)
    return out.stdout


def check(what, true):
    if not true:
        sys.exit(f"not so: {what}")


def columns(path):
    with open(path, encoding="utf-8") as f:
        return f.readline().strip()


def points(path):
    data = path.read_bytes()
    head, body = data.split(b"end_header\n", 1)
    found = np.frombuffer(body, "<f4").reshape(-1, 3)
    check(f"{path} says how many points it has", f"element vertex {len(found)}\n".encode() in head)
    return found


def a_case_follows_the_format(case, with_force):
    check("nine recordings and the belief", sorted(os.listdir(case)) == [f"r{k:02d}" for k in range(9)] + ["scene_believed.txt"])
    held_out = 0
    for recording in sorted(case.glob("r*")):
        tool = np.loadtxt(recording / "tool.csv", delimiter=",", skiprows=1)
        check("the tool's columns", columns(recording / "tool.csv") ==
              "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad")
        check("every recording is as long as the others", len(tool) == 201 and tool[-1, 0] == protocol.DURATION)
        check("force when there is a sensor", (recording / "force.csv").exists() == with_force)
        if with_force:
            check("the force's columns", columns(recording / "force.csv") == "t_s,fx_N,fy_N,fz_N")
        rows = (recording / "clouds.csv").read_text().split("\n")[1:-1]
        times = [float(row.split(",")[0]) for row in rows]
        check("clouds at 10 Hz with one gap", sum(d > .15 for d in np.diff(times)) == 1 and 32 <= len(rows) <= 39)
        for row in rows:
            cloud = points(recording / row.split(",")[1])
            check("600 to 1500 points", 400 <= len(cloud) <= 1500)
            check("near the sheet", np.median(np.abs(cloud), axis=0).max() < .05)
        text = (recording / "recording.txtpb").read_text()
        held_out += "held_out: true" in text
        check("the repeat says so", ('repeat_of: "r00"' in text) == (recording.name in ("r00", "r08")))
    check("two held out", held_out == 2)


def nothing_tells_the_effect(case, effect):
    words = {w for name in protocol.EFFECTS for w in (name, name.split("_")[0])} | {"concealed", "truth", "label"}
    times = set()
    for path in case.rglob("*"):
        times.add(path.stat().st_mtime)
        if path.suffix in (".txt", ".txtpb", ".csv"):
            text = path.read_text().replace("anchor", "")
            check(f"{path.name} holds no name of an effect", not any(w in text.split() for w in words))
    check("all files have one date", len(times) == 1)


def main():
    stored = {p.name: p for p in (HERE / "truths").iterdir()}
    check("a null and a concealed truth are kept", len(stored) == 2)
    labels_of = {}
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        for number, (name, truth) in enumerate(sorted(stored.items())):
            with_force = number == 0
            word = "yes" if with_force else "no"
            case, again = root / f"c{number}", root / "again" / f"c{number}"
            said = run("case", truth, "--seed", 4, "-o", case, "--force", word)
            a_case_follows_the_format(case, with_force)
            nothing_tells_the_effect(case, name)
            again.parent.mkdir(exist_ok=True)
            check("the same seed gives the same hashes", run("case", truth, "--seed", 4, "-o", again, "--force", word) == said)
            check("another seed another cloud", run("case", truth, "--seed", 5, "-o", root / "other" / f"c{number}", "--force", word) != said)
            promised = said.strip().split("\n")[-1]
            check("a label written later has the promised hash",
                  run("label", truth, "--seed", 4, "-o", case, "--labels", root / "labels", "--force", word).strip() == promised)
            label = json.loads((root / "labels" / f"c{number}.json").read_text())
            labels_of[name.split("_")[0]] = [effect["name"] for effect in label["effects"]]
    check("labels name what was concealed", labels_of == {"null": [], "inclusion": ["inclusion"]})
    moved = np.random.default_rng(1).integers(-3000, 3000, (5, 2, 3, 3, 3))
    decoded = fenics_truth.decode({"move": fenics_truth.encode(moved)})
    check("what is stored comes back", np.array_equal(np.rint(decoded / fenics_truth.STEP_M), moved))
    smoke = plants.plan("smoke", 1)
    check("a smoke batch is two nulls and four effects", [r[1] for r in smoke].count("null") == 2 and len({r[1] for r in smoke}) == 5)
    print("case folders are as they should be")


if __name__ == "__main__":
    main()

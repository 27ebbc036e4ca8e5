#!/usr/bin/python3
"""Case folders: the format to the letter, the same bytes from the same seed, nothing that tells what was concealed. The
truth under them is a bump that rises with the tip, so that numpy alone is needed."""
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


def a_case_follows_the_format(case):
    check("nine recordings and the belief", sorted(os.listdir(case)) == [f"r{k:02d}" for k in range(9)] + ["scene_believed.txt"])
    held_out = 0
    for recording in sorted(case.glob("r*")):
        tool = np.loadtxt(recording / "tool.csv", delimiter=",", skiprows=1)
        check("the tool's columns", columns(recording / "tool.csv") ==
              "t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m,jaw_commanded_rad")
        check("every recording is as long as the others", len(tool) == 201 and tool[-1, 0] == protocol.DURATION)
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


def nothing_tells_the_effect(case):
    words = set(protocol.EFFECTS) | {"obstacle", "concealed", "truth", "label"}
    times = set()
    for path in case.rglob("*"):
        times.add(path.stat().st_mtime)
        if path.suffix in (".txt", ".txtpb", ".csv"):
            text = path.read_text()
            check(f"{path.name} holds no name of an effect", not any(w in text for w in words))
    check("all files have one date", len(times) == 1)


def a_bump(effect, seed, recordings, folder):
    folder.mkdir(parents=True)
    case = protocol.draw_case(effect, seed)
    (folder / "truth.json").write_text(json.dumps(case))
    xs, ys = np.linspace(0, case["base"]["width_m"], 5), np.linspace(0, case["base"]["length_m"], 5)
    x, y = np.meshgrid(np.linspace(0, 1, 9), np.linspace(0, 1, 9), indexing="ij")
    frames, steps = .05 * np.arange(81), .025 * np.arange(161)
    for k in recordings:
        at = np.array(case["pinches_m"][protocol.RECORDINGS[k][0]]) / [xs[-1], ys[-1]]
        shape = np.exp(-((x - at[0])**2 + (y - at[1])**2) / .1) * np.minimum(1, 4 * y)
        moved = np.zeros((81, 2, 9, 9, 3))
        moved[..., 2] = protocol.path(case, k, frames)[:, None, None, None, 2] * shape
        np.savez_compressed(folder / f"r{k:02d}.npz", xs=xs, ys=ys, frame_s=frames, step_s=steps,
                            move=fenics_truth.encode(np.rint(moved / fenics_truth.STEP_M).astype(int)),
                            force_N=-10 * protocol.path(case, k, steps).astype(np.float32))
    return folder


def a_plant_says_what_it_needs():
    """Where its program is missing, and what it cannot express."""
    nowhere = dict(os.environ, PATH="/nonexistent", OMENTUM_MISMATCH="/nonexistent/mismatch")
    for plant, effect, told in (("calculix", "null", "calculix-ccx"), ("own", "null", "OMENTUM_MISMATCH"),
                                ("calculix", "adhesion", "the plant calculix has null")):
        with tempfile.TemporaryDirectory() as folder:
            out = subprocess.run([sys.executable, "-B", HERE / "plants.py", "truth", "--plant", plant, "--effect", effect, "--seed", "1", "-o",
                                  f"{folder}/truth"], env=nowhere, capture_output=True, text=True, check=False)
            check(f"{plant} says what it needs: {out.stderr}", out.returncode == 1 and told in out.stderr and out.stderr.count("\n") == 1)
            check("and leaves nothing", not os.listdir(folder))


def main():
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        run("case", a_bump("null", 3, range(9), root / "null"), "--seed", 4, "-o", root / "c0", "--force", "yes")
        a_case_follows_the_format(root / "c0")
        nothing_tells_the_effect(root / "c0")

        truth = a_bump("inclusion", 4, [0, 5], root / "inclusion")
        make = lambda truth, seed, place: run("case", truth, "--seed", seed, "-o", root / place / "c1", "--force", "no")
        said = make(truth, 4, "first")
        nothing_tells_the_effect(root / "first" / "c1")
        check("no force without a sensor", not list(root.glob("first/c1/*/force.csv")))
        check("the same seed gives the same hashes", make(truth, 4, "again") == said)
        check("another seed gives another cloud", make(truth, 5, "other") != said)
        run("thin", truth, "-o", root / "thin")
        check("a thinned truth gives the same case", make(root / "thin", 4, "thinned") == said)
        promised = said.strip().split("\n")[-1]
        check("a label written later has the promised hash", promised == run(
            "label", truth, "--seed", 4, "-o", root / "first" / "c1", "--labels", root / "labels", "--force", "no").strip())
        label = json.loads((root / "labels" / "c1.json").read_text())
        check("it names what was concealed and where", label["effects"][0]["name"] == "inclusion" and
              len(label["effects"][0]["where"]["centre_m"]) == 2 and label["case"] == "c1")
    moved = np.random.default_rng(1).integers(-3000, 3000, (5, 2, 3, 3, 3))
    decoded = fenics_truth.decode({"move": fenics_truth.encode(moved)})
    check("what is stored comes back", np.array_equal(np.rint(decoded / fenics_truth.STEP_M), moved))
    smoke = plants.plan("smoke", 1)
    check("a smoke batch is two nulls and four effects", [r[1] for r in smoke].count("null") == 2 and len({r[1] for r in smoke}) == 5)
    check("the two plants of before keep their batches", plants.plan("smoke", 1)[0][0] == "099e5316" and
          plants.plan("smoke", 1, "mujoco")[0][0] == "27b15e57")
    for plant, effects in protocol.PLANTS.items():
        smoke = plants.plan("smoke", 1, plant)
        check(f"so is one of {plant}", [r[1] for r in smoke].count("null") == 2 and all(r[1] in effects for r in smoke))
        rows = plants.plan("dev", 1, plant)
        check(f"a batch of {plant} has its every effect twice", sorted(r[1] for r in rows if r[1] != "null") == sorted(2 * effects[1:]))
        check("nor has it a name in common with another's", all(
            not {r[0] for r in rows} & {r[0] for r in plants.plan("dev", 1, other)} for other in protocol.PLANTS if other != plant))
    a_plant_says_what_it_needs()
    print("case folders are as they should be")


if __name__ == "__main__":
    main()

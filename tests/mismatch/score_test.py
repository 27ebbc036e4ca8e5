#!/usr/bin/env python3
"""The scorer on verdicts written by hand: nothing that a verdict can say is counted twice or not at all."""
import json
import pathlib
import subprocess
import sys
import tempfile

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent))
import score


def verdict(status, *effects):
    return {"status": status, "effects": [
        {"class": {"members": [{"name": n, "probability": p} for n, p in members]}, "where": {"centre_m": [.004, .003]}}
        for members in effects]}


def label(name, *effects):
    return {"case": name, "engine": "fenics", "effects": [{"name": e, "where": {"centre_m": [0, 0]}, "parameters": {}} for e in effects]}


def check(what, got, expected):
    if got != expected:
        sys.exit(f"{what}: {got}, expected {expected}")


def main():
    s = score.score
    quiet = s(label("a"), verdict("no_mismatch_detectable"))
    check("a silent null is no alarm", (quiet["false_alarm"], quiet["wrong_certain"]), (False, False))
    for status in ("numerics", "unexplained", "bad_recording", "no verdict"):
        check(f"a null that is {status} is an alarm", s(label("a"), verdict(status))["false_alarm"], True)
    loud = s(label("a"), verdict("explained", [("obstacle", .9)]))
    check("a null with a certain name", (loud["false_alarm"], loud["wrong_certain"]), (True, True))
    right = s(label("a", "inclusion"), verdict("explained", [("soft_spot", .2), ("inclusion", .8)]))
    check("the likeliest counts first and its place is told", (right["top1"], right["class"], round(right["mm"], 6)), (1.0, .5, 5.0))
    clocks = s(label("a", "actuation_delay"), verdict("explained_as_class", [("camera_time_offset", .6), ("actuation_delay", .4)]))
    check("a class of the table counts whole", (clocks["top1"], clocks["class"], clocks["size"]), (0.0, 1.0, 2))
    wrong = s(label("a", "adhesion"), verdict("explained", [("density", .95)]))
    check("a certain wrong name", (wrong["wrong_certain"], wrong["class"], wrong["abstained"]), (True, 0.0, False))
    unsure = s(label("a", "adhesion"), verdict("explained", [("density", .5)]))
    check("an unsure wrong name", unsure["wrong_certain"], False)
    for status in ("no_mismatch_detectable", "unexplained", "numerics"):
        check(f"{status} with an effect concealed abstains", s(label("a", "adhesion"), verdict(status, [("adhesion", .9)]))["abstained"], True)
    second = s(label("a", "adhesion"), verdict("partly_explained", [("density", .7)], [("adhesion", .9)]))
    check("only the strongest effect counts", second["class"], 0.0)
    check("bounds of section 10.4", [round(score.upper_bound(*k), 3) for k in ((0, 60), (0, 100), (1, 100))], [.049, .030, .047])
    with tempfile.TemporaryDirectory() as folder:
        root = pathlib.Path(folder)
        (root / "labels").mkdir()
        for item, said in ((label("n"), verdict("no_mismatch_detectable")), (label("x", "inclusion"), verdict("explained", [("inclusion", 1)])),
                           (label("y", "adhesion"), None)):
            (root / "labels" / f"{item['case']}.json").write_text(json.dumps(item))
            if said:
                (root / "verdicts" / item["case"]).mkdir(parents=True)
                (root / "verdicts" / item["case"] / "verdict.json").write_text(json.dumps(said))
        run = subprocess.run([sys.executable, score.__file__, root / "labels", root / "verdicts"], capture_output=True, text=True, check=True)
        for part in ("false alarms 0 of 1", "of 2 concealed: named 1, abstained 1, top-1 1, class 1.00", "always silent false alarms 0 of 1",
                     "always naming false alarms 1 of 1", "no verdict"):
            if part not in run.stdout:
                sys.exit(f"the table does not say: {part}\n{run.stdout}")
    print("the scorer counts as it says")


if __name__ == "__main__":
    main()

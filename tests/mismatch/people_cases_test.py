#!/usr/bin/env python3
"""Files as people have them: every case does what its README.md says (OMENTUM_CASES, else `cases/turn3` beside OMENTUM_REAL_DATA).

usage: people_cases_test.py MISMATCH DVRK_GATEWAY
"""
import csv
import json
import os
import pathlib
import re
import subprocess
import sys
import tempfile

SKIPPED = 77
MISMATCH, GATEWAY = (pathlib.Path(word) for word in sys.argv[1:3])


def cases_folder():
    if "OMENTUM_CASES" in os.environ:
        return pathlib.Path(os.environ["OMENTUM_CASES"])
    if "OMENTUM_REAL_DATA" in os.environ:
        return pathlib.Path(os.environ["OMENTUM_REAL_DATA"]).parent / "cases" / "turn3"
    return pathlib.Path("/nowhere")


CASES = cases_folder()


def run(*words, code=0, program=MISMATCH):
    done = subprocess.run([str(w) for w in (program, *words)], capture_output=True, text=True, timeout=60)
    assert done.returncode == code, (words, done.returncode, done.stdout, done.stderr)
    if code == 2:  # one line, beside warnings
        assert len([line for line in done.stderr.splitlines() if not line.startswith("warning: ")]) == 1, done.stderr
    return done.stdout + done.stderr


def imported(path, folder, *more):
    """What is said of an import to one file, what info says of it, and its tables."""
    out = folder / "x.mcap"
    said = run("import", CASES / path, *more, "-o", out)
    info = json.loads(run("info", out, "--json").split("\nwarning: ")[0])["recordings"][0]
    run("export", out, "-o", folder / "x")
    tables = {}
    for file in (folder / "x").glob("*.csv"):
        with open(file) as lines:
            tables[file.stem] = list(csv.DictReader(lines))
    return said, info, tables, (folder / "x" / "recording.txtpb").read_text()


def has(text, *parts):
    for part in parts:
        assert re.search(part, text), (part, text)


def refused(text, *parts):
    has(text, *parts)


def bag_compressed_by_message(folder):
    said, info, _, _ = imported("bag_compressed_by_message/message_zstd.mcap", folder)
    assert "cdr of kind" not in said and any(c["topic"] == "tool" for c in info["channels"]), said


def bag_in_two_parts(folder):
    said, info, tables, _ = imported("bag_in_two_parts", folder)
    assert len(tables["tool"]) == 100 and "taken for W" not in said, said
    run("import", CASES / "bag_in_two_parts", "-o", folder / "out")
    assert [p.name for p in (folder / "out").iterdir()] == ["bag_in_two_parts.mcap"]


def camera_never_calibrated(folder):
    said, info, tables, text = imported("camera_never_calibrated/c1_zero_k.mcap", folder)
    has(said, "camera_info.*left out.*not calibrated")
    assert tables["tool"] and "fx" not in text


def clock_starts_anew(folder, case="clock_starts_anew/c4_jump_4000s.mcap", step="4000|3999"):
    said, info, tables, _ = imported(case, folder)
    has(said, f"/PSM1/measured_cp: header.stamp goes back by ({step}).* at message \\d+ of 100.*times of the log.*log_time")
    times = [float(row["t_s"]) for row in tables["tool"]]
    assert len(times) >= 100 and times[-1] - times[0] < 10, times


def clock_steps_back(folder):
    clock_starts_anew(folder, "clock_steps_back/c4_jump_200ms.mcap", "0.2|0.19")


def cloud_whose_row_step_is_wrong(folder):
    said, info, _, _ = imported("cloud_whose_row_step_is_wrong/c7_row_whole_organised.mcap", folder)
    has(said, "row_step")
    assert any(c["topic"] == "cloud" for c in info["channels"])


def cloud_without_fields_first(folder):
    said, info, _, _ = imported("cloud_without_fields_first/c7_zero_fields.mcap", folder)
    has(said, "/cloud: 1 message that cannot be read: left out")
    assert any(c["topic"] == "cloud" for c in info["channels"])


def commands_without_height(folder):
    case = CASES / "commands_without_height"
    line = r"tool.csv:1: column tip_commanded_z_m is empty in every row.*needed"
    scene = CASES / "damping_believed_zero" / "believed.txtpb"
    refused(run("import", case, "-o", folder / "x.mcap", code=2), line)
    refused(run("simulate", "--scene", scene, "--commands", case, "-o", folder / "s", code=2), line)
    refused(run("calibrate", "--scene", scene, "-r", case, "-o", folder / "c", code=2), line)


def compressed_pcd(folder):
    run("scene", CASES / "compressed_pcd" / "compressed.pcd", "-o", folder / "s.txtpb")


def damping_believed_zero(folder):
    scene = CASES / "damping_believed_zero" / "believed.txtpb"
    any_recording = CASES / "force_of_one_axis"
    has(run("calibrate", "--scene", scene, "-r", any_recording, "-o", folder / "c", code=2),
        r"damping is not looked for: scene.tissue.material.damping_per_s is 0, and a factor of 0 is 0.*sd")


def delimiter_at_the_end_of_rows(folder):
    case = "delimiter_at_the_end_of_rows"
    said, _, tables, _ = imported(case, folder, "--map", CASES / case / "map.txtpb")
    has(said, "rows have empty cells behind the last")
    assert float(tables["force"][1]["fz_N"]) == 0.01


def depth_of_8_bits(folder):
    said, info, _, _ = imported("depth_of_8_bits/c8_png_8bit.mcap", folder)
    has(said, "16UC1; png.*8 bits")
    assert not any(c["topic"] in ("color", "depth") for c in info["channels"])


def first_stamps_zero(folder):
    said, info, tables, _ = imported("first_stamps_zero/c5_sim_first_zero.mcap", folder)
    has(said, "3 of 100 messages without header.stamp, which the others have: left out")
    times = [float(row["t_s"]) for row in tables["tool"]]
    assert times[-1] - times[0] < 10, times


def force_of_one_axis(folder):
    said, info, tables, _ = imported("force_of_one_axis", folder)
    has(said, "fx_N, fy_N known in no row")
    assert tables["force"][3]["fx_N"] == "" and float(tables["force"][3]["fz_N"]) == 0.03


def frame_numbers_and_rate(folder):
    case = "frame_numbers_and_rate"
    _, _, tables, _ = imported(case, folder, "--map", CASES / case / "map.txtpb")
    assert tables["markers"][20]["t_s"] == "0.25", tables["markers"][20]


def hidden_files_in_a_folder(folder):
    run("import", CASES / "hidden_files_in_a_folder", "-o", folder / "out")
    assert [p.name for p in (folder / "out").iterdir()] == ["plain.mcap"]


def intrinsics_in_p_only(folder):
    _, _, _, text = imported("intrinsics_in_p_only/c2_p_only.mcap", folder)
    has(text, "fx: 60", "fy: 60", "cx: 31.5", "cy: 23.5")


def joints_in_another_order(folder):
    said, _, tables, _ = imported("joints_in_another_order/c21_js_shuffled.mcap", folder)
    has(said, "joints in another order: taken by their names")
    names = set(tables["joints"][0])
    assert not {"q3_measured_rad", "q3_measured_m"} <= names, names
    for column in names - {"t_s"}:  # no joint leaps from one message to the next
        values = [float(row[column]) for row in tables["joints"] if row[column]]
        assert max(abs(a - b) for a, b in zip(values, values[1:])) < 0.05, (column, values)


def names_that_stand_three_times(folder):
    case = "names_that_stand_three_times"
    refused(run("import", CASES / case, "--map", CASES / case / "by_name.txtpb", "-o", folder / "x.mcap", code=2), "columns are called X, those at .*#")


def scene_with(folder, mesh):
    scene = folder / "scene.txtpb"
    body = f'rigid_body {{ name: "organ" mesh {{ path: "{CASES / mesh}" unit_m: 1 }} pose {{ translation_m {{ x: -0.2 y: 0.2 z: 0.05 }} }} }}\n'
    scene.write_text((CASES / "damping_believed_zero" / "believed.txtpb").read_text() + body)
    tool = folder / "commands"
    tool.mkdir(exist_ok=True)
    (tool / "tool.csv").write_text("t_s,tip_commanded_x_m,tip_commanded_y_m,tip_commanded_z_m\n0,0,0,0.1\n")
    return run("simulate", "--scene", scene, "--commands", tool, "-o", folder / "s", code=2)


def reads_mesh(folder, *meshes):
    for mesh in meshes:  # what is wrong with the commands is found behind the scene
        has(scene_with(folder, mesh), "tool.csv: 1 rows, needed 2")


def obj_line_continued(folder):
    reads_mesh(folder, "obj_line_continued/continuation.obj")


def obj_vertices_per_face(folder):
    reads_mesh(folder, "obj_vertices_per_face/split_vertices.obj")


def stl_in_capitals(folder):
    reads_mesh(folder, "stl_in_capitals/upper.stl", "stl_in_capitals/end_loop.stl")


def pcd_with_viewpoint(folder):
    has(run("scene", CASES / "pcd_with_viewpoint" / "viewpoint.pcd", "-o", folder / "s.txtpb"), "VIEWPOINT.*not applied")


def points_that_are_nan(folder):
    case = "points_that_are_nan"
    _, info, _, _ = imported(case, folder, "--map", CASES / case / "map.txtpb")
    assert [c["samples"] for c in info["channels"] if c["topic"] == "cloud"] == [3]


def rectified_depth(folder):
    _, _, _, text = imported("rectified_depth/c2_k_not_p.mcap", folder)
    has(text, "fx: 60", "fy: 60", "cx: 31.5", "cy: 23.5")


def tabs_and_quotes(folder):
    case = "tabs_and_quotes"
    _, _, tables, _ = imported(case, folder, "--map", CASES / case / "map.txtpb")
    assert tables["force"][1]["fx_N"] == "" and float(tables["force"][1]["fy_N"]) == 0.2, tables["force"][1]


def two_frames_taken_for_w(folder):
    said, info, _, _ = imported("two_frames_taken_for_w/c16_only_static_no_tool_frame.mcap", folder)
    has(said, "left out: it stands in .*, /PSM1/measured_cp in .*no transform")
    assert not any(c["topic"] == "depth" for c in info["channels"])


def wire_log_of_two_arms(folder):
    refused(run("convert", CASES / "wire_log_of_two_arms" / "two_arms.tsv", "-o", folder / "x.mcap", code=2, program=GATEWAY), "PSM1.*PSM2")


# The jaw of jaw_that_does_not_close needs a gateway: JawWatch.AJawThatStandsAtTheRobotsOwnSetPointHoldsNothing.
def main():
    if not CASES.is_dir():
        print("OMENTUM_CASES names no folder")
        return SKIPPED
    failed = []
    for case in sorted(p.name for p in CASES.iterdir() if p.is_dir()):
        if case not in globals():
            print(f"{case}: no test of its own")
            continue
        with tempfile.TemporaryDirectory() as name:
            try:
                globals()[case](pathlib.Path(name))
                print(f"{case}: ok")
            except Exception as error:  # all cases are told, not the first alone
                failed.append(case)
                print(f"{case}: {type(error).__name__}: {error}")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())

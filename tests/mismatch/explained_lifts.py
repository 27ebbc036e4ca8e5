"""Lifts of a small sheet in pads by `mismatch simulate`, with an effect that the believed scene leaves out or with none, as a
robot and a depth camera would have recorded them. The own engine: what the default tests of `mismatch explain` run on, no proof
(tests/mismatch/plants has engines of their own).
"""
import shutil
import subprocess

import small_lifts as small

PADS = "grip { shape: GRIP_RECTANGLE half_x_m: 0.003 half_y_m: 0.003 hold: HOLD_PAD }"
# Without the tumour of small_lifts.py, which no lift meets and of which every command would warn.
BELIEVED = "".join(line for line in small.BELIEVED.replace("roll_deg: 30", f"roll_deg: 0 {PADS}").splitlines(keepends=True)
                   if "ROLE_TUMOUR" not in line)
PINCHES = ((-0.0155, 0.0185), (0.0015, 0.019), (0.0165, 0.0125), (0.009, 0.0185), (-0.0165, 0.006), (0.0, 0.0175))
OFFSETS = ((0.0006, -0.0004), (-0.0008, 0.0003), (0.0002, 0.0007), (-0.0003, -0.0005), (0.0005, 0.0002), (0.0, 0.0004))
FACTORS = (1.02, 0.98, 1.01, 0.99, 1.0, 1.01)  # on E, of every recording
HELD_OUT = 5
NOISE = 3e-4  # [m] along the ray: few clouds of few points
TRUTH = {"scene.tissue.material.young_modulus_pa": 48e3, "scene.depth_sensor.registration_m.z": 0.001}
EFFECTS = {
    "null": (),
    "inclusion": ("scene.tissue.effects.inclusion={ x_m: 0.002 y_m: 0.004 radius_m: 0.009 stiffness_change: 4 }",),
    "adhesion": ("scene.tissue.effects.adhesion={ stiffness_pa_per_m: 3e5 break_m: 0.003 x_m: 0.005 y_m: 0.002 half_x_m: 0.008 half_y_m: 0.008 }",),
    "tool_backlash": ("scene.arm.tip_backlash.z=0.0008",),
    "anchor_detachment": ("scene.tissue.effects.anchor.free_from_m=-0.022", "scene.tissue.effects.anchor.free_to_m=-0.008"),
}


def write_case(program, folder, effect, seed=1, mesh_mm=0.6, rate=10):
    """Recordings folder/lifts/lift0 ..., the scene folder/believed.txtpb and its priors."""
    scratch = folder / "true"
    scratch.mkdir(parents=True)
    (scratch / "scene.txtpb").write_text(BELIEVED + f"depth_sensor {{ width_px: 90 height_px: 72 noise_m: {NOISE} }}\n")
    (folder / "believed.txtpb").write_text(BELIEVED)
    (folder / "believed.prior.txtpb").write_text(
        "".join(f'prior {{ path: "{path}" {kind}: {value} source: "test" }}\n' for path, kind, value in small.PRIORS))
    young = "scene.tissue.material.young_modulus_pa"
    for k, (pinch, offset) in enumerate(zip(PINCHES, OFFSETS)):
        commands = scratch / f"commands{k}"
        commands.mkdir()
        (commands / "tool.csv").write_text(small.tool_rows(pinch, offset))
        here = dict(TRUTH)
        here[young] *= FACTORS[k]
        sets = [word for override in (*small.truth_overrides(here), *EFFECTS[effect]) for word in ("--set", override)]
        command = [program, "simulate", "--scene", scratch / "scene.txtpb", "--commands", commands, "-o", scratch / f"lift{k}",
                   "--model", "reference", "--tolerance-mm", mesh_mm, "--cloud-rate", rate, "--seed", 100 * seed + k, *sets]
        done = subprocess.run([str(c) for c in command], capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        out = folder / "lifts" / f"lift{k}"
        times = [float(row.split(",")[0]) for row in (scratch / f"lift{k}" / "clouds.csv").read_text().splitlines()[1:]]
        small.write_recording(scratch / f"lift{k}", out, small.tool_rows(pinch, (0, 0)), times)
        if k == HELD_OUT:
            with open(out / "recording.txtpb", "a") as file:
                file.write("held_out: true\n")
    shutil.rmtree(scratch)


if __name__ == "__main__":
    import argparse
    import pathlib

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mismatch", help="the program")
    parser.add_argument("folder", type=pathlib.Path, help="new folder for lifts, scene and priors")
    parser.add_argument("effect", choices=EFFECTS)
    parser.add_argument("mesh_mm", type=float, nargs="?", default=0.6, help="of the simulation (0.6)")
    args = parser.parse_args()
    write_case(args.mismatch, args.folder, args.effect, mesh_mm=args.mesh_mm)

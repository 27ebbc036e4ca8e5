#!/usr/bin/env python3
"""Training on the elastic sheet with each term that a scene can state beside the plain scene. For benchmarks/run.sh terms.

Usage: terms.py BIN DOMAIN [--set a.b=c]...
Trains preset omentum_elastic for some updates in the plain scene and with one term at a time, and prints per term
"terms.NAME.steps_per_s N steps/s" and, behind #, its share of the plain scene's, which is measured before and after all
others. A training that fails is said, and the exit code is 1.
"""
import argparse
import csv
import os
import subprocess
import sys
import tempfile

UPDATES, SKIPPED = 8, 2  # the first ones hold what begins once
TIMES = ["time/wait_s", "time/check_s", "time/update_s", "time/publish_s", "time/save_s"]
E = "scene.tissue.effects."
TERMS = {
    "strain_stiffening": [E + "strain_stiffening=5"],
    "exponential_stiffening": [E + "exponential_stiffening=5"],
    "anisotropy": [E + "anisotropy.fibre_ratio=0.5", E + "anisotropy.angle_deg=30"],
    "structural_damping": [E + "structural_damping=0.1"],
    "plastic_set": [E + "plastic_set.modulus_ratio=0.3", E + "plastic_set.yield_strain=0.02"],
    "mullins": [E + "mullins.softening=0.5", E + "mullins.strain=0.1"],
    "adhesion_on_a_place": [E + "adhesion.stiffness_pa_per_m=1e5", E + "adhesion.x_m=0.01", E + "adhesion.y_m=0.01",
                            E + "adhesion.half_x_m=0.02", E + "adhesion.half_y_m=0.02"],
    "suction": [E + "suction.drag_pa_s_per_m=1e4", E + "suction.reach_m=0.001"],
    "anchor": [E + "anchor.compliance_m2_per_n=1e-6"],
    "grasp_slip_that_ends": [E + "grasp_slip.speed_m_per_s=0.002", E + "grasp_slip.force_n=0.1", E + "grasp_slip.total_m=0.002"],
    "grasp_compliance": [E + "grasp_compliance_m_per_n=1e-3"],
    "grasp_turn": [E + "grasp_turn_rad_per_n_m=100"],
    "jaw_turn": [E + "jaw_roll_deg=5", E + "jaw_tilt_deg=5", E + "jaw_lean_deg=5"],
    "added_mass": [E + "added_mass.mass_kg=0.002", E + "added_mass.radius_m=0.01"],
    "local_force": [E + "local_force.strength=1", E + "local_force.radius_m=0.01", E + "local_force.push_z_n=-0.02"],
    "thickness": [E + "thickness.x_per_m=2"],
    "rest_shape": [E + "rest_shape.curvature_x_per_m=2"],
    "air_drag": [E + "air_drag=1"],
    "tip_play": ["scene.arm.tip_backlash.x=0.0005"],
}


def train(args, name, sets):
    """Steps per second of training, or None."""
    with tempfile.TemporaryDirectory() as folder:
        knobs = [*args.set, *sets, f"run.runs_dir={folder}", f"run.domain={args.domain}", "evaluation.enabled=false",
                 f"rollout.max_steps={UPDATES * 1280}"]
        options = [part for knob in knobs for part in ("--set", knob)]
        learner = subprocess.Popen([os.path.join(args.bin, "learner"), "--preset", "omentum_elastic", "--run", "terms", *options],
                                   stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
        workers = [subprocess.Popen([os.path.join(args.bin, "sim_worker"), "--run", "terms", "--domain", args.domain],
                                    stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for _ in range(2)]
        said = learner.communicate()[1]
        for worker in workers:
            worker.terminate()
            worker.wait()
        if learner.returncode != 0:
            print(f"# {name}: {said.strip().splitlines()[-1] if said.strip() else learner.returncode}", flush=True)
            return None
        with open(os.path.join(folder, "terms", "metrics.csv"), newline="") as table:
            rows = list(csv.DictReader(table))
    counted = rows[SKIPPED:]
    steps = int(counted[-1]["charts/steps_total"]) - int(rows[SKIPPED - 1]["charts/steps_total"])
    return steps / sum(float(row[time]) for row in counted for time in TIMES)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin")
    parser.add_argument("domain")
    parser.add_argument("--set", action="append", default=[])
    args = parser.parse_args()
    rates = {name: train(args, name, sets) for name, sets in [("plain", []), *TERMS.items(), ("plain_again", [])]}
    if None in rates.values():
        sys.exit(1)
    plain = 0.5 * (rates["plain"] + rates["plain_again"])
    for name, rate in rates.items():
        print(f"terms.{name}.steps_per_s {rate:.0f} steps/s # {rate / plain:.2f} of the plain scene")


if __name__ == "__main__":
    main()

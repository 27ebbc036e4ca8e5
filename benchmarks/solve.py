#!/usr/bin/env python3
"""How many steps and seconds a preset needs until its task is solved. For benchmarks/run.sh solve.

Usage: solve.py BIN DOMAIN PRESET [SEEDS] [--demonstrations N] [--set a.b=c]... [--interval STEPS]
Prints the lines "solve.PRESET.steps N steps" and "solve.PRESET.wall_s T s", medians over the seeds 1 ... SEEDS (default 5), and a
comment line per seed.

Solved is a policy whose greedy evaluation reaches p_T from 100 of 100 starts and exposes from at least 95, and which the
following two evaluations confirm. The preset, with what --set overrides, is evaluated about every 50,000 steps
(evaluation.interval_updates; --interval); a seed that ends unsolved counts as infinite. The seconds are those of training, learner
start to the end of the update: what evaluations take is left out.

With --demonstrations every seed begins with N episodes of the scripted expert (sim_worker --demonstrate, starts of its seed), which
the learner clones. The figures are then called solve.PRESET.demonstrations_N.*; the steps of the episodes count as steps, recording
and cloning as seconds.
"""
import argparse
import csv
import math
import os
import re
import statistics
import subprocess
import sys
import tempfile
import time

INTERVAL_STEPS = 50_000
CONFIRMATIONS = 2
TRAINING_TIMES = ["time/wait_s", "time/check_s", "time/update_s", "time/publish_s", "time/save_s"]


def options_of(sets):
    return [part for one in sets for part in ("--set", one)]


def steps_per_update(learner, preset, sets):
    """Slots times steps of a segment, as the learner resolves them."""
    said = subprocess.run([learner, "--preset", preset, "--dry-run", *options_of(sets)], capture_output=True, text=True)
    if said.returncode != 0:
        sys.exit(f"solve.py: {said.stderr.strip()}")
    text = said.stdout
    rollout = text[text.index("rollout {"):]
    knob = {name: int(re.search(rf"\b{name}: (\d+)", rollout)[1]) for name in ("slots", "steps_per_segment")}
    return knob["slots"] * knob["steps_per_segment"]


def demonstrate(args, seed, folder):
    """Recordings of the expert; their steps and the seconds that they took."""
    began = time.monotonic()
    said = subprocess.run(
        [os.path.join(args.bin, "sim_worker"), "--demonstrate", str(args.demonstrations), "--preset", args.preset, "-o", folder,
         *options_of([*args.set, f"rollout.run_seed={seed}"])], check=True, capture_output=True, text=True).stdout
    return int(re.search(r"steps=(\d+)", said)[1]), time.monotonic() - began


def is_solved(figures):
    reached, exposed = figures
    return reached == 100 and exposed >= 95


def first_solved(evaluations):
    """Update of the first solved evaluation with its confirmations behind it; `evaluations` maps updates to figures."""
    updates = sorted(evaluations)
    for i, update in enumerate(updates):
        confirmed = updates[i:i + 1 + CONFIRMATIONS]
        if len(confirmed) == 1 + CONFIRMATIONS and all(is_solved(evaluations[u]) for u in confirmed):
            return update
    return None


def train(args, seed, folder, recordings):
    """Evaluations of a run by update, which is stopped once it is solved; the rows of its metrics; seconds of cloning."""
    learner = os.path.join(args.bin, "learner")
    name = f"solve_{args.preset}_{seed}"
    interval = max(1, round(args.interval / steps_per_update(learner, args.preset, args.set)))
    clone = ["--initialise-from-recordings", recordings] if recordings else []
    log = open(os.path.join(folder, "learner.log"), "w+")
    run = subprocess.Popen(
        [learner, "--preset", args.preset, "--run", name, *clone,
         *options_of([*args.set, f"run.runs_dir={folder}", f"run.domain={args.domain}", f"rollout.run_seed={seed}",
                      f"evaluation.interval_updates={interval}", "evaluation.interval_grid_only=true"])],
        stdout=subprocess.PIPE, stderr=log, text=True)
    workers = [subprocess.Popen([os.path.join(args.bin, "sim_worker"), "--run", name, "--domain", args.domain],
                                stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) for _ in range(2)]
    evaluations, update = {}, None
    try:
        for line in run.stdout:
            if begins := re.match(r"after update (\d+):", line):
                update = int(begins[1])
            figures = re.match(r"evaluation grid100_greedy .*target_reached +(\d+) +exposed +(\d+)", line)
            if figures and update is not None:
                evaluations[update] = (int(figures[1]), int(figures[2]))
                update = None
                if first_solved(evaluations):
                    break
    finally:
        run.terminate()
        run.stdout.close()
        run.wait()
        for worker in workers:
            worker.terminate()
            worker.wait()
    log.seek(0)
    cloned = re.search(r"cloned .* wall_s=([\d.]+)", log.read())
    log.close()
    if recordings and not cloned:
        sys.exit("solve.py: the learner cloned nothing")
    with open(os.path.join(folder, name, "metrics.csv"), newline="") as table:
        return evaluations, list(csv.DictReader(table)), float(cloned[1]) if cloned else 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bin")
    parser.add_argument("domain")
    parser.add_argument("preset")
    parser.add_argument("seeds", type=int, nargs="?", default=5)
    parser.add_argument("--demonstrations", type=int, default=0)
    parser.add_argument("--set", action="append", default=[])
    parser.add_argument("--interval", type=int, default=INTERVAL_STEPS)
    args = parser.parse_args()
    figure = f"solve.{args.preset}" + (f".demonstrations_{args.demonstrations}" if args.demonstrations else "")
    steps, walls = [], []
    for seed in range(1, args.seeds + 1):
        shown_steps, shown_s, recordings = 0, 0, None
        with tempfile.TemporaryDirectory() as folder:
            if args.demonstrations:
                recordings = os.path.join(folder, "demonstrations")
                shown_steps, shown_s = demonstrate(args, seed, recordings)
            evaluations, metrics, cloning_s = train(args, seed, folder, recordings)
        solved = first_solved(evaluations)
        row = next((r for r in metrics if solved and int(r["update"]) == solved), None)
        steps.append(shown_steps + int(row["charts/steps_total"]) if row else math.inf)
        walls.append(shown_s + cloning_s + sum(float(row[t]) for t in TRAINING_TIMES) if row else math.inf)
        told = ", ".join(f"{update}: {reached}/{exposed}" for update, (reached, exposed) in sorted(evaluations.items()))
        shown = f" ({shown_steps} shown, {shown_s:.1f} s; cloned in {cloning_s:.1f} s)" if recordings else ""
        print(f"# {args.preset} seed {seed}: {steps[-1]} steps, {walls[-1]:.1f} s{shown}; update: reached/exposed {told}", flush=True)
    if math.isinf(statistics.median(steps)):
        print(f"# {figure}: not solved by half of the seeds")
        return 1
    print(f"{figure}.steps {statistics.median(steps):.0f} steps")
    print(f"{figure}.wall_s {statistics.median(walls):.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/env python3
"""How many steps and seconds a preset needs until its task is solved. For benchmarks/run.sh solve.

Usage: solve.py BIN DOMAIN PRESET [SEEDS]; prints the lines "solve.PRESET.steps N steps" and "solve.PRESET.wall_s T s",
medians over the seeds 1 ... SEEDS (default 5), and a comment line per seed.

Solved is a policy whose greedy evaluation reaches p_T from 100 of 100 starts and exposes from at least 95, and which the
following two evaluations confirm. The preset as it stands is evaluated about every 50,000 steps
(evaluation.interval_updates); a seed that ends unsolved counts as infinite. The seconds are those of training, learner
start to the end of the update: what evaluations take is left out.
"""
import csv
import math
import os
import re
import statistics
import subprocess
import sys
import tempfile

INTERVAL_STEPS = 50_000
CONFIRMATIONS = 2
TRAINING_TIMES = ["time/wait_s", "time/check_s", "time/update_s", "time/publish_s", "time/save_s"]


def steps_per_update(learner, preset):
    """Slots times steps of a segment, as the learner resolves them."""
    text = subprocess.run([learner, "--preset", preset, "--dry-run"], check=True, capture_output=True, text=True).stdout
    rollout = text[text.index("rollout {"):]
    knob = {name: int(re.search(rf"\b{name}: (\d+)", rollout)[1]) for name in ("slots", "steps_per_segment")}
    return knob["slots"] * knob["steps_per_segment"]


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


def train(bin_folder, domain, preset, seed, folder):
    """Evaluations of a run by update, which is stopped once it is solved; the rows of its metrics."""
    learner = os.path.join(bin_folder, "learner")
    name = f"solve_{preset}_{seed}"
    interval = max(1, round(INTERVAL_STEPS / steps_per_update(learner, preset)))
    run = subprocess.Popen(
        [learner, "--preset", preset, "--run", name,
         "--set", f"run.runs_dir={folder}", "--set", f"run.domain={domain}", "--set", f"rollout.run_seed={seed}",
         "--set", f"evaluation.interval_updates={interval}", "--set", "evaluation.interval_grid_only=true"],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
    workers = [subprocess.Popen([os.path.join(bin_folder, "sim_worker"), "--run", name, "--domain", domain],
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
    with open(os.path.join(folder, name, "metrics.csv"), newline="") as table:
        return evaluations, list(csv.DictReader(table))


def main():
    bin_folder, domain, preset = sys.argv[1:4]
    seeds = int(sys.argv[4]) if len(sys.argv) > 4 else 5
    steps, walls = [], []
    for seed in range(1, seeds + 1):
        with tempfile.TemporaryDirectory() as folder:
            evaluations, metrics = train(bin_folder, domain, preset, seed, folder)
        solved = first_solved(evaluations)
        row = next((r for r in metrics if solved and int(r["update"]) == solved), None)
        steps.append(int(row["charts/steps_total"]) if row else math.inf)
        walls.append(sum(float(row[t]) for t in TRAINING_TIMES) if row else math.inf)
        told = ", ".join(f"{update}: {reached}/{exposed}" for update, (reached, exposed) in sorted(evaluations.items()))
        print(f"# {preset} seed {seed}: {steps[-1]} steps, {walls[-1]:.1f} s; update: reached/exposed {told}", flush=True)
    if math.isinf(statistics.median(steps)):
        print(f"# {preset}: not solved by half of the seeds")
        return 1
    print(f"solve.{preset}.steps {statistics.median(steps):.0f} steps")
    print(f"solve.{preset}.wall_s {statistics.median(walls):.1f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())

#!/usr/bin/python3
"""Makes cases with concealed physics for `mismatch explain` to find: truths by simulation, folders by a drawn sensor."""
import argparse
import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    commands = parser.add_subparsers(dest="command", required=True)
    truth = commands.add_parser("truth", help="simulate the nine recordings of a case; what is there is kept")
    truth.add_argument("--effect", required=True)
    truth.add_argument("--seed", type=int, required=True)
    truth.add_argument("-o", dest="folder", required=True)
    truth.add_argument("--cells", type=int, default=10, help="along each side of the sheet")
    truth.add_argument("--recordings", type=int, nargs="*", default=range(9))
    a = parser.parse_args()
    if a.command == "truth":
        import fenics_truth
        fenics_truth.run_case(a.effect, a.seed, a.folder, a.cells, a.recordings)


if __name__ == "__main__":
    main()

#!/usr/bin/python3
"""How far a finer grid and a shorter step move the lifted surface: ./refinement.py [effect] [seed] [recording].

Prints the rms over the upper face of the difference to 14 x 14 cells, along the surface's normal and in all, in the
holds and at rest at the end."""
import sys

import numpy as np

import fenics_truth
import protocol
import sensor


def surface(case, recording, cells, step):
    """Upper face at material points of a common raster [frame][x][y][xyz]."""
    out = fenics_truth.run_recording(case, recording, cells, step)
    move = fenics_truth.decode(out)[:, 1]
    at = np.linspace(0, 1, 61)

    def weights(xs):
        P, half = sensor.fine_lines(xs), np.sort(np.concatenate([xs, (xs[1:] + xs[:-1]) / 2]))
        fine = P @ half
        return np.array([np.array([np.interp(a * xs[-1], fine, P[:, k]) for k in range(P.shape[1])]) for a in at])

    wx, wy = weights(out["xs"]), weights(out["ys"])
    x, y = np.meshgrid(at * out["xs"][-1], at * out["ys"][-1], indexing="ij")
    rest = np.stack([x, y, np.full_like(x, case["base"]["thickness_m"])], -1)
    return rest + np.einsum("ax,fxyd,by->fabd", wx, move, wy, optimize=True), out["force_N"]


def normals(s):
    n = np.cross(np.gradient(s, axis=1), np.gradient(s, axis=2))
    return n / np.linalg.norm(n, axis=-1, keepdims=True)


def main():
    effect, seed, recording = (sys.argv[1:] + ["null", "101", "0"][len(sys.argv) - 1:])[:3]
    case = protocol.draw_case(effect, int(seed))
    best, force = surface(case, int(recording), 14, None)
    n = normals(best)
    for cells, step in ((9, None), (9, .0125)):
        s, f = surface(case, int(recording), cells, step)
        d = s - best
        for t in (1.35, 2.25, 2.85, 4.0):
            k = int(round(t / fenics_truth.FRAME))
            along = (d[k] * n[k]).sum(-1)
            print(f"{cells} cells, step {step or .025}: {t} s normal {1e3 * np.sqrt((along**2).mean()):.3f} mm rms, "
                  f"largest {1e3 * np.abs(along).max():.3f}, in all {1e3 * np.sqrt((d[k]**2).sum(-1).mean()):.3f}", flush=True)
        hold = lambda v: v[int(2.25 / 4 * (len(v) - 1))]
        print(f"  force at 2.25 s: {hold(f)} against {hold(force)} N", flush=True)


if __name__ == "__main__":
    main()

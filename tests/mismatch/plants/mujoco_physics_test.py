#!/usr/bin/python3
"""The sheet of the plant mujoco keeps to laws that are known without it. Ends with 77 where MuJoCo is missing."""
import os
import sys

os.environ.setdefault("OMP_NUM_THREADS", "1")
sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
try:
    import mujoco  # noqa: F401
except ImportError:
    print("no MuJoCo here")
    sys.exit(77)

import numpy as np

import mujoco_sheet

THICK, STRIP, LONG, WIDE = .003, .006, .05, .03


def clamped(young, poisson, gravity, bed=1e10, **more):
    xs, ys = np.linspace(0, WIDE, 4), mujoco_sheet.lines([0, STRIP, STRIP + LONG], 6)
    s = mujoco_sheet.Sheet(xs, ys, THICK, young, poisson, 1050.0, damping=.01, gravity=gravity, **more)
    s.clamp(bed, STRIP, np.ones(s.shape[0]))
    return s


def at_rest(s):
    """Statics: in steps of minutes inertia and damping are nothing."""
    s.h, s.model.opt.tolerance = 100.0, 1e-14
    for _ in range(6):
        s.calm(1)
    return s


def in_the_air(*numbers, **more):
    s = clamped(*numbers, **more)
    s.model.geom_contype[:] = 0
    return s


def free_edge(s):
    return s.moved()[s.number[:, -1, 1], 2].mean()


def a_strip_in_the_air_bends_as_a_beam():
    """w = q L^4 / (8 D) with Poisson's ratio 0, from a weight so small that all is linear."""
    gravity = .01
    w = free_edge(at_rest(in_the_air(4e4, 0.0, gravity)))
    ratio = w / (-1050 * gravity * THICK * LONG**4 / (8 * 4e4 * THICK**3 / 12))
    print(f"hanging beam: {ratio:.4f} of theory")
    return abs(ratio - 1) < .02


def a_wide_strip_is_stiffer_by_poissons_ratio():
    """Between a beam's E and a plate's E / (1 - nu^2), nearer the plate's for a strip more than half as wide as long."""
    gravity, nu = .01, .46
    ratio = free_edge(at_rest(in_the_air(4e4, nu, gravity))) / free_edge(at_rest(in_the_air(4e4, 0.0, gravity)))
    print(f"Poisson's ratio {nu}: bends {ratio:.4f} of what none does; a plate {1 - nu * nu:.4f}")
    return 1 - nu * nu < ratio < 1


def jaws_feel_what_a_beam_answers():
    """An end that is held level and lifted by d answers with 12 D b d / L^3, L up to the jaws."""
    s, d, force = in_the_air(4e4, 0.0, 1e-6), 2e-4, []
    pad = s.number[:, -3:, :].ravel()
    s.springs(pad, mujoco_sheet.RIGID)
    for lift in (0, d):
        s.goal[pad] = [0, 0, lift]
        force.append(at_rest(s).pull(pad)[2])
    length = s.rest[s.number[0, -3, 0], 1] - STRIP
    ratio = (force[0] - force[1]) / (12 * 4e4 * THICK**3 / 12 * WIDE * d / length**3)
    print(f"lifted end: {ratio:.4f} of theory")
    return abs(ratio - 1) < .04


def a_long_strip_hangs_with_its_whole_weight_from_the_clamp():
    s = at_rest(in_the_air(4e4, .46, 1.0))
    clamp = np.flatnonzero(s.hold[:, 0] > 0)
    ratio = -s.pull(clamp)[2] / (s.mass.sum() * 1.0)
    print(f"weight on the clamp: {ratio:.4f} of the sheet's")
    return abs(ratio - 1) < .001


def a_sheet_on_the_board_lies_still_and_keeps_its_thickness():
    s = clamped(3e4, .46, 9.81, bed=5e7)
    for _ in range(12):
        s.calm(4)
    before = s.moved()
    for _ in range(20):
        s.advance()
    crept = np.abs(s.moved() - before).max()
    z = s.positions()[:, 2].reshape(s.shape)
    thin = 1 - (z[:, :, 2] - z[:, :, 0]).mean() / THICK
    print(f"on the board: {crept * 1e6:.2f} um in 0.25 s, sunk by {-z.min() * 1e6:.1f} um, thinner by {thin * 100:.2f} %")
    return crept < 5e-6 and -z.min() < 3e-5 and abs(thin) < .005


if __name__ == "__main__":
    laws = [a_strip_in_the_air_bends_as_a_beam, a_wide_strip_is_stiffer_by_poissons_ratio, jaws_feel_what_a_beam_answers,
            a_long_strip_hangs_with_its_whole_weight_from_the_clamp, a_sheet_on_the_board_lies_still_and_keeps_its_thickness]
    broken = [law.__name__ for law in laws if not law()]
    sys.exit(f"broken: {', '.join(broken)}" if broken else 0)

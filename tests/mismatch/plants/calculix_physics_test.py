#!/usr/bin/python3
"""The sheet of the plant calculix keeps to laws that are known without it. Ends with 77 where ccx is missing."""
import os
import sys

sys.dont_write_bytecode = True
sys.path.insert(0, os.path.dirname(os.path.abspath(__file__)))
try:
    import numpy as np
except ImportError:
    print("no numpy here")
    sys.exit(77)

import calculix_sheet

if not calculix_sheet.program():
    print("no ccx here")
    sys.exit(77)

THICK, STRIP, LONG, WIDE = .003, .006, .05, .03


def in_the_air(young, poisson, gravity, pad=0.0, law="neo-Hooke"):
    """Clamped, with jaws over the last `pad` metres."""
    m = calculix_sheet.Material()
    m.young, m.poisson, m.law = young, poisson, law
    ys = calculix_sheet.lines([0, STRIP, STRIP + LONG - pad, STRIP + LONG] if pad else [0, STRIP, STRIP + LONG], 7)
    s = calculix_sheet.Sheet(np.linspace(0, WIDE, 4), ys, THICK, m, gravity=gravity)
    s.clamp(1e10, STRIP)
    s.pad = s.rest[..., 1] > STRIP + LONG - pad - 1e-9
    if not pad:
        s.pad[:] = False
    return s


def free_edge(s):
    return np.nanmean(s.settled()[:, -1, 0, 2])


def a_strip_in_the_air_bends_as_a_beam():
    """w = q L^4 / (8 D) with Poisson's ratio 0, from a weight so small that all is linear."""
    gravity = .01
    ratio = free_edge(in_the_air(4e4, 0.0, gravity)) / (-1050 * gravity * THICK * LONG**4 / (8 * 4e4 * THICK**3 / 12))
    print(f"hanging beam: {ratio:.4f} of theory")
    return abs(ratio - 1) < .02


def a_wide_strip_is_stiffer_by_poissons_ratio():
    """Between a beam's E and a plate's E / (1 - nu^2), nearer the plate's for a strip more than half as wide as long."""
    gravity, nu = .01, .46
    ratio = free_edge(in_the_air(4e4, nu, gravity)) / free_edge(in_the_air(4e4, 0.0, gravity))
    print(f"Poisson's ratio {nu}: bends {ratio:.4f} of what none does; a plate {1 - nu * nu:.4f}")
    return 1 - nu * nu < ratio < 1


def laws_are_one_at_small_strains():
    ratio = free_edge(in_the_air(4e4, .46, .01, law="Mooney-Rivlin")) / free_edge(in_the_air(4e4, .46, .01))
    print(f"Mooney-Rivlin: bends {ratio:.4f} of what neo-Hooke does")
    return abs(ratio - 1) < .002


def jaws_feel_what_a_beam_answers():
    """An end that is held level and lifted by d answers with 12 D b d / L^3, L up to the jaws. So does the clamp."""
    pad, d = .008, 2e-4
    s = in_the_air(4e4, 0.0, 1e-6, pad)
    count = len(s.held())
    _, force = s.carried(np.array([np.zeros((count, 3)), np.tile([0, 0, d], (count, 1))]), [0, 1], [1])
    ratio = -force[0, 2] / (12 * 4e4 * THICK**3 / 12 * WIDE * d / (LONG - pad)**3)
    print(f"lifted end: {ratio:.4f} of theory")
    return abs(ratio - 1) < .04


def jaws_carry_themselves_and_half_of_the_span():
    """What they hold, brought level with the clamp, and half the weight between."""
    pad, gravity = .008, .01
    s = in_the_air(4e4, 0.0, gravity, pad)
    hanging = s.settled()[s.pad & (s.number > 0)]
    _, force = s.carried(np.array([hanging, np.zeros_like(hanging)]), [0, 1], [1])
    ratio = -force[0, 2] / (1050 * gravity * THICK * WIDE * (pad + (LONG - pad) / 2))
    print(f"weight on the jaws: {ratio:.4f} of theory")
    return abs(ratio - 1) < .01


def a_sheet_on_the_board_keeps_its_thickness():
    s = in_the_air(3e4, .46, 9.81)
    s.lie_on(.3)
    z = s.settled()[..., 2]
    thin = -np.nanmean(z[:, :, 2] - z[:, :, 0]) / THICK
    print(f"on the board: sunk by {-np.nanmin(z[:, :, 0]) * 1e6:.1f} um, thinner by {thin * 100:.2f} %")
    return np.nanmin(z[:, :, 0]) > -3e-5 and abs(thin) < .005


if __name__ == "__main__":
    laws = [a_strip_in_the_air_bends_as_a_beam, a_wide_strip_is_stiffer_by_poissons_ratio, laws_are_one_at_small_strains,
            jaws_feel_what_a_beam_answers, jaws_carry_themselves_and_half_of_the_span,
            a_sheet_on_the_board_keeps_its_thickness]
    broken = [law.__name__ for law in laws if not law()]
    sys.exit(f"broken: {', '.join(broken)}" if broken else 0)

"""The whirlpool (section 3.1.3 of the paper): a disc turns clockwise in place.

python bench/whirlpool.py

The paper's three rotations with its weights, on corners of our plate, in quick strokes as its
averages take for granted; then Method A within our rig's limits, asked for no force and a clockwise
curl. Printed are the disc's turning rate and the speed of its centre, second by second.
"""

from __future__ import annotations

import argparse

import numpy as np

from plate_core import PlateCycle, Rig, load_rig, piped
from plate_core.motion import usage
from plate_sim import simulate_bodies
from plate_sim.friction import disc
from plate_solver import RotationSolver

CORNERS = 0.3 * np.array([[-1, -0.5], [1, -0.5], [1, 0.5]])
"""Centres of rotation [m]: the paper's, 0.3 times as large, as our plate is."""

WEIGHTS = np.array([0.59, 0.27, 0.53])
"""The paper's, all clockwise."""

PLACE = np.array([[0.15, 0.0]])
"""Of the disc [m]."""

BACK, RAMP, SPIN = 0.1, 0.05, 1.0
"""Shares of a rotation: the return stroke, each change of speed; and the slow speed [rad/s]."""

CURL = -1.0
"""Asked of Method A [mu m g/m]."""

SECONDS = 6


@piped()
def main() -> None:
    """Run the command line."""
    argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0]).parse_args()
    rig = load_rig()
    print("cycle [ms]  disc [mm]  of limits  turns [rad/s], each second       centre [mm/s]")
    for period in (0.002, 0.005, 0.02):
        for radius in (0.008, 0.02):
            show(strokes(period), radius, rig, 2e-5)
    solution = RotationSolver(rig).solve(PLACE, np.zeros((1, 2)), curl=np.array([CURL]))
    print(f"Method A within the rig's limits: {solution.message}")
    for radius in (0.008, 0.02):
        show(solution.cycle, radius, rig, 2e-4)


def show(cycle: PlateCycle, radius: float, rig: Rig, step: float) -> None:
    """Run a disc for some seconds and print how it turned and moved."""
    every = round(1 / cycle.period)
    run = simulate_bodies(
        cycle, disc(radius), PLACE, 0, np.zeros((1, 2)), 0, rig.friction.mu,
        rig.friction.gravity, SECONDS * every, 1, step,
    )  # fmt: skip
    turns, moves = np.diff(run.angle[::every, 0]), np.diff(run.position[::every, 0], axis=0)
    print(
        f"{1e3 * cycle.period:10.0f} {1e3 * radius:10.0f} {usage(rig, cycle).worst:10.3g}  "
        f"{' '.join(f'{turn:.3f}' for turn in turns)}  "
        f"{' '.join(f'{1e3 * np.hypot(*move):.2f}' for move in moves)}"
    )


def strokes(period: float) -> PlateCycle:
    """Turn about each corner clockwise, slowly, for its share of time, and quickly back."""
    t, rows = 0.0, [(0.0, *np.zeros(9))]
    for centre, share in zip(CORNERS, period * WEIGHTS / WEIGHTS.sum(), strict=True):
        ramp = RAMP * share
        slow, fast = (1 - BACK) * share - 1.5 * ramp, BACK * share - 1.5 * ramp
        home = SPIN * (ramp + slow) / (ramp + fast)
        angle = spin = 0.0
        for time, after in [(ramp, -SPIN), (slow, -SPIN), (ramp, home), (fast, home), (ramp, 0.0)]:
            angle, t, spin = angle + 0.5 * time * (spin + after), t + time, after
            c, s = np.cos(angle), np.sin(angle)
            x, y = -np.array([[c, -s], [s, c]]) @ centre
            place = (centre[0] + x, centre[1] + y, angle, -spin * y, spin * x, spin)
            rows.append((t, *place, -spin * spin * x, -spin * spin * y, 0.0))
    knots = np.array(rows)
    return PlateCycle.from_knots(knots[:, 0], knots[:, 1:4], knots[:, 4:7], knots[:, 7:])


if __name__ == "__main__":
    main()

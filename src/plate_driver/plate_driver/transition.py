"""From rest into a motion and back: every motor table begins and ends at home, at rest."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle

MIN_KNOTS = 48
"""Least knots per fade. With 48 and 8 harmonics the splines miss the exact fade by 1e-5 of the
pose and 2e-4 of the acceleration; pose, twist and acceleration stay continuous in any case."""


def table(cycle: PlateCycle, repeats: int = 1) -> PlateCycle:
    """Return a motion that starts and ends at home, at rest.

    Parameters
    ----------
    cycle : PlateCycle
        Returned unchanged if it starts at rest. Any other is faded in over one period, played
        `repeats` times, and faded out over one, all in one table.
    repeats : int
        At least 1.
    """
    if cycle.starts_at_rest:
        return cycle
    times, pose, twist, accel = _faded_in(cycle)
    period = cycle.period
    # The fade out is the fade in of the motion played backwards, played backwards.
    back_times, back_pose, back_twist, back_accel = _faded_in(backwards(cycle))
    plays = [
        (
            (1 + i) * period + cycle.times[1:],
            cycle.knot_pose[1:],
            cycle.knot_twist[1:],
            cycle.knot_accel[1:],
        )
        for i in range(repeats)
    ]
    end = (2 + repeats) * period
    out = (end - back_times[-2::-1], back_pose[-2::-1], -back_twist[-2::-1], back_accel[-2::-1])
    parts = [(times, pose, twist, accel), *plays, out]
    return PlateCycle.from_knots(*(np.concatenate(column) for column in zip(*parts, strict=True)))


def backwards(cycle: PlateCycle) -> PlateCycle:
    """Return the motion from its end to its start, in the same time."""
    return PlateCycle.from_knots(
        cycle.period - cycle.times[::-1],
        cycle.knot_pose[::-1],
        -cycle.knot_twist[::-1],
        cycle.knot_accel[::-1],
    )


def _faded_in(cycle: PlateCycle) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Knots of s(t/T) times the pose: times (n + 1,), pose, twist, accel (n + 1, 3).

    s(u) = 10 u^3 - 15 u^4 + 6 u^5 rises from 0 to 1 with no slope and no curvature at both ends.
    """
    pieces = -(-MIN_KNOTS // (len(cycle.times) - 1))  # rounded up
    steps = np.arange(pieces) / pieces
    times = (cycle.times[:-1, None] + np.diff(cycle.times)[:, None] * steps).ravel()
    times = np.append(times, cycle.period)
    pose, twist, accel = cycle.pose(times), cycle.twist(times), cycle.accel(times)
    u = (times / cycle.period)[:, None]
    s = u**3 * (10 - 15 * u + 6 * u**2)
    ds = 30 * u**2 * (1 - u) ** 2 / cycle.period
    dds = 60 * u * (1 - u) * (1 - 2 * u) / cycle.period**2
    return (
        times,
        s * pose,
        ds * pose + s * twist,
        dds * pose + 2 * ds * twist + s * accel,
    )

"""A gentle cycle, for tests of programs that play it."""

import numpy as np

from plate_core import PlateCycle

PERIOD = 0.1
"""Default length of the cycle [s]."""


def shaking(amplitude: float, period: float = PERIOD) -> PlateCycle:
    """Return a cycle of two harmonics that starts at rest, with an amplitude [m]."""
    t = np.arange(48) * period / 48
    wave = np.sin(np.pi * t / period) ** 4
    phase = 4 * np.pi * t / period
    pose = np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    cycle = PlateCycle.from_samples(period, amplitude * pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0  # the spline's derivatives are only almost zero
    return PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)

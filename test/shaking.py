"""A gentle cycle, for tests of programs that play it."""

import numpy as np

from plate_core import PlateCycle

PERIOD = 0.1
"""Default length of the cycle [s]."""


def shaking(amplitude: float, period: float = PERIOD, turns: int = 2) -> PlateCycle:
    """Return a cycle of some turns that starts at rest, with an amplitude [m]."""
    t = np.arange(48) * period / 48
    wave = np.sin(np.pi * t / period) ** 4
    phase = 2 * np.pi * turns * t / period
    pose = np.column_stack([wave * np.sin(phase), wave * np.cos(phase), 2 * wave])
    return from_rest(period, amplitude * pose)


def from_rest(period: float, pose: np.ndarray) -> PlateCycle:
    """Return the cycle through samples of the pose (n, 3) that is at rest at both ends."""
    cycle = PlateCycle.from_samples(period, pose)
    twist, accel = cycle.knot_twist.copy(), cycle.knot_accel.copy()
    twist[[0, -1]] = accel[[0, -1]] = 0  # the spline's derivatives are only almost zero
    return PlateCycle.from_knots(cycle.times, cycle.knot_pose, twist, accel)


def bump(height: float, period: float = PERIOD) -> PlateCycle:
    """Return a cycle along x and back: `height` [m] half-way, at rest at both ends."""
    t = np.arange(33) / 32
    u, scale = t * (1 - t), height * 4**3  # the bump is 64 u^3
    pose, twist, accel = np.zeros((3, 33, 3))
    pose[:, 0] = scale * u**3
    twist[:, 0] = scale * 3 * u**2 * (1 - 2 * t) / period
    accel[:, 0] = scale * (6 * u * (1 - 2 * t) ** 2 - 6 * u**2) / period**2
    return PlateCycle.from_knots(period * t, pose, twist, accel)

"""The effect of a plate cycle on parts that are at rest at any position when the cycle begins. The
functions compute the drift of the parts, and the mean force as defined in the paper."""

from __future__ import annotations

import numpy as np

from plate_core import PlateCycle, Rig
from plate_core.rig import surface_velocity

STEPS = 200
"""Number of time steps per cycle."""

RESTING = 1e-6
"""Speed of the plate's surface below which a resting part does not slide [m/s]."""


def grid(rig: Rig, count: int = 17) -> tuple[np.ndarray, np.ndarray]:
    """Return the coordinates x (count,) and y (n,) [m, plate_home] of a grid on the plate. The grid
    has the same step along x and y."""
    half = rig.plate.half
    rows = max(3, round(count * half[1] / half[0]))
    return (
        np.linspace(-half[0], half[0], 2 * count + 1)[1::2],
        np.linspace(-half[1], half[1], 2 * rows + 1)[1::2],
    )


def mean_force(cycle: PlateCycle, point: np.ndarray) -> np.ndarray:
    """Mean friction on parts that rest at world-fixed points (section 3.1 of the paper).

    s(t) is the velocity of the plate's surface at a point. The mean force is the mean of s /
    norm(s) over a cycle.

    Parameters
    ----------
    cycle : PlateCycle
    point : (M, 2)
        Points [m, plate_home].

    Returns
    -------
    (M, 2)
        Mean force [mu m g].
    """
    t = (np.arange(STEPS) + 0.5) * cycle.period / STEPS
    slip = surface_velocity(cycle.pose(t)[:, None], cycle.twist(t)[:, None], point[None])
    speed = np.linalg.norm(slip, axis=2, keepdims=True)
    return np.asarray(np.mean(np.where(speed > RESTING, slip / np.maximum(speed, RESTING), 0.0), 0))


def drift(cycle: PlateCycle, point: np.ndarray, accel: float) -> np.ndarray:
    """Mean velocity over one cycle of parts that rest at the given points when the cycle begins.

    Parts are points that slide or stick. The parts are integrated in steps of 1/200 of the cycle.
    The accuracy of the result is sufficient for display, but not for planning.

    Parameters
    ----------
    cycle : PlateCycle
    point : (M, 2)
        Points [m, plate_home].
    accel : float
        mu g, the maximum acceleration by friction [m/s2].

    Returns
    -------
    (M, 2)
        Mean velocity [m/s, plate_home].
    """
    step = cycle.period / STEPS
    t = (np.arange(STEPS) + 0.5) * step
    poses, twists = cycle.pose(t), cycle.twist(t)
    position, velocity = point.copy(), np.zeros_like(point)
    for pose, twist in zip(poses, twists, strict=True):
        slip = surface_velocity(pose, twist, position) - velocity
        speed = np.hypot(slip[:, 0], slip[:, 1])[:, None]
        velocity += slip * np.minimum(1.0, accel * step / np.maximum(speed, 1e-12))
        position += velocity * step
    return np.asarray((position - point) / cycle.period)

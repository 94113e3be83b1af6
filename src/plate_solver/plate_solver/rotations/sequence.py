"""A sequence of rotations as one closed motion in time, from rest to rest.

Rotation j is held at a constant twist for a time and joined to the next by a smooth ramp (a cubic
in the twist) as short as the acceleration allows. What is then still missing to a closed motion is
taken out by a smooth bump over the whole cycle, so every sequence closes exactly. The derivatives
are exact: one backward pass over the knots (sequence.hpp).

Knots of J rotations: 0 at rest; 2 j + 1 and 2 j + 2 begin and end rotation j (from 0); 2 J + 1 at
rest; 2 J + 2 the end of the period.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels


def ramps(
    twists: np.ndarray, half: np.ndarray, loads: np.ndarray, accel: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return the lengths (J + 1,) [s] of the ramps and their derivatives (J + 1, 3).

    Parameters
    ----------
    twists : (J, 3)
        Twist of each rotation; rest comes before the first and after the last.
    half : (2,)
        Half sides [m].
    loads : (m, 3)
        Of what else has a limit, such as motors' forces: rows whose product with the plate's
        acceleration is kept below `accel` too.
    accel : float
        Peak acceleration of the fastest corner [m/s2].

    Returns
    -------
    length : (J + 1,)
    slope : (J + 1, 3)
        By the change of twist; the rotation after the ramp adds, the one before it takes away.
    """
    return _kernels.ramps(twists, half, loads, accel)


def timeline(
    holds: np.ndarray, twists: np.ndarray, ramp: np.ndarray, period: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return knot times (2 J + 3,) [s] and twists there (2 J + 3, 3).

    `holds` (J + 1,) are the relative lengths of the J rotations and of the rest at the end: they
    fill what the ramps leave of the period.
    """
    return _kernels.timeline(holds, twists, ramp, period)


def knot_poses(times: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return the pose (K, 3) at every knot before the motion is closed."""
    return _kernels.knot_poses(times, knots)


def motion(
    times: np.ndarray, knots: np.ndarray, counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return pose, twist, acceleration (n, 3) at the middles of steps, and the steps (n,) [s].

    Every ramp is cut into `counts[0]` equal steps, every hold into `counts[1]`: as steps end where
    segments end, what follows from them is as smooth in the parameters as the friction allows.
    Last comes the gap (3,) that had to be closed.
    """
    return _kernels.motion(times, knots, counts)

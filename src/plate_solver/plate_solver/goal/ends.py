"""Errors of the parts' positions and angles at the end of a cycle.

Let q be a coordinate at the end of the cycle, [l, h] its requested interval and w its weight. Let b
be the distance by which the centre of a part is beyond a wall (a limit near the edge of the plate).
Let r be the distance between the centres of two parts, and c the minimum of r. The errors are

    w (nearest point of [l, h] - q),    +-(b + b^2 / 0.01 m),    c - r  if r < c.

If an exact drift is requested, the interval has zero width and the weight is 1. If a target region
is requested, its weight is small. The search minimises the sum of the squared errors. Therefore,
the parts with the longest distances from their targets dominate this sum. Angles are coordinates
like x and y, but their weights have the unit metres per radian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np


class Ends(NamedTuple):
    """Requested coordinates of M parts at the end of a cycle.

    The coordinates are x of all parts, then y of all parts. If rotations are requested, the angles
    of all parts follow. The number C of coordinates is therefore 2 M or 3 M.

    Attributes
    ----------
    low, high : (C,)
        Interval in which each coordinate has no error [m, plate_home; rad]. Infinite bounds are
        allowed.
    weight : (C,)
        Error divided by the distance from the interval, for each coordinate [-]. For angles, the
        unit is m/rad.
    edge_low, edge_high : (C,)
        Positions of the lower and the upper wall for each coordinate [m]. Infinite for angles.
    pair : (K, 2)
        Indices of the two parts of each pair that may come too close to each other.
    clear : (K,)
        Minimum distance of the centres of each pair [m].
    parts : int
        Number of parts M.
    """

    low: np.ndarray
    high: np.ndarray
    weight: np.ndarray
    edge_low: np.ndarray
    edge_high: np.ndarray
    pair: np.ndarray
    clear: np.ndarray
    parts: int

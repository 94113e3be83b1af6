"""Errors of the parts' positions and angles at the end of a cycle.

A coordinate q has the interval [l, h] and the weight w. b is the distance of a part's centre beyond
a wall. r is the distance between the centres of two parts, and c is its minimum. The errors are

    w (nearest point of [l, h] - q),    +-(b + b^2 / 0.01 m),    c - r  if r < c.

An exact drift is requested by an interval of zero width with weight 1. A distant target region has
a small weight. The search minimises the sum of the squared errors, so parts with long distances
still dominate it. Angles are coordinates like x and y, but their weight has the unit metres per
radian.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels


class Ends(NamedTuple):
    """Requested coordinates of M parts at the end of a cycle.

    The coordinates are x of all parts, then y of all parts. If rotations are requested, the angles
    of all parts follow. So C is 2 M or 3 M.

    Attributes
    ----------
    low, high : (C,)
        Interval in which a coordinate has no error [m, plate_home; rad]. Infinite ends are allowed.
    weight : (C,)
        Error per metre outside the interval [-]. For angles: error per radian [m].
    edge_low, edge_high : (C,)
        Positions of the walls [m]; infinite for angles.
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


def end_errors(place: np.ndarray, ends: Ends) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (R,) [m] of end coordinates (C,) [m, rad], and their negative derivatives
    (R, C).

    The first C errors belong to the coordinates, the others to pairs of parts that are too close.
    """
    return _kernels.end_errors(place, ends)

"""Where parts are to be at the end of a cycle, and what it costs where they are not.

A part that is outside the interval asked of it errs by how far, times its weight. So an exact drift
is an interval without width and weight 1, and a region far away is one that counts little for each
metre: then the parts with the longest ways come first. Where parts are too near to each other each
metre counts in full, beyond a wall more and more. An angle is a coordinate like x and y; what a
radian of it counts is the weight.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .. import _kernels


class Ends(NamedTuple):
    """What is asked of M parts at the end of a cycle: x of all, then y of all, then, where angles
    count, those of all; C = 2 M or 3 M coordinates.

    Attributes
    ----------
    low, high : (C,)
        Anywhere between is as good [m, plate_home; rad]; infinite where all is.
    weight : (C,)
        What a metre beside it counts [-], or a radian [m].
    edge_low, edge_high : (C,)
        Walls [m]; infinite for angles.
    pair : (K, 2)
        Rows of parts that may come near each other.
    clear : (K,)
        Least distances of their centres [m].
    parts : int
        M.
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
    """Return the errors (R,) of ends (C,) [m, rad], and minus their derivatives (R, C).

    The first C are those of the coordinates, then come pairs that are too near.
    """
    return _kernels.end_errors(place, ends)

"""Where parts are to be at the end of a cycle, and what it costs where they are not.

A part that is outside the interval asked of it errs by how far, times its weight. So an exact drift
is an interval without width and weight 1, and a region far away is one that counts little for each
metre: then the parts with the longest ways come first. Where parts are too near to each other each
metre counts in full, beyond a wall more and more. An angle is a coordinate like x and y; what a
radian of it counts is the weight.
"""

from __future__ import annotations

from math import sqrt
from typing import NamedTuple

import numpy as np

from plate_core.kernels import kernel

STEEP_M = 0.01
"""So far beyond a wall a metre counts twice as much on average [m]: else many parts on their way
push one that is at home over the edge."""


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


@kernel(fastmath=False, error_model="numpy")
def end_errors(place: np.ndarray, ends: Ends) -> tuple[np.ndarray, np.ndarray]:
    """Return the errors (R,) of ends (C,) [m, rad], and minus their derivatives (R, C).

    The first C are those of the coordinates, then come pairs that are too near.
    """
    size, count = len(place), ends.parts
    rows = size
    error, slope = np.zeros(size + len(ends.pair)), np.zeros((size + len(ends.pair), size))
    for j in range(size):
        at = place[j]
        if at < ends.low[j]:
            error[j] += ends.weight[j] * (ends.low[j] - at)
            slope[j, j] += ends.weight[j]
        elif at > ends.high[j]:
            error[j] += ends.weight[j] * (ends.high[j] - at)
            slope[j, j] += ends.weight[j]
        if at < ends.edge_low[j]:
            beyond = ends.edge_low[j] - at
            error[j] += beyond + beyond * beyond / STEEP_M
            slope[j, j] += 1 + 2 * beyond / STEEP_M
        elif at > ends.edge_high[j]:
            beyond = at - ends.edge_high[j]
            error[j] -= beyond + beyond * beyond / STEEP_M
            slope[j, j] += 1 + 2 * beyond / STEEP_M
    for k in range(len(ends.pair)):
        a, b = ends.pair[k, 0], ends.pair[k, 1]
        dx, dy = place[b] - place[a], place[count + b] - place[count + a]
        distance = max(sqrt(dx * dx + dy * dy), 1e-9)
        if distance < ends.clear[k]:
            error[rows] = ends.clear[k] - distance
            slope[rows, b], slope[rows, a] = dx / distance, -dx / distance
            slope[rows, count + b], slope[rows, count + a] = dy / distance, -dy / distance
            rows += 1
    return error[:rows].copy(), slope[:rows].copy()

"""Which discs may touch: a list of close pairs that stays good over many steps."""

from __future__ import annotations

import numpy as np
from numba import njit

SKIN = 0.5
"""Pairs apart by less than this share of the radius are watched; until two discs have moved so far
towards each other, no other pair can touch."""


@njit(cache=True)
def by_place(position, order):
    """Sort indices of discs (M,) by x, then y, of their position (M, 2), in place.

    Insertion: quick where little has changed since.
    """
    for a in range(1, len(order)):
        i = order[a]
        b = a
        while b > 0 and _before(position, i, order[b - 1]):
            order[b] = order[b - 1]
            b -= 1
        order[b] = i


@njit(cache=True)
def _before(position, i, j):
    if position[i, 0] != position[j, 0]:
        return position[i, 0] < position[j, 0]
    return position[i, 1] < position[j, 1]


@njit(cache=True)
def near_pairs(x, y, order, radius, pairs, x0, y0):
    """List the pairs that may soon touch, and note in x0, y0 where they are now.

    Parameters
    ----------
    x, y : (M,)
        Centres [m].
    order : (M,)
        Indices, about in order of x; sorted here.
    radius : float
        Of all discs [m].
    pairs : (C, 2)
        Room for the list, replaced by more where it does not suffice.
    x0, y0 : (M,)
        Filled.

    Returns
    -------
    pairs, found : (C, 2), int
        The list, and how many rows of it are used.
    gap : float
        Least gap [m] of any two discs, at most `SKIN` times the radius.
    """
    reach = (2 + SKIN) * radius
    least2 = reach * reach
    x0[:], y0[:] = x, y
    for a in range(1, len(order)):
        i = order[a]
        b = a
        while b > 0 and x[i] < x[order[b - 1]]:
            order[b] = order[b - 1]
            b -= 1
        order[b] = i
    found = 0
    for a in range(len(order)):
        i = order[a]
        for b in range(a + 1, len(order)):
            j = order[b]
            dx, dy = x[j] - x[i], y[j] - y[i]
            if dx >= reach:
                break
            distance2 = dx * dx + dy * dy
            if distance2 < reach * reach:
                least2 = min(least2, distance2)
                if found == len(pairs):
                    more = np.empty((2 * len(pairs), 2), np.int64)
                    more[:found] = pairs
                    pairs = more
                pairs[found, 0], pairs[found, 1] = i, j
                found += 1
    return pairs, found, np.sqrt(least2) - 2 * radius

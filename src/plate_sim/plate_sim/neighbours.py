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
def near_pairs(x, y, order, radius, pairs, x0, y0, work):
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
    x0, y0, work : (M,), (M,), (2 or more, M)
        Filled; room to work in.

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
    count, found = len(order), 0
    sorted_x, sorted_y = work[0], work[1]
    for a in range(count):
        sorted_x[a], sorted_y[a] = x[order[a]], y[order[a]]
    for a in range(count):
        i, px, py = order[a], sorted_x[a], sorted_y[a]
        if len(pairs) < found + count:
            more = np.empty((2 * len(pairs) + count, 2), pairs.dtype)
            more[:found] = pairs[:found]
            pairs = more
        b = a + 1
        while b < count and sorted_x[b] < px + reach:
            dx, dy = sorted_x[b] - px, sorted_y[b] - py
            distance2 = dx * dx + dy * dy
            # No branch: whether a pair is near cannot be foretold.
            pairs[found, 0], pairs[found, 1] = i, order[b]
            found += distance2 < reach * reach
            least2 = min(least2, distance2)
            b += 1
    return pairs, found, np.sqrt(least2) - 2 * radius

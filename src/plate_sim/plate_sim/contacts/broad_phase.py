"""Which parts may touch: a list of close pairs that stays good over many steps."""

from __future__ import annotations

from math import inf, sqrt

import numpy as np

from plate_core.kernels import inner_kernel, kernel

from ..friction.step import X, Y

SKIN = 0.25
"""Pairs nearer than this share of the greatest reach are listed; until two parts have moved so far
towards each other, no other pair can touch."""


@kernel(nogil=True, error_model="numpy")
def near_pairs(state, bodies, here, order, pairs, marks):
    """List the pairs whose rims are near, and note in `marks` where parts are now.

    Parameters
    ----------
    state, bodies, here : (6, P), (P,) of BODY, (M,)
        As in `friction.step`, and which parts are on the plate.
    order : (M,)
        Indices, about in order of x; sorted here.
    pairs : (C, 2)
        Room for the list, replaced by more where it does not suffice.
    marks : (2, P)
        Filled.

    Returns
    -------
    pairs, found : (C, 2), int
        The list, and how many rows of it are used.
    skin, gap : float
        Distance [m] that parts may move towards each other until the list is out of date; least
        gap [m] of any two, at most the skin.
    """
    x, y = state[X], state[Y]
    count, most = len(here), 0.0
    marks[0], marks[1] = x, y
    for a in range(count):
        i = order[a]
        most = max(most, bodies[i].reach)
        b = a
        while b > 0 and x[i] < x[order[b - 1]]:  # insertion: quick where little has changed
            order[b] = order[b - 1]
            b -= 1
        order[b] = i
    skin = SKIN * most
    found, gap = 0, skin
    for a in range(count):
        i = order[a]
        if not here[i]:
            continue
        if len(pairs) < found + count:
            more = np.empty((2 * len(pairs) + count, 2), pairs.dtype)
            more[:found] = pairs[:found]
            pairs = more
        size = bodies[i].reach + skin
        for b in range(a + 1, count):
            j = order[b]
            dx, dy = x[j] - x[i], y[j] - y[i]
            if dx >= size + most:
                break
            if here[j] and dx * dx + dy * dy < (size + bodies[j].reach) ** 2:
                pairs[found, 0], pairs[found, 1] = i, j
                found += 1
                gap = min(gap, sqrt(dx * dx + dy * dy) - bodies[i].reach - bodies[j].reach)
    return pairs, found, skin, gap


@inner_kernel
def approach(state, here, marks):
    """Bound on how far [m] any two parts moved towards each other since `marks` were set."""
    low_x = low_y = inf
    high_x = high_y = -inf
    for i in range(len(here)):
        if here[i]:
            dx, dy = state[X, i] - marks[0, i], state[Y, i] - marks[1, i]
            low_x, high_x = min(low_x, dx), max(high_x, dx)
            low_y, high_y = min(low_y, dy), max(high_y, dy)
    if high_x < low_x:
        return 0.0
    return sqrt((high_x - low_x) ** 2 + (high_y - low_y) ** 2)

"""Which finite parts touch each other or a wall in a step, and the passes that end it."""

from __future__ import annotations

from math import cos, inf, sin, sqrt

import numpy as np
from numba import njit

# numba does not see changes in these: delete the cache then
from .body_step import END_PIECE, FIRST_PIECE, GYRATION2, RADIUS, REACH, SLIM, WIDTH
from .knocks import knock
from .touching import (
    COUNT,
    DEPTHS,
    put,
    touch_disc_piece,
    touch_discs,
    touch_pieces,
    touch_wall,
)

SWEEPS = 24
"""Gauss-Seidel passes over the near pairs of one step, at most."""

OVERLAP = 1e-5
"""Overlap [m] that ends the passes: a hundredth of a pixel."""

SKIN = 0.25
"""Pairs nearer than this share of the greatest reach are watched; until two parts have moved so far
towards each other, no other pair can touch."""


@njit(cache=True, nogil=True, error_model="numpy")
def near_pairs(parts, here, pairs, marks):
    """List pairs whose reaches are near, and note in `marks` (M, 2) where parts are now.

    Returns the list (C, 2), how many rows of it are used, the skin [m], and the least gap [m] of
    any two reaches, at most the skin.
    """
    most = 0.0
    for i in range(len(parts)):
        most = max(most, parts[i, REACH])
        marks[i, 0], marks[i, 1] = parts[i, 0], parts[i, 1]
    skin = SKIN * most
    found, gap = 0, skin
    for i in range(len(parts)):
        if not here[i]:
            continue
        if len(pairs) < found + len(parts):
            more = np.empty((2 * len(pairs) + len(parts), 2), pairs.dtype)
            more[:found] = pairs[:found]
            pairs = more
        for j in range(i + 1, len(parts)):
            if not here[j]:
                continue
            dx, dy = parts[i, 0] - parts[j, 0], parts[i, 1] - parts[j, 1]
            size = parts[i, REACH] + parts[j, REACH]
            if dx * dx + dy * dy < (size + skin) ** 2:
                pairs[found, 0], pairs[found, 1] = i, j
                found += 1
                gap = min(gap, sqrt(dx * dx + dy * dy) - size)
    return pairs, found, skin, gap


@njit(cache=True, nogil=True, error_model="numpy")
def moved(parts, here, marks):
    """Bound on how far [m] any two parts moved towards each other since the list was made."""
    low_x = low_y = inf
    high_x = high_y = -inf
    for i in range(len(parts)):
        if here[i]:
            dx, dy = parts[i, 0] - marks[i, 0], parts[i, 1] - marks[i, 1]
            low_x, high_x = min(low_x, dx), max(high_x, dx)
            low_y, high_y = min(low_y, dy), max(high_y, dy)
    if high_x < low_x:
        return 0.0
    return sqrt((high_x - low_x) ** 2 + (high_y - low_y) ** 2)


@njit(cache=True, nogil=True, error_model="numpy")
def settle(parts, pieces, corners, world, pairs, found, rules, step, touch, arms,
           plate, half, walls, here):  # fmt: skip
    """End closing speeds and overlaps after a step, in place.

    Parameters
    ----------
    parts : (M, 22)
        Columns as in `body_step`.
    pieces, corners, world : (P, 2), (C, 5), (C, 5)
        Rows of each piece's corners; corners in the parts' axes; room for those in the room.
    pairs, found : (N, 2), int
        Near pairs: the first rows.
    rules, step : (2,), float
        Restitution and friction; [s].
    touch, arms : (2, 9), (2, 4)
        Room to work in.
    plate, half, walls : (6,), (2,), bool
        The plate's pose and twist, half sides [m], and whether it has walls.
    here : (M,)
        Which parts are on the plate.
    """
    wall = np.zeros(WIDTH)
    wall[:6], wall[GYRATION2] = plate, 1.0  # any inertia: it has no lightness
    c, s = cos(plate[2]), sin(plate[2])
    for sweep in range(SWEEPS):
        deepest = 0.0
        for row in range(found):
            # Forth and back: pushes then travel both ways through a crowd.
            k = row if sweep % 2 == 0 else found - 1 - row
            i, j = pairs[k, 0], pairs[k, 1]
            dx, dy = parts[i, 0] - parts[j, 0], parts[i, 1] - parts[j, 1]
            size = parts[i, REACH] + parts[j, REACH]
            if dx * dx + dy * dy < size * size:
                depth = meet(
                    parts, pieces, corners, world, i, j, rules, step, touch, arms
                )  # fmt: skip
                deepest = max(deepest, depth)
        if walls:
            for i in range(len(parts)):
                rx, ry, reach = parts[i, 0] - plate[0], parts[i, 1] - plate[1], parts[i, REACH]
                near_x = abs(c * rx + s * ry) + reach > half[0]
                if here[i] and (near_x or abs(c * ry - s * rx) + reach > half[1]):
                    depth = _meet_walls(
                        parts[i], pieces, corners, world, rules, step, touch[0], arms, wall, half
                    )  # fmt: skip
                    deepest = max(deepest, depth)
        if deepest <= OVERLAP:
            break


@njit(cache=True, nogil=True, error_model="numpy")
def meet(parts, pieces, corners, world, i, j, rules, step, touch, arms):
    """Let two parts meet where they overlap most; return how deep [m]. With step 0, only look."""
    first, second = parts[i], parts[j]
    if parts[i, RADIUS] > 0 and parts[j, RADIUS] > 0:
        touch_discs(
            first[0], first[1], parts[i, RADIUS], second[0], second[1], parts[j, RADIUS],
            touch[0],
        )  # fmt: skip
        if touch[0, COUNT] == 0:
            return 0.0
        depth = touch[0, DEPTHS]
        if step > 0:
            knock(first, second, touch[0], rules, step, arms)
        return depth
    if parts[j, RADIUS] > 0:
        i, j = j, i
        first, second = second, first
    deepest = 0.0
    disc = parts[i, RADIUS] > 0
    _place(first, pieces, corners, world)
    _place(second, pieces, corners, world)
    for q in range(int(second[FIRST_PIECE]), int(second[END_PIECE])):
        other = world[pieces[q, 0] : pieces[q, 1]]
        for p in range(1 if disc else int(first[END_PIECE] - first[FIRST_PIECE])):
            if disc:
                touch_disc_piece(first[0], first[1], parts[i, RADIUS], other, touch[0])
            else:
                row = pieces[int(first[FIRST_PIECE]) + p]
                touch_pieces(world[row[0] : row[1]], other, touch[0])
            depth = 0.0
            for k in range(int(touch[0, COUNT])):
                depth = max(depth, touch[0, DEPTHS + k])
            if depth > deepest:
                deepest = depth
                touch[1] = touch[0]
    if deepest > 0 and step > 0:
        knock(first, second, touch[1], rules, step, arms)
    return deepest


@njit(cache=True, nogil=True, error_model="numpy")
def _place(part, pieces, corners, world):
    """Set the corners in the room of one part."""
    if part[END_PIECE] > part[FIRST_PIECE]:
        a, b = pieces[int(part[FIRST_PIECE]), 0], pieces[int(part[END_PIECE]) - 1, 1]
        put(corners[a:b], part[0], part[1], cos(part[2]), sin(part[2]), world[a:b])


@njit(cache=True, nogil=True, error_model="numpy")
def _meet_walls(
    part, pieces, corners, world, rules, step, touch, arms, wall, half
):  # fmt: skip
    """Let a part meet the walls, which are the plate's; return how deep [m] it was in them."""
    c, s = cos(wall[2]), sin(wall[2])
    deepest = 0.0
    for side in range(4):
        sign, far = 1.0 - 2 * (side % 2), half[side // 2]
        ox, oy = (sign * c, sign * s) if side < 2 else (-sign * s, sign * c)
        wx, wy = wall[0] + far * ox, wall[1] + far * oy
        if (wx - part[0]) * ox + (wy - part[1]) * oy >= part[REACH]:
            continue
        if part[RADIUS] > 0:
            depth = part[RADIUS] - (wx - part[0]) * ox - (wy - part[1]) * oy
            touch[0], touch[1], touch[2] = (1.0 if depth > 0 else 0.0), -ox, -oy
            arm = part[RADIUS] - 0.5 * depth
            touch[3], touch[4], touch[DEPTHS] = part[0] + arm * ox, part[1] + arm * oy, depth
        else:
            _place(part, pieces, corners, world)
            a, b = pieces[int(part[FIRST_PIECE]), 0], pieces[int(part[END_PIECE]) - 1, 1]
            touch_wall(world[a:b], wx, wy, -ox, -oy, touch)
        for k in range(int(touch[COUNT])):
            deepest = max(deepest, touch[DEPTHS + k])
        if touch[COUNT] > 0:
            knock(part, wall, touch, rules, step, arms)
    return deepest


@njit(cache=True, nogil=True, error_model="numpy")
def overlapping(parts, pieces, corners, world, pairs, found, share, touch, arms):
    """Return two parts that overlap by more than a share of the slimmer one, and how far [m]."""
    rules = np.zeros(2)
    for k in range(found):
        i, j = pairs[k, 0], pairs[k, 1]
        depth = meet(
            parts, pieces, corners, world, i, j, rules, 0.0, touch, arms
        )  # fmt: skip
        if depth > share * min(parts[i, SLIM], parts[j, SLIM]):
            return i, j, depth
    return -1, -1, 0.0

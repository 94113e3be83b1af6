"""Which parts touch each other or a wall in a step, and the passes of impulses that end it."""

from __future__ import annotations

from math import cos, inf, sin
from typing import NamedTuple

import numpy as np

from plate_core.kernels import inner_kernel, kernel

from ..friction.step import ANGLE, X, Y
from .discs import collide_discs, collide_with_wall, overlap
from .impulses import KEPT, closes, collide
from .manifold import (
    COUNT,
    DEPTHS,
    SIZE,
    disc_polygon,
    place_corners,
    polygon_polygon,
    polygon_wall,
)

SWEEPS = 24
"""Gauss-Seidel passes over the near pairs of one step, at most."""

OVERLAP = 1e-5
"""Overlap [m] that ends the passes: a hundredth of a pixel."""


MARGIN = 0.03
"""Pairs apart by less than this share of their size take part in the passes of a step, as others
may push them into each other."""

PUSHES = 4.0
"""A pass brings two parts closer by at most about this times the deepest overlap."""


class Outlines(NamedTuple):
    """The rims of all parts that are not discs.

    Attributes
    ----------
    pieces : (p, 2)
        Each convex piece's first corner, its last + 1.
    corners, placed : (c, 5)
        Columns as in `manifold`, in the parts' axes; room for those in plate_home.
    """

    pieces: np.ndarray
    corners: np.ndarray
    placed: np.ndarray


class Room(NamedTuple):
    """Room to work in: two contact manifolds (2, 9) and arms (2, 4); N close pairs (N, 2), M parts
    at the edge (M,)."""

    contact: np.ndarray
    arms: np.ndarray
    close: np.ndarray
    edge: np.ndarray


@kernel(nogil=True, error_model="numpy")
def room_for(pairs, count):
    """Return the room that so many parts with a list of pairs (N, 2) need."""
    return Room(
        np.zeros((2, SIZE)), np.empty((2, 4)), np.empty_like(pairs), np.empty(count, np.int64)
    )


@inner_kernel
def resolve_contacts(state, bodies, here, outlines, pairs, found, rules, step, plate, half, room):
    """End closing speeds and overlaps after a step, in place.

    Parameters
    ----------
    state, bodies, here : (6, P), (P,) of BODY, (M,)
        As in `friction.step`, and which parts are on the plate; the last column and the last body
        are the walls'.
    outlines : Outlines
    pairs, found : (N, 2), int
        Near pairs: the first rows.
    rules : impulses.Rules
    step : float
        [s].
    plate, half : (6,), (2,)
        The plate's pose and twist, and its half sides [m].
    room : Room
    """
    contact, arms, close, edge = room
    for row in range(len(plate)):
        state[row, -1] = plate[row]
    way = cos(plate[ANGLE]), sin(plate[ANGLE])
    count, outer, margin, pushed = 0, 0, 0.0, inf
    for sweep in range(SWEEPS):
        if pushed > margin:
            count, margin = _close_pairs(state, bodies, pairs, found, close)
            if rules.walls:
                outer, margin = _near_walls(state, bodies, here, way, half, margin, edge)
            pushed = 0.0
        deepest = 0.0
        for row in range(count):
            # Forth and back: pushes then travel both ways through a crowd.
            k = row if sweep % 2 == 0 else count - 1 - row
            i, j = close[k, 0], close[k, 1]
            if bodies[i].radius > 0 and bodies[j].radius > 0:
                depth = collide_discs(state, bodies, i, j, rules, step)
            else:
                depth = _collide(state, bodies, i, j, outlines, contact, rules, step, arms)
            deepest = max(deepest, depth)
        for k in range(outer):
            depth = _meet_walls(state, bodies, edge[k], outlines, room, rules, step, half, way)
            deepest = max(deepest, depth)
        if deepest <= OVERLAP:
            break
        pushed += PUSHES * deepest


@inner_kernel
def _close_pairs(state, bodies, pairs, found, close):
    """Fill `close` with the pairs whose rims are within `MARGIN`; return how many there are, and
    the least distance [m] from which the others would have to be pushed."""
    count, margin = 0, inf
    for k in range(found):
        i, j = pairs[k, 0], pairs[k, 1]
        dx, dy = state[X, i] - state[X, j], state[Y, i] - state[Y, j]
        reach = bodies[i].reach + bodies[j].reach
        margin, size = min(margin, MARGIN * reach), (1 + MARGIN) * reach
        close[count, 0], close[count, 1] = i, j
        count += dx * dx + dy * dy < size * size  # no branch: it could not be predicted
    return count, margin


@inner_kernel
def _near_walls(state, bodies, here, way, half, margin, edge):
    """Fill `edge` with the parts that are within `MARGIN` of a wall; return how many there are, and
    the least of `margin` and the distance [m] from which the others would have to be pushed."""
    (c, s), wall, count = way, state.shape[1] - 1, 0
    for i in range(len(here)):
        reach = bodies[i].reach
        rx, ry, size = (
            state[X, i] - state[X, wall],
            state[Y, i] - state[Y, wall],
            (1 + MARGIN) * reach,
        )
        near = abs(c * rx + s * ry) + size > half[0] or abs(c * ry - s * rx) + size > half[1]
        edge[count] = i
        count += here[i] and near
        margin = min(margin, MARGIN * reach)
    return count, margin


@inner_kernel
def _collide(state, bodies, i, j, outlines, contact, rules, step, arms):
    """Let two parts collide if they touch, of which one at least is no disc; return how deep [m]
    they overlapped."""
    dx, dy = state[X, i] - state[X, j], state[Y, i] - state[Y, j]
    size = bodies[i].reach + bodies[j].reach
    if dx * dx + dy * dy >= size * size:
        return 0.0
    i, j, depth = _touch(state, bodies, i, j, outlines, contact)
    if depth > KEPT or closes(state, i, j, contact[1]):
        collide(state, bodies, i, j, contact[1], rules, step, arms)
    return depth


@kernel(nogil=True, error_model="numpy")
def deepest_overlap(state, bodies, outlines, pairs, found):
    """Return two parts of a list that overlap, and the depth [m] over the slimmer one's `slim`: the
    greatest; -1, -1, 0 if none do."""
    contact = np.zeros((2, SIZE))
    first, second, most, worst = -1, -1, 0.0, 0.0
    for k in range(found):
        i, j = pairs[k, 0], pairs[k, 1]
        if bodies[i].radius > 0 and bodies[j].radius > 0:
            depth = overlap(state, bodies, i, j)
        else:
            i, j, depth = _touch(state, bodies, i, j, outlines, contact)
        share = depth / min(bodies[i].slim, bodies[j].slim)
        if share > worst:
            first, second, most, worst = i, j, depth, share
    return first, second, most, worst


@inner_kernel
def _touch(state, bodies, i, j, outlines, contact):
    """Set contact[1] to where two parts overlap most, of which one at least is no disc.

    Returns
    -------
    i, j, depth : int, int, float
        The parts, a disc before a polygon, and how deep they overlap [m].
    """
    if bodies[j].radius > 0 and not bodies[i].radius > 0:
        i, j = j, i
    a, b = bodies[i], bodies[j]
    deepest, disc = 0.0, a.radius > 0
    contact[1, COUNT] = 0
    _place(state, a, i, outlines)
    _place(state, b, j, outlines)
    pieces, placed = outlines.pieces, outlines.placed
    for q in range(b.first_piece, b.end_piece):
        other = placed[pieces[q, 0] : pieces[q, 1]]
        for p in range(1 if disc else a.end_piece - a.first_piece):
            if disc:
                disc_polygon(state[X, i], state[Y, i], a.radius, other, contact[0])
            else:
                row = pieces[a.first_piece + p]
                polygon_polygon(placed[row[0] : row[1]], other, contact[0])
            depth = 0.0
            for k in range(int(contact[0, COUNT])):
                depth = max(depth, contact[0, DEPTHS + k])
            if depth > deepest:
                deepest = depth
                for k in range(SIZE):
                    contact[1, k] = contact[0, k]
    return i, j, deepest


@inner_kernel
def _place(state, body, i, outlines):
    """Set the corners in plate_home of one part."""
    if body.end_piece > body.first_piece:
        a, b = outlines.pieces[body.first_piece, 0], outlines.pieces[body.end_piece - 1, 1]
        c, s = cos(state[ANGLE, i]), sin(state[ANGLE, i])
        place_corners(outlines.corners[a:b], state[X, i], state[Y, i], c, s, outlines.placed[a:b])


@inner_kernel
def _meet_walls(state, bodies, i, outlines, room, rules, step, half, way):
    """Let a part meet the walls, which are the plate's; return how deep [m] it was in them.

    way (2,): cosine and sine of the plate's angle.
    """
    body, wall, contact = bodies[i], state.shape[1] - 1, room.contact
    c, s = way
    deepest = 0.0
    for side in range(4):
        sign, far = 1.0 - 2 * (side % 2), half[side // 2]
        ox, oy = (sign * c, sign * s) if side < 2 else (-sign * s, sign * c)
        wx, wy = state[X, wall] + far * ox, state[Y, wall] + far * oy
        apart = (wx - state[X, i]) * ox + (wy - state[Y, i]) * oy
        if apart >= body.reach:
            continue
        if body.radius > 0:
            deepest = max(deepest, body.radius - apart)
            collide_with_wall(state, bodies, i, body.radius - apart, -ox, -oy, rules, step)
            continue
        _place(state, body, i, outlines)
        a, b = outlines.pieces[body.first_piece, 0], outlines.pieces[body.end_piece - 1, 1]
        polygon_wall(outlines.placed[a:b], wx, wy, -ox, -oy, contact[1])
        for k in range(int(contact[1, COUNT])):
            deepest = max(deepest, contact[1, DEPTHS + k])
        if contact[1, COUNT] > 0:
            collide(state, bodies, i, wall, contact[1], rules, step, room.arms)
    return deepest

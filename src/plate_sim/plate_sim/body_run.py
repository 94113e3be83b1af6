"""All finite parts through cycles of the plate: friction, then contacts, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numba import njit

# numba does not see changes in these: delete the cache then
from .body_step import advance, piece_at
from .footprint import Footprint
from .meetings import moved, near_pairs, overlapping, settle
from .motion import END, START, THETA, X, Y, place, slope
from .touching import SIZE

START_OVERLAP = 0.1
"""Greatest overlap at the start, as a share of half the slimmer part's width."""


@dataclass(frozen=True)
class Shapes:
    """Footprints of M parts as flat arrays for compiled code.

    Attributes
    ----------
    facts : (M, 6)
        Columns as in `body_step`; mu g is filled in later.
    spans : (M, 4)
        Each part's first piece, its last + 1; first point, its last + 1.
    points, weights, blur : (n, 2), (n,), (n,)
        Of all footprints.
    pieces : (P, 2)
        Each piece's first corner, its last + 1.
    corners : (C, 5)
        Of all pieces, columns as in `touching`.
    """

    facts: np.ndarray
    spans: np.ndarray
    points: np.ndarray
    weights: np.ndarray
    blur: np.ndarray
    pieces: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, parts: Sequence[Footprint]) -> Shapes:
        """Put footprints one after the other."""
        facts, spans = np.empty((len(parts), 6)), np.empty((len(parts), 4), np.int64)
        pieces, first = [np.empty((0, 2), np.int64)], 0
        for i, part in enumerate(parts):
            facts[i] = 0, part.gyration2, part.radius, part.reach, 1 / part.mass, part.slim
            ends = first + np.cumsum([0, *(0 if part.radius else len(p) for p in part.outline)])
            rows = np.column_stack([ends[:-1], ends[1:]])[: 0 if part.radius else None]
            spans[i, :2] = sum(map(len, pieces)) + np.array([0, len(rows)])
            pieces.append(rows)
            first = ends[-1]
        end = np.cumsum([len(part.weights) for part in parts])
        spans[:, 3] = end
        spans[:, 2] = end - [len(part.weights) for part in parts]
        return cls(
            facts, spans,
            np.concatenate([np.empty((0, 2)), *(part.points for part in parts)]),
            np.concatenate([np.empty(0), *(part.weights for part in parts)]),
            np.concatenate([np.empty(0), *(part.blur for part in parts)]),
            np.concatenate(pieces),
            np.concatenate([np.empty((0, 5)), *(part.corners for part in parts)]),
        )  # fmt: skip


@njit(cache=True, nogil=True, error_model="numpy")
def run(table, steps, cycles, every, facts, ground, spans, points, weights, blur, pieces, corners,
        meets, rules, half, walls, here, bodies, record):  # fmt: skip
    """Advance parts through cycles of the plate, in place.

    Parameters
    ----------
    table, steps, cycles : (K, 23), int, int
        The plate's motion as `motion.tabulate` makes it; equal steps in a cycle; cycles.
    every : int
        Steps from one recorded state to the next.
    facts, spans, points, weights, blur, pieces, corners
        As in `Shapes`.
    ground : (3,)
        Pull x, y [m/s2], static over dynamic friction.
    meets, rules, walls : bool, (2,), bool
        Whether parts touch each other, their restitution and friction, whether there are walls.
    half : (2,)
        Half sides of the plate [m]; infinite if it is endless.
    here : (M,)
        Which parts are on the plate; changed.
    bodies : (M, 6)
        x, y [m], angle [rad] and their rates, plate_home; changed.
    record : (cycles * steps / every + 1, M, 6) or (0, M, 6)
        Filled, unless empty.

    Returns
    -------
    i, j, depth : int, int, float
        Parts that overlap too far [m] at the start: then nothing has moved. Else -1, -1, 0.
    """
    step = table[-1, END] / steps
    force, after = np.zeros((len(weights), 3)), np.empty(6)
    touch, arms, world = np.zeros((2, SIZE)), np.empty((2, 4)), np.empty_like(corners)
    pairs, marks = np.empty((4 * len(bodies), 2), np.int64), np.empty((len(bodies), 2))
    plate = np.empty(6)
    found, skin, gap = 0, np.inf, np.inf
    if meets:
        pairs, found, skin, gap = near_pairs(bodies, facts, here, pairs, marks)
        i, j, depth = overlapping(
            bodies, facts, spans, pieces, corners, world, pairs, found, START_OVERLAP, touch, arms
        )  # fmt: skip
        if depth > 0:
            return i, j, depth
    for k in range(cycles * steps):
        if len(record) and k % every == 0:
            record[k // every] = bodies
        start = (k % steps) * step
        for i in range(len(bodies)):
            if here[i]:
                a, b = spans[i, 2], spans[i, 3]
                advance(
                    table, start, step, facts[i], ground, points[a:b], weights[a:b], blur[a:b],
                    force[a:b], bodies[i], after,
                )  # fmt: skip
        _plate_at(table, start + step, plate)
        if meets:
            drift = moved(bodies, here, marks)
            if drift >= skin:
                pairs, found, skin, gap = near_pairs(bodies, facts, here, pairs, marks)
                drift = 0.0
            close = found if drift >= gap else 0
            if close or walls:
                settle(
                    bodies, facts, spans, pieces, corners, world, pairs, close, rules, step, touch,
                    arms, plate, half, walls, here,
                )  # fmt: skip
        if not walls and _drop(bodies, here, plate, half) and meets:
            pairs, found, skin, gap = near_pairs(bodies, facts, here, pairs, marks)
    if len(record):
        record[-1] = bodies
    return -1, -1, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _plate_at(table, t, plate):
    """Set the plate's pose and twist (6,) at time t [s]."""
    k = piece_at(table, t)
    u = t - table[k, START]
    plate[0], plate[1] = place(table, k, X, u), place(table, k, Y, u)
    plate[2], plate[5] = place(table, k, THETA, u), slope(table, k, THETA, u)
    plate[3], plate[4] = slope(table, k, X, u), slope(table, k, Y, u)


@njit(cache=True, nogil=True, error_model="numpy")
def _drop(bodies, here, plate, half):
    """Take parts whose centre is beyond the plate's edge away; return whether there were any."""
    c, s = cos(plate[2]), sin(plate[2])
    any_left = False
    for i in range(len(bodies)):
        rx, ry = bodies[i, 0] - plate[0], bodies[i, 1] - plate[1]
        if here[i] and (abs(c * rx + s * ry) > half[0] or abs(c * ry - s * rx) > half[1]):
            here[i] = False
            bodies[i, 3:] = 0.0
            any_left = True
    return any_left

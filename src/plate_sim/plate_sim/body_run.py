"""All finite parts through cycles of the plate: friction, then contacts, step by step."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

import numpy as np
from numba import njit

# numba does not see changes in these: delete the cache then
from .body_step import AFTER, GROUND, WIDTH, advance, plate_at
from .footprint import Footprint
from .meetings import moved, near_pairs, overlapping, settle
from .motion import END
from .touching import SIZE

START_OVERLAP = 0.1
"""Greatest overlap at the start, as a share of half the slimmer part's width."""


@dataclass(frozen=True)
class Shapes:
    """M parts and their footprints as flat arrays for compiled code.

    Attributes
    ----------
    parts : (M, 22)
        Columns as in `body_step`; states are filled in later.
    mesh : (n, 7)
        Points of all footprints, columns as in `rubbing`.
    pieces : (P, 2)
        Each convex piece's first corner, its last + 1.
    corners : (C, 5)
        Of all pieces, columns as in `touching`.
    """

    parts: np.ndarray
    mesh: np.ndarray
    pieces: np.ndarray
    corners: np.ndarray

    @classmethod
    def of(cls, footprints: Sequence[Footprint], limit: np.ndarray) -> Shapes:
        """Put footprints one after the other, of parts with mu g of `limit` (M,) [m/s2]."""
        parts = np.zeros((len(footprints), WIDTH))
        mesh, corners, pieces = [np.empty((0, 7))], [np.empty((0, 5))], [np.empty((0, 2), np.int64)]
        point = piece = corner = 0
        for i, part in enumerate(footprints):
            count = 0 if part.radius else len(part.outline)
            parts[i, AFTER:] = (
                *np.zeros(6), limit[i], part.gyration2, part.radius, point,
                point + len(part.points), part.reach, 1 / part.mass, part.slim, piece,
                piece + count,
            )  # fmt: skip
            ends = corner + np.cumsum([0, *(len(p) for p in part.outline[:count])])
            pieces.append(np.column_stack([ends[:-1], ends[1:]]))
            mesh.append(
                np.column_stack(
                    [part.points, part.weights, part.blur, np.zeros((len(part.blur), 3))]
                )
            )
            corners.append(part.corners)
            point, piece, corner = point + len(part.points), piece + count, ends[-1]
        return cls(parts, *(np.concatenate(rows) for rows in (mesh, pieces, corners)))


@njit(cache=True, nogil=True, error_model="numpy")
def run(
    table, steps, cycles, every, ground, parts, mesh, pieces, corners, meets, rules, half, walls,
    here, record,
):  # fmt: skip
    """Advance parts through cycles of the plate, in place.

    Parameters
    ----------
    table, steps, cycles : (K, 24), int, int
        The plate's motion as `motion.tabulate` makes it; equal steps in a cycle; cycles.
    every : int
        Steps from one recorded state to the next.
    ground : (3,)
        Pull x, y [m/s2], static over dynamic friction.
    parts, mesh, pieces, corners
        As in `Shapes`; states of parts are changed.
    meets, rules, walls : bool, (2,), bool
        Whether parts touch each other, their restitution and friction, whether there are walls.
    half : (2,)
        Half sides of the plate [m]; infinite if it is endless.
    here : (M,)
        Which parts are on the plate; changed.
    record : (cycles * steps / every + 1, M, 6) or (0, M, 6)
        Filled, unless empty.

    Returns
    -------
    i, j, depth : int, int, float
        Parts that overlap too far [m] at the start: then nothing has moved. Else -1, -1, 0.
    """
    step = table[-1, END] / steps
    touch, arms, world = np.zeros((2, SIZE)), np.empty((2, 4)), np.empty_like(corners)
    pairs, marks = np.empty((4 * len(parts), 2), np.int64), np.empty((len(parts), 2))
    plate = np.empty((7, 6))
    plate[GROUND, :3] = ground
    found, skin, gap = 0, np.inf, np.inf
    if meets:
        pairs, found, skin, gap = near_pairs(parts, here, pairs, marks)
        i, j, depth = overlapping(
            parts, pieces, corners, world, pairs, found, START_OVERLAP, touch, arms
        )  # fmt: skip
        if depth > 0:
            return i, j, depth
    for k in range(cycles * steps):
        if len(record) and k % every == 0:
            record[k // every] = parts[:, :6]
        start = (k % steps) * step
        for row in range(3):
            plate_at(table, start + 0.5 * row * step, plate, row)
        for i in range(len(parts)):
            if here[i]:
                advance(table, start, step, plate, parts, i, mesh)
        if meets:
            drift = moved(parts, here, marks)
            if drift >= skin:
                pairs, found, skin, gap = near_pairs(parts, here, pairs, marks)
                drift = 0.0
            close = found if drift >= gap else 0
            if close or walls:
                settle(
                    parts, pieces, corners, world, pairs, close, rules, step, touch, arms, plate[2],
                    half, walls, here,
                )  # fmt: skip
        if not walls and _drop(parts, here, plate[2], half) and meets:
            pairs, found, skin, gap = near_pairs(parts, here, pairs, marks)
    if len(record):
        record[-1] = parts[:, :6]
    return -1, -1, 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _drop(parts, here, plate, half):
    """Take parts whose centre is beyond the plate's edge away; return whether there were any."""
    c, s = cos(plate[2]), sin(plate[2])
    any_left = False
    for i in range(len(parts)):
        rx, ry = parts[i, 0] - plate[0], parts[i, 1] - plate[1]
        if here[i] and (abs(c * rx + s * ry) > half[0] or abs(c * ry - s * rx) > half[1]):
            here[i] = False
            parts[i, 3:6] = 0.0
            any_left = True
    return any_left

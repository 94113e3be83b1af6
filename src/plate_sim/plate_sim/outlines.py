"""Outlines of parts, made ready for drawing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from plate_core import PlateError

Outline = Sequence[np.ndarray]
"""Convex polygons (k, 2) that a part consists of [m, part's frame], corners counter-clockwise."""

MIN_SIDE = 1e-6
"""Shortest side of a polygon [m]: far below a pixel."""


class Outlines(NamedTuple):
    """Outlines of M parts.

    Attributes
    ----------
    edges : (e, 3)
        Outward normal, and distance from the part's centre [m], of all polygons' edges.
    pieces : (p + 1,)
        The first edge of every polygon; the end.
    first : (M + 1,)
        The first polygon of every part; the end.
    reach : (M,)
        How far the part reaches from its centre [m]; 0 for a disc.
    """

    edges: np.ndarray
    pieces: np.ndarray
    first: np.ndarray
    reach: np.ndarray


DISCS = Outlines(
    np.empty((0, 3)), np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty(0)
)  # fmt: skip
"""Of no polygons at all."""


def prepare(outlines: Sequence[Outline | None]) -> Outlines:
    """Return what drawing needs of outlines, None for a disc.

    Raises
    ------
    PlateError
        If an outline is not made of convex polygons with their corners counter-clockwise.
    """
    edges, pieces, first, reach = [np.empty((0, 3))], [0], [0], []
    for part, outline in enumerate(outlines):
        far = 0.0
        for polygon in () if outline is None else outline:
            sides = _edges(part, np.asarray(polygon, dtype=float))
            edges.append(sides)
            pieces.append(pieces[-1] + len(sides))
            far = max(far, float(np.linalg.norm(polygon, axis=1).max()))
        first.append(len(pieces) - 1)
        reach.append(far)
    return Outlines(np.concatenate(edges), np.array(pieces), np.array(first), np.array(reach))


def _edges(part: int, corner: np.ndarray) -> np.ndarray:
    """Return the edges (k, 3) of a polygon (k, 2)."""
    allowed = "at least 3 corners [m] counter-clockwise around a convex polygon"
    wrong = PlateError(f"outline: of part {part} is {corner.tolist()}, allowed: {allowed}")
    if corner.ndim != 2 or corner.shape[1:] != (2,) or len(corner) < 3:
        raise wrong
    side = np.roll(corner, -1, axis=0) - corner
    length = np.hypot(side[:, 0], side[:, 1])
    if not np.all(np.isfinite(corner)) or length.min() < MIN_SIDE:
        raise wrong
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1) / length[:, None]
    offset = np.sum(normal * corner, axis=1)
    outside = corner @ normal.T - offset
    if outside.max() > 1e-9:
        raise wrong
    return np.column_stack([normal, offset])

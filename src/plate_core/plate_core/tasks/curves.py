"""Circles and splines as fine polygons: what a path in a scenario may be drawn with."""

from __future__ import annotations

import numpy as np

SAGITTA_M = 1e-6
"""Greatest distance of a chord from its arc [m]: far below what a camera sees."""

FEWEST_CHORDS, MOST_CHORDS = 12, 4000
"""Of a circle, and of a spline between two of its points."""


def circle_points(
    centre: tuple[float, float], radius: float, start: float, leftwards: bool
) -> np.ndarray:
    """Return corners (n, 2) [m] of a polygon on a circle; the last one is not the first again.

    Parameters
    ----------
    centre : (x, y)
        [m, plate_home].
    radius : float
        [m].
    start : float
        Where on the circle the first corner is [rad, counter-clockwise from x].
    leftwards : bool
        Whether it is run through counter-clockwise.
    """
    count = _chords(radius, 2 * np.pi * radius)
    angle = start + (1 if leftwards else -1) * 2 * np.pi * np.arange(count) / count
    return np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def spline_points(point: np.ndarray, closed: bool) -> np.ndarray:
    """Return corners (n, 2) [m] of a polygon on the cubic spline through the points (k, 2) [m].

    The spline is parametrised by the length of chords; a closed one is periodic, so it has no kink
    at the first point, which is not repeated. An open one has no curvature at its ends.
    """
    knot = np.vstack([point, point[:1]]) if closed else np.asarray(point, dtype=float)
    from scipy.interpolate import CubicSpline  # here: the command that stops must not wait for it

    length = np.hypot(*np.diff(knot, axis=0).T)
    place = np.append(0.0, np.cumsum(length))
    spline = CubicSpline(place, knot, bc_type="periodic" if closed else "natural")
    pieces = []
    for begin, step in zip(place[:-1], length, strict=True):
        trial = begin + step * np.linspace(0, 1, FEWEST_CHORDS)
        bend = np.max(np.hypot(*spline(trial, 2).T))  # a bound of 1/radius where speed is near 1
        pieces.append(begin + step * np.linspace(0, 1, _chords(1 / max(bend, 1e-9), step), False))
    ends = place[:0] if closed else place[-1:]
    return np.asarray(spline(np.concatenate([*pieces, ends])))


def _chords(radius: float, length: float) -> int:
    """How many chords an arc needs: each is at most sqrt(8 radius sagitta) long."""
    count = length / np.sqrt(8 * radius * SAGITTA_M)
    return int(np.clip(np.ceil(count), FEWEST_CHORDS, MOST_CHORDS))

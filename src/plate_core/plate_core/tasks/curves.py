"""Conversion of circles and splines of a scenario's paths to polygons.

A chord of length c deviates from an arc of radius R by c^2/(8 R). The chords are so short that this
deviation is at most `SAGITTA_M`.
"""

from __future__ import annotations

import numpy as np

SAGITTA_M = 1e-6
"""Maximum distance between a chord and its arc [m]. A camera cannot resolve such a distance."""

MIN_CHORDS, MAX_CHORDS = 12, 4000
"""Minimum and maximum number of chords of a circle, or of a spline between two of its points."""


def circle_points(
    centre: tuple[float, float], radius: float, start: float, leftwards: bool
) -> np.ndarray:
    """Return the corners (n, 2) [m] of a polygon on a circle. The result does not repeat the first
    corner at its end.

    Parameters
    ----------
    centre : (x, y)
        Centre [m, plate_home].
    radius : float
        Radius [m].
    start : float
        Angle of the first corner on the circle [rad, counter-clockwise from x].
    leftwards : bool
        Whether the corners are in counter-clockwise order.
    """
    count = _chord_count(radius, 2 * np.pi * radius)
    angle = start + (1 if leftwards else -1) * 2 * np.pi * np.arange(count) / count
    return np.array(centre) + radius * np.column_stack([np.cos(angle), np.sin(angle)])


def spline_points(point: np.ndarray, closed: bool) -> np.ndarray:
    """Return the corners (n, 2) [m] of a polygon on the cubic spline through the points (k, 2) [m].

    The parameter of the spline is the cumulative chord length. A closed spline is periodic, so it
    is smooth at the first point, which the result does not repeat. An open spline is natural: its
    second derivative is zero at both ends.
    """
    knot = np.vstack([point, point[:1]]) if closed else np.asarray(point, dtype=float)
    # SciPy is imported here, so that the stop command does not wait for this import.
    from scipy.interpolate import CubicSpline

    length = np.hypot(*np.diff(knot, axis=0).T)
    place = np.append(0.0, np.cumsum(length))
    spline = CubicSpline(place, knot, bc_type="periodic" if closed else "natural")
    pieces = []
    for begin, step in zip(place[:-1], length, strict=True):
        trial = begin + step * np.linspace(0, 1, MIN_CHORDS)
        # The second derivative is approximately the curvature, because the length of the first
        # derivative is near 1.
        bend = np.max(np.hypot(*spline(trial, 2).T))
        pieces.append(
            begin + step * np.linspace(0, 1, _chord_count(1 / max(bend, 1e-9), step), False)
        )
    ends = place[:0] if closed else place[-1:]
    return np.asarray(spline(np.concatenate([*pieces, ends])))


def _chord_count(radius: float, length: float) -> int:
    """Return the number of chords for an arc with this radius and length [m]. A chord is at most
    sqrt(8 radius `SAGITTA_M`) long."""
    count = length / np.sqrt(8 * radius * SAGITTA_M)
    return int(np.clip(np.ceil(count), MIN_CHORDS, MAX_CHORDS))

"""Simplification of a measured outline to a polygon with few corners.

The Douglas-Peucker algorithm finds a first polygon. The corners of this polygon are fitted to the
outline by least squares. Then one corner after the other is removed while the fit remains good.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.optimize import least_squares

from plate_core.rig import MAX_CORNERS, is_simple

from ..errors import TeachError
from .outlines import distances, make_outline

COARSE = 0.03
"""Maximum RMS (root mean square) distance of the polygon from the measured outline, relative to the
part's reach (largest radius) [-]."""

FINE_PX = 0.5
"""Tolerance of the first polygon: its maximum distance from the measured outline [px]."""

FINE = 0.012
"""Tolerance of the first polygon, relative to the part's reach (largest radius) [-]. The larger one
of this value and `FINE_PX` is used."""

PLAIN_PX = 0.14
"""Maximum RMS deviation of a polygon from the outline [px]. Two neighbouring corners are replaced
by one if the deviation of the new polygon is within this limit."""

PLAIN = 0.006
"""Limit of the deviation like `PLAIN_PX`, but relative to the part's reach (largest radius) [-].
The largest of the three limits `PLAIN_PX`, `PLAIN` and `WORSE` applies."""

WORSE = 1.1
"""Limit of the deviation like `PLAIN_PX`, but relative to the deviation of the first polygon
[-]."""

BULGE_PX = 0.35
"""Maximum distance of the outline from the polygon's edges [px]."""

CLEAR_PX = 2.0
"""Distance from the corners of a polygon [px]. Within this distance, the polygon is not compared
with the outline, because blur rounds the corners."""

STAY = 0.05
"""Weight of a corner's shift in the fit, relative to the weight of the outline's distance. This
weight keeps a corner in place if the outline does not determine its position."""


def simplify_polygon(
    name: str, what: str, ring: np.ndarray, reach: float, scale: float
) -> np.ndarray:
    """Return a polygon (n, 2) [m] with at most `MAX_CORNERS` corners along a ring (k, 2) [m].

    `reach` is the part's reach [m], and `scale` is the scale of the picture [px/m].

    Raises
    ------
    TeachError
        If this number of corners does not suffice. In the message, `name` is the name of the type,
        and `what` is the kind of ring.
    """
    fine = max(FINE_PX / scale, FINE * reach)
    contour = (ring / fine).astype(np.float32)[:, None]
    loose = 1.0
    while True:
        corner = cv2.approxPolyDP(contour, loose, True)[:, 0].astype(float) * fine
        if len(corner) < 3:
            raise TeachError(f"type {name}: its {what} is a line, allowed: a part with an area")
        if len(corner) <= MAX_CORNERS and is_simple(corner):
            break
        loose *= 1.1
    corner, rms = _fit_corners(corner, ring)
    max_rms = max(WORSE * rms, PLAIN_PX / scale, PLAIN * reach)
    # Blur rounds the corners of a part. Due to the rounding, the first polygon often has two
    # corners instead of one.
    while len(corner) > 3:
        side = np.hypot(*(np.roll(corner, -1, axis=0) - corner).T)
        i = int(np.argmin(side))
        fewer = np.delete(corner, i, axis=0)
        fewer[i % len(fewer)] = 0.5 * (corner[i] + corner[(i + 1) % len(corner)])
        fewer, rms = _fit_corners(fewer, ring)
        if (
            not is_simple(fewer)
            or rms > max_rms
            or _max_ring_distance(fewer, ring, CLEAR_PX / scale) > BULGE_PX / scale
        ):
            break
        corner = fewer
    off = math.sqrt(float(np.mean(_ring_distances(corner, ring) ** 2)))
    if off > max(COARSE * reach, FINE_PX / scale):
        many = len(cv2.approxPolyDP(contour, 1.0, True))
        raise TeachError(
            f"type {name}: its {what} has {many} corners, allowed: {MAX_CORNERS}; a polygon with "
            f"this maximum number has an RMS error of {scale * off:.1f} px, which is too large"
        )
    return corner


def _fit_corners(corner: np.ndarray, ring: np.ndarray) -> tuple[np.ndarray, float]:
    """Fit the corners (n, 2) of a polygon to a ring (k, 2). Return the fitted corners, and the RMS
    distance of the ring from the polygon [m]."""
    size = float(np.max(np.ptp(ring, axis=0)))

    def errors(flat: np.ndarray) -> np.ndarray:
        # Regularisation: a corner stays at its initial position if the ring of points does not
        # determine it.
        keep = STAY * (flat - corner.ravel() / size)
        return np.concatenate([_ring_distances(size * flat.reshape(-1, 2), ring) / size, keep])

    fit = least_squares(errors, corner.ravel() / size, max_nfev=8)
    moved = size * fit.x.reshape(-1, 2)
    if not is_simple(moved):
        moved = corner
    return moved, math.sqrt(float(np.mean(_ring_distances(moved, ring) ** 2)))


def _max_ring_distance(corner: np.ndarray, ring: np.ndarray, clear: float) -> float:
    """Return the maximum distance of a ring's points (k, 2) from a polygon (n, 2) [m]. Points near
    the polygon's corners are ignored."""
    gap = np.hypot(*(ring[:, None] - corner).transpose(2, 0, 1)).min(axis=1)
    return float(np.max(np.abs(_ring_distances(corner, ring)[gap > clear]), initial=0.0))


def _ring_distances(corner: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Return the distances (k,) of a ring's points from a polygon (n, 2)."""
    return np.asarray(distances(make_outline([corner]).edges, ring)[:, 0])

"""A measured outline as a polygon of few corners."""

from __future__ import annotations

import math

import cv2
import numpy as np
from scipy.optimize import least_squares

from plate_core.rig import MOST_CORNERS, is_simple

from ..errors import TeachError
from .outlines import distances, make_outline

COARSE = 0.03
"""How far the simplified outline may be from the measured one, RMS, in its reach."""

FINE_PX, FINE = 0.5, 0.012
"""How far it is at first: in pixels, and in its reach."""

PLAIN_PX, PLAIN = 0.14, 0.006
"""RMS deviation up to which a polygon with fewer corners is preferred: in pixels, in its reach."""

WORSE = 1.1
"""By how much it may be further from the outline than the first guess [-]."""

BULGE_PX, CLEAR_PX = 0.35, 2.0
"""Largest distance of the outline from its edges, further than that from corners, which blur rounds
[px]."""

STAY = 0.05
"""Weight of a corner's shift against the outline's distance from the ring."""


def simplified(name: str, what: str, ring: np.ndarray, reach: float, scale: float) -> np.ndarray:
    """Return a polygon (n, 2) [m] of at most `MOST_CORNERS` corners along a ring (k, 2) [m].

    `reach` is the part's [m], `scale` that of the picture [px/m].

    Raises
    ------
    TeachError
        If so few corners do not do; it says of which type, and of what of it.
    """
    fine = max(FINE_PX / scale, FINE * reach)
    contour = (ring / fine).astype(np.float32)[:, None]
    loose = 1.0
    while True:
        corner = cv2.approxPolyDP(contour, loose, True)[:, 0].astype(float) * fine
        if len(corner) < 3:
            raise TeachError(f"type {name}: its {what} is a line, allowed: a part with an area")
        if len(corner) <= MOST_CORNERS and is_simple(corner):
            break
        loose *= 1.1
    corner, rms = _fitted(corner, ring)
    most = max(WORSE * rms, PLAIN_PX / scale, PLAIN * reach)
    # Two corners of the first guess often stand for one that blur has rounded.
    while len(corner) > 3:
        side = np.hypot(*(np.roll(corner, -1, axis=0) - corner).T)
        i = int(np.argmin(side))
        fewer = np.delete(corner, i, axis=0)
        fewer[i % len(fewer)] = 0.5 * (corner[i] + corner[(i + 1) % len(corner)])
        fewer, rms = _fitted(fewer, ring)
        if (
            not is_simple(fewer)
            or rms > most
            or _bulge(fewer, ring, CLEAR_PX / scale) > BULGE_PX / scale
        ):
            break
        corner = fewer
    off = math.sqrt(float(np.mean(_errors(corner, ring) ** 2)))
    if off > max(COARSE * reach, FINE_PX / scale):
        many = len(cv2.approxPolyDP(contour, 1.0, True))
        raise TeachError(
            f"type {name}: its {what} has {many} corners, allowed: {MOST_CORNERS}, with which it "
            f"is {scale * off:.1f} px off on average"
        )
    return corner


def _fitted(corner: np.ndarray, ring: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the corners (n, 2) of a polygon moved so that it is nearest to a ring (k, 2), and how
    far that is from it, RMS [m]."""
    size = float(np.max(np.ptp(ring, axis=0)))

    def errors(flat: np.ndarray) -> np.ndarray:
        # Corners stay in place where the ring does not say where they belong.
        keep = STAY * (flat - corner.ravel() / size)
        return np.concatenate([_errors(size * flat.reshape(-1, 2), ring) / size, keep])

    fit = least_squares(errors, corner.ravel() / size, max_nfev=8)
    moved = size * fit.x.reshape(-1, 2)
    if not is_simple(moved):
        moved = corner
    return moved, math.sqrt(float(np.mean(_errors(moved, ring) ** 2)))


def _bulge(corner: np.ndarray, ring: np.ndarray, clear: float) -> float:
    """Return the largest distance of a ring's points (k, 2) from a polygon (n, 2), of those that
    are clear of its corners [m]."""
    gap = np.hypot(*(ring[:, None] - corner).transpose(2, 0, 1)).min(axis=1)
    return float(np.max(np.abs(_errors(corner, ring)[gap > clear]), initial=0.0))


def _errors(corner: np.ndarray, ring: np.ndarray) -> np.ndarray:
    """Return the distances (k,) of a ring's points from a polygon (n, 2)."""
    return np.asarray(distances(make_outline([corner]).edges, ring)[:, 0])

"""The record of a measured disc, common to all methods; and which discs have near neighbours.

Darkness is 1 - grey / bare plate. It is 0 on the plate and constant over a uniform part,
independent of the shading of the light.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

DISC = np.dtype(
    [(name, "f8") for name in ("x_px", "y_px", "radius_px", "darkness", "misfit")]
    + [("scatter_px", "f8"), ("seen", "f8")]
)
"""A measured disc: place; radius of a disc of the same darkness and area; mean darkness of its
inner part; misfit, the deviation from an evenly dark disc (moments) or from its contour (fit): 0 if
perfect, about 1 for another object; standard deviation of the place along each axis, caused by the
image's noise and the misfit; visible fraction of the contour."""


def numbers(discs: np.ndarray) -> np.ndarray:
    """Return discs (n,) `DISC` as rows of numbers (n, 7)."""
    return discs.view(float).reshape(-1, 7)


def crowded(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Return which centres (n, 2) [px] have another one nearer than a distance: (n,) bool."""
    near = np.empty(len(centre), np.bool_)
    _kernels.crowded(centre, distance_px, near)
    return near

"""The numbers of a disc, common to all methods that measure it; and which discs are near others.

Darkness is 1 - grey / bare plate: 0 on the plate, the same all over a part whatever the shading.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

DISC = np.dtype(
    [(name, "f8") for name in ("x_px", "y_px", "radius_px", "darkness", "misfit")]
    + [("scatter_px", "f8"), ("seen", "f8")]
)
"""A measured disc: its place; radius, that of a disc of the same darkness and area; mean darkness
of its inner part; deviation from an evenly dark disc (moments) or from its contour (fit): 0 for a
perfect one, about 1 for something else; standard deviation of the place along each axis, as far as
the image's noise and the misfit cause it; fraction of the contour that is seen."""


def numbers(discs: np.ndarray) -> np.ndarray:
    """Return discs (n,) `DISC` as rows of numbers (n, 7)."""
    return discs.view(float).reshape(-1, 7)


def crowded(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Tell which centres (n, 2) [px] have another nearer than a distance: (n,) bool."""
    near = np.empty(len(centre), np.bool_)
    _kernels.crowded(centre, distance_px, near)
    return near

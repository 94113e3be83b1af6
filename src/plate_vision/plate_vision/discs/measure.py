"""The record of a measured disc, which all methods use. The module also has a function that finds
discs with near neighbours.

Darkness is 1 - g / b, with the grey level g of a pixel and the grey level b of the bare plate
there. The darkness is 0 on the plate and constant over a uniform part, even if the light is uneven.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels

DISC = np.dtype(
    [(name, "f8") for name in ("x_px", "y_px", "radius_px", "darkness", "misfit")]
    + [("scatter_px", "f8"), ("seen", "f8")]
)
"""A measured disc, with these fields:

`x_px`, `y_px`: place [px].
`radius_px`: radius [px].
`darkness`: mean darkness of the inner part.
`misfit`: deviation from an evenly dark disc (moments) or from the contour (fit). The misfit is 0
    for a perfect disc, and about 1 for another object.
`scatter_px`: standard deviation of the place along each axis, caused by the image's noise and the
    misfit [px].
`seen`: visible fraction of the contour.
"""


def disc_rows(discs: np.ndarray) -> np.ndarray:
    """Return discs (n,) `DISC` as rows of numbers (n, 7)."""
    return discs.view(float).reshape(-1, 7)


def crowded(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Return which of the centres (n, 2) [px] are nearer than `distance_px` to another centre: (n,)
    bool."""
    near = np.empty(len(centre), np.bool_)
    _kernels.crowded(centre, distance_px, near)
    return near

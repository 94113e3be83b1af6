"""Centres, radii and darkness of round parts that stand alone, to a hundredth of a pixel.

Darkness is 1 - grey / bare plate: 0 on the plate, the same all over a part whatever the shading.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from . import silhouette

RIM_PX: float = _kernels.RIM_PX
"""Reach [px] beyond a part's radius that is looked at: 0.7 px from rounding the window, 1 px of
seed error, and the blurred edge."""

RIM_DIRT_PX2 = 0.5
"""Dark area [px2] in that rim from which on there is something beside the part; twice as
much would shift the moments of a part of 8 px radius by 0.05 px."""

DISC = np.dtype(
    [(name, "f8") for name in ("x_px", "y_px", "radius_px", "darkness", "misfit")]
    + [("scatter_px", "f8"), ("seen", "f8")]
)
"""A measured disc: its place; radius, that of a disc of the same darkness and area; mean darkness
of its inner part; deviation from an evenly dark disc (moments) or from its contour (fit): 0 for a
perfect one, about 1 for something else; standard deviation of the place along each axis, as far as
the image's noise and the misfit cause it; fraction of the contour that is seen."""


def measure_alone(
    plate: LitPlate, seeds: np.ndarray, parts: np.ndarray, alone: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Measure discs that have their surroundings to themselves, by moments of darkness.

    With m the darkness and d the distance from the centre, a disc of radius r has
    sum(m d2) / sum(m) = r2 / 2; the misfit is the relative difference from the radius by area, or
    from the silhouette's second moments, whichever is larger.

    Parameters
    ----------
    plate : LitPlate
    seeds, parts : (n, 2), (n,) SILHOUETTE
        First guesses of the centres [px], and the silhouettes of parts there.
    alone : (n,) bool
        Which to measure: those with no other near.

    Returns
    -------
    (n,) DISC
    (n,) bool
        Which of them are right: there is nothing else beside them, nor the image's border.
    """
    discs, dirt = np.zeros(len(seeds), DISC), np.full(len(seeds), np.inf)
    places = np.rint(seeds).astype(np.int64)
    shapes = silhouette.numbers(parts)
    _kernels.measure_alone(*plate.pixels, places, shapes, alone, numbers(discs), dirt)
    return discs, dirt <= RIM_DIRT_PX2 * discs["darkness"]


def numbers(discs: np.ndarray) -> np.ndarray:
    """Return discs (n,) `DISC` as rows of numbers (n, 7)."""
    return discs.view(float).reshape(-1, 7)


def crowded(centre: np.ndarray, distance_px: float) -> np.ndarray:
    """Tell which centres (n, 2) [px] have another nearer than a distance: (n,) bool."""
    near = np.empty(len(centre), np.bool_)
    _kernels.crowded(centre, distance_px, near)
    return near

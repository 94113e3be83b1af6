"""Places, radii and darkness of round parts, fitted to their contours.

Damped Gauss-Newton iterations fit the place, radius, edge width and darkness of one part after the
other. For each part, the darkness of its neighbours is subtracted first. A part with a height has
two values of darkness: one for its top and one for its side faces. Pixels outside the plate have no
weight. The weight of a pixel decreases with the fraction of the pixel that a neighbour covers.
Pixels inside a part that differ much from the part have no weight. Such pixels show a mark, a
highlight or a hole.
"""

from __future__ import annotations

import numpy as np

from .. import _kernels
from ..plate.light import LitPlate
from . import silhouette
from .measure import DISC, disc_rows
from .shadow import Shadow


def fit_discs(
    plate: LitPlate, seeds: np.ndarray, parts: np.ndarray, shadow: Shadow | None = None
) -> np.ndarray:
    """Measure discs (n,) DISC, also among neighbours. Input: seeds (n, 2) [px], the silhouettes
    (n,) SILHOUETTE of parts at the seeds, and the shadow that every part casts."""
    discs = np.zeros(len(seeds), DISC)
    shapes = silhouette.silhouette_rows(parts)
    cast, shade, edge_px = np.empty((0, 2)), 0.0, 1.0
    if shadow is not None:
        cast, shade, edge_px = shadow.cast(seeds, parts), shadow.darkness, shadow.edge_px
    _kernels.fit_discs(
        *plate.pixels, seeds, shapes, cast, shade, edge_px, plate.noise, disc_rows(discs)
    )
    return discs

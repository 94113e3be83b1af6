"""Round parts of a known radius, the fast path: seeds, marks, then measurement by moments or a fit.

`detection` calls them in this order; nothing else does.
"""

from .fit import fit_discs
from .marks import mark_angles, paint_over
from .measure import RIM_PX, crowded, measure_alone
from .seeds import COARSE_RADIUS_PX, find_seeds, seeds_of
from .silhouette import (
    SILHOUETTE,
    EvenDiscs,
    SeenDiscs,
    Silhouettes,
    longest,
    outlines,
    to_image,
    tops,
)

__all__ = [
    "COARSE_RADIUS_PX",
    "RIM_PX",
    "SILHOUETTE",
    "EvenDiscs",
    "SeenDiscs",
    "Silhouettes",
    "crowded",
    "find_seeds",
    "fit_discs",
    "longest",
    "mark_angles",
    "measure_alone",
    "outlines",
    "paint_over",
    "seeds_of",
    "to_image",
    "tops",
]

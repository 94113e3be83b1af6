"""Round parts of a known radius, the fast path: seeds, then measurement by moments or a fit, then
which of them are parts.

`detection` calls them in this order; nothing else does.
"""

from .dark import measure_dark
from .fit import fit_discs
from .judge import GOOD_MISFIT, NUMBERS, judge
from .marks import find_marks
from .measure import crowded
from .seeds import COARSE_RADIUS_PX, find_seeds, seeds_of
from .silhouette import (
    SILHOUETTE,
    EvenDiscs,
    SeenDiscs,
    Silhouettes,
    outlines,
    to_image,
    tops,
)

__all__ = [
    "COARSE_RADIUS_PX",
    "GOOD_MISFIT",
    "NUMBERS",
    "SILHOUETTE",
    "EvenDiscs",
    "SeenDiscs",
    "Silhouettes",
    "crowded",
    "find_marks",
    "find_seeds",
    "fit_discs",
    "judge",
    "measure_dark",
    "outlines",
    "seeds_of",
    "to_image",
    "tops",
]
